"""The Python code and the command lines that reproduce a view."""

from __future__ import annotations

import shlex
from dataclasses import dataclass

from gelform.errors import GelformError
from gelform.live.lists import Origin

TITLES = {
    "surface": "the surface",
    "depth": "the depth",
    "image": "the camera's image",
    "normals": "the normals",
    "confidence": "the confidence",
    "sigma": "the depth's uncertainty",
    "causes": "the causes of low confidence",
    "other": "depth by another calibration",
    "difference": "the difference of two calibrations",
    "profile": "a profile",
    "time": "numbers over time",
}


@dataclass(frozen=True)
class Situation:
    """The state of a station, as far as its code depends on it.

    Attributes
    ----------
    source : the user's spec, or the path of the open recording
    calibration : its origin; None without one
    other : the origin of the second calibration
    background, zero : whether one was taken on the page; a snapshot has it as a file
    solver : "auto" or a name
    number : of the recording's frame; None for a sensor, whose next frame is taken
    point : (x, y) of the profile, px
    """

    source: str
    calibration: Origin | None
    other: Origin | None = None
    background: bool = False
    zero: bool = False
    solver: str = "auto"
    number: int | None = None
    point: tuple[int, int] = (0, 0)


def code_of(view: str, now: Situation) -> tuple[str, list[dict[str, str]]]:
    """Title, and [{language, text}] of code that reproduces a view.

    Raises
    ------
    GelformError
        The view is unknown, or needs a calibration that is missing.
    """
    if view not in TITLES:
        raise GelformError("There is no such view.")
    if now.calibration is None and view != "image":
        raise GelformError("This view needs a calibration. Choose one, or make one on the page Calibrate.")
    if now.other is None and view in ("other", "difference"):
        raise GelformError("This view needs a second calibration. Choose one under “Compare with”.")
    python = "\n".join(
        [*_imports(view, now), "", *_frame(now), *_image(now), *_result(view, now), *_last(view, now)]
    )
    parts = [{"language": "Python", "text": python}, {"language": "Command line", "text": _shell(view, now)}]
    return TITLES[view], parts


def _imports(view: str, now: Situation) -> list[str]:
    origins = [now.calibration] if now.calibration else []
    origins += [now.other] if now.other and view in ("other", "difference") else []
    lines = {line for origin in origins for line in origin.imports}
    standard = [] if now.number is None else ["from itertools import islice", ""]
    return [*standard, "import numpy as np", "import gelform", *sorted(lines)]


def _frame(now: Situation) -> list[str]:
    nth = "next(iter(source))" if now.number is None else f"next(islice(source, {now.number}, None))"
    return [f"with gelform.open_source({now.source!r}) as source:", f"    frame = {nth}"]


def _image(now: Situation) -> list[str]:
    if now.calibration is None:
        return ["image = frame.image  # (H, W, 3), RGB"]
    return [
        f"calibration = {now.calibration.expression}",
        "image = gelform.image_from_frame(frame.image, calibration.view)  # (H, W, 3), RGB",
    ]


def _result(view: str, now: Situation) -> list[str]:
    if view == "image":
        return []
    options = ['background=gelform.read_image("background.png")'] if now.background else []
    options += [f"solver={now.solver!r}"] if now.solver != "auto" else []
    zero = ' - np.load("zero.npy")' if now.zero else ""
    return [
        f"reconstruct = gelform.Reconstructor({', '.join(['calibration', *options])})",
        "result = reconstruct.from_image(image)",
        f"depth_mm = result.depth_mm{zero}  # (H, W), mm, positive where pressed",
    ]


def _last(view: str, now: Situation) -> list[str]:
    x, y = now.point
    contact = (
        "gelform.contact_from_depth(\n"
        "    depth_mm, mm_per_px=result.mm_per_px, relaxation_mm=calibration.settings.relaxation_mm\n)"
        if now.zero
        else "result.contact"
    )
    solver = f", solver={now.solver!r}" if now.solver != "auto" else ""
    other = "" if now.other is None else now.other.expression
    compared = [f"other = {other}", f"other_mm = gelform.Reconstructor(other{solver})(frame).depth_mm"]
    return {
        "normals": [
            "gradients = gelform.gradients_from_depth(depth_mm, mm_per_px=result.mm_per_px)",
            "normals = gelform.normals_from_gradients(gradients)  # (H, W, 3), z towards the camera",
        ],
        "confidence": ["confidence = result.confidence  # (H, W), 0-1"],
        "sigma": ["sigma_mm = result.depth_sigma_mm  # (H, W), one standard deviation"],
        "causes": [
            "explained = reconstruct.explain(image)",
            "causes = {name: sigma > explained.clean for name, sigma in explained.maps.items()}  # (H, W) each",
        ],
        "other": compared,
        "difference": [*compared, "difference_mm = depth_mm - other_mm"],
        "profile": [f"along_x, along_y = depth_mm[{y}], depth_mm[:, {x}]"],
        "time": [
            f"contact = {contact}",
            "pixel_mm2 = np.prod(np.broadcast_to(result.mm_per_px, 2))",
            "deepest_mm = depth_mm.max()",
            "area_mm2 = contact.sum() * pixel_mm2",
            "volume_mm3 = depth_mm[contact].sum() * pixel_mm2",
        ],
    }.get(view, [])


def _shell(view: str, now: Situation) -> str:
    """Commands that open the page again, and use the files of a frame from the button Snapshot."""
    path = None if now.calibration is None else now.calibration.path
    given = [] if path is None else ["-c", str(path)]
    again = shlex.join(["gelform", "live", now.source, *given])
    background = ["--background", "background.png"] if now.background else []
    solver = ["--solver", now.solver] if now.solver != "auto" else []
    if path is None or view == "image":
        return again
    if view == "causes":
        files = ["gelform", "explain", "frame.png", *given, *background, "-o", "out"]
    elif view in ("other", "difference"):
        if now.other is None or now.other.path is None or now.background:
            return again  # `gelform compare` would use the background for both
        files = ["gelform", "compare", "frame.png", *given, "-c", str(now.other.path), "-o", "out"]
    else:
        files = ["gelform", "reconstruct", "frame.png", *given, *background, *solver]
        files += ["-o", "out", "--format", "npz,png"]
    return f"{again}\n{shlex.join(files)}"
