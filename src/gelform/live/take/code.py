"""The Python and the command line that give what a view shows."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

from gelform.errors import GelformError

TITLES = {
    "surface": "the surface",
    "depth": "the depth",
    "image": "the camera's image",
    "normals": "the normals",
    "confidence": "the confidence",
    "sigma": "the depth's uncertainty",
    "causes": "why pixels are not trusted",
    "other": "depth by another calibration",
    "difference": "the difference of two calibrations",
    "profile": "a profile",
    "time": "numbers against time",
}


@dataclass(frozen=True)
class Situation:
    """What a station shows, as its code needs it.

    Attributes
    ----------
    source : as it was asked for
    calibration : path of its file, or None: the one shipped for the simulated sensor
    other : path of the calibration compared with, or None
    background : whether one was taken on the page
    solver : "auto" or a name
    """

    source: str
    calibration: str | None
    other: str | None = None
    background: bool = False
    solver: str = "auto"


def code_of(view: str, now: Situation) -> tuple[str, list[dict[str, str]]]:
    """Title, and [{language, text}] of what gives the same as a view.

    Raises
    ------
    GelformError
        There is no such view.
    """
    if view not in TITLES:
        raise GelformError("There is no such view.")
    python = "\n".join([*_frame(now), *([] if view == "image" else _result(now)), *_last(view, now)])
    parts = [{"language": "Python", "text": python}, {"language": "Command line", "text": _shell(view, now)}]
    return TITLES[view], parts


def _frame(now: Situation) -> list[str]:
    return [
        "import numpy as np",
        "import gelform",
        "",
        f"with gelform.open_source({now.source!r}) as source:",
        "    frame = next(iter(source))",
    ]


def _result(now: Situation) -> list[str]:
    options = ['background=gelform.read_image("background.png")'] if now.background else []
    options += [f"solver={now.solver!r}"] if now.solver != "auto" else []
    return [
        *_calibration("calibration", now.calibration),
        f"reconstruct = gelform.Reconstructor({', '.join(['calibration', *options])})",
        "result = reconstruct(frame)",
        "",
    ]


def _calibration(name: str, path: str | None) -> list[str]:
    if path is not None:
        return [f"{name} = gelform.load_calibration({path!r})"]
    return [
        "from gelform.live.simulated.ready import ready_calibration",
        "from gelform.sensors import simulated_sensor_named",
        f'{name} = ready_calibration(simulated_sensor_named("three-edges"))',
    ]


def _last(view: str, now: Situation) -> list[str]:
    if view in ("other", "difference"):
        other = [*_calibration("other", now.other), "other_mm = gelform.Reconstructor(other)(frame).depth_mm"]
        return [*other, *(["difference_mm = result.depth_mm - other_mm"] if view == "difference" else [])]
    return {
        "surface": ["depth_mm = result.depth_mm  # (H, W), mm, positive where pressed"],
        "depth": ["depth_mm = result.depth_mm  # (H, W), mm, positive where pressed"],
        "image": ["image = frame.image  # (H, W, 3), RGB, before the calibration's view"],
        "normals": ["normals = result.normals  # (H, W, 3), unit length, z towards the camera"],
        "confidence": ["confidence = result.confidence  # (H, W), 0-1"],
        "sigma": ["sigma_mm = result.depth_sigma_mm  # (H, W), one standard deviation"],
        "causes": ["confidence = result.confidence  # (H, W), 0-1: low where a cause holds"],
        "profile": [
            "row, column = np.unravel_index(result.depth_mm.argmax(), result.shape)",
            "along_x, along_y = result.depth_mm[row], result.depth_mm[:, column]",
        ],
        "time": [
            "pixel_mm2 = np.prod(np.broadcast_to(result.mm_per_px, 2))",
            "deepest_mm = result.peak_mm",
            "area_mm2 = result.contact.sum() * pixel_mm2",
            "volume_mm3 = result.depth_mm[result.contact].sum() * pixel_mm2",
        ],
    }[view]


def _shell(view: str, now: Situation) -> str:
    """The page again; and files of a frame that was taken with the button Snapshot."""
    given = [] if now.calibration is None else ["-c", now.calibration]
    again = shlex.join(["gelform", "live", now.source, *given])
    if now.calibration is None or view == "image":
        return again
    background = ["--background", "background.png"] if now.background else []
    solver = ["--solver", now.solver] if now.solver != "auto" else []
    command = "compare" if view in ("other", "difference") and now.other is not None else "reconstruct"
    if command == "compare":
        files = ["gelform", "compare", "frame.png", *given, "-c", str(now.other), "-o", "out"]
    else:
        form = ["--format", "npz,png"]
        files = ["gelform", "reconstruct", "frame.png", *given, *background, *solver, "-o", "out", *form]
    return f"{again}\n{shlex.join(files)}"
