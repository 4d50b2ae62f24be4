"""Every command that writes files, with its output below a folder, and its inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.calibration.starters import load_starter
from gelform.exchange.exporters.press_folder import save_press_folder
from made.files import web_file
from made.images import checkerboard
from made.small_gel import MM_PER_PX, Touch, background, calibration, image_of, save

PLACES = [(x, y) for y in (20, 32, 44) for x in (20, 40, 60)]
WRITE_NOTHING = ("evaluate", "info", "cameras", "verify")
LIBRARY = ("calibrations",)  # which writes into the user's folder: tests/calibration/library
SERVERS = ("live", "ros")  # live writes when the page asks for it: tests/live


def make_work(folder: Path) -> Path:
    """A calibration, images, a background, another package's network, presses, images of three LEDs."""
    calibration().save(folder / "cal.npz")
    for k in range(3):
        save(folder / f"image{k}.png", image_of(Touch(seed=k)))
    gelform.save_result(
        gelform.Reconstructor(calibration()).from_image(image_of(Touch())), folder / "result.npz"
    )
    (folder / "frames").mkdir()
    for k in range(3):
        save(folder / "frames" / f"{k}.png", image_of(Touch(seed=k)))
    save(folder / "digit.png", load_starter("digit").calibration.background.round().astype(np.uint8))
    save(folder / "rest.png", np.rint(background()).astype(np.uint8))
    for k, name in enumerate(("red", "green", "blue")):
        save(folder / f"{name}.png", np.full((64, 80, 3), 20, np.uint8) + 100 * np.eye(3, dtype=np.uint8)[k])
    checkerboard(folder / "grid.png", (120, 160), 12)
    web_file(folder / "net.bin")
    touches = [Touch(x_px=x, y_px=y, depth_mm=0.35, seed=k) for k, (x, y) in enumerate(PLACES)]
    save_press_folder(
        folder / "presses",
        background=image_of(None),
        images=[image_of(touch) for touch in touches],
        ball_diameters_mm=[8.0] * len(touches),
        mm_per_px=MM_PER_PX,
        name="known gel",
    )
    _loads(folder / "loads")
    return folder


def _loads(folder: Path) -> None:
    """Presses with loads of 0.05 N for each mm^3."""
    folder.mkdir()
    reconstruct, lines = gelform.Reconstructor(calibration()), ["image,object,force_n"]
    for k, depth in enumerate((0.15, 0.2, 0.25, 0.3, 0.35, 0.4)):
        image = image_of(Touch(depth_mm=depth, seed=k))
        save(folder / f"{k}.png", image)
        volume = gelform.touch_from_result(reconstruct.from_image(image)).volume_mm3
        lines.append(f"{k}.png,ball,{0.05 * (volume or 0)}")
    (folder / "loads.csv").write_text("\n".join([*lines, ""]))


def commands(work: Path, out: Path) -> dict[str, list[Any]]:
    """The arguments of each command that writes, with its output below `out`."""
    images = [work / f"image{k}.png" for k in range(3)]
    imported = [
        "--from",
        "gsrobotics-web",
        "--position",
        "true",
        "--background",
        work / "rest.png",
        "--mm-per-px",
        "0.1",
    ]
    fitted = ["--model", "polynomial", "--report", out / "report"]
    two = ["-c", work / "cal.npz", "-c", work / "cal.npz"]
    leds = [work / f"{name}.png" for name in ("red", "green", "blue")]
    return {
        "demo": ["demo", "-o", out / "demo"],
        "calibrate": ["calibrate", work / "presses", *fitted, "-o", out / "cal.npz"],
        "force": ["force", "calibrate", work / "loads", "-c", work / "cal.npz", "-o", out / "force.npz"],
        "starter": ["starter", "digit", "--background", work / "digit.png", "-o", out / "unit.npz"],
        "reconstruct": ["reconstruct", *images, "-c", work / "cal.npz", "-o", out / "results"],
        "scale": ["scale", out / "sensor.toml", "--points", "20,30,60,30,4"],
        "lens": [
            "lens",
            out / "sensor.toml",
            "--image",
            work / "grid.png",
            "--grid",
            "8x6",
            "--pitch-mm",
            "1.2",
        ],
        "crosstalk": ["crosstalk", out / "sensor.toml", *leds],
        "simulate": ["simulate", "-o", out / "set", "--count", "2", "--sensor", "three-edges"],
        "design": ["design", "three-edges", "--presses", "4", "-o", out / "design.png"],
        "import": ["import", work / "net.bin", *imported, "-o", out / "imported.npz"],
        "batch": ["batch", work / "image*.png", "-c", work / "cal.npz", "-o", out / "batch"],
        "compare": ["compare", images[0], *two, "-o", out / "compared"],
        "explain": ["explain", images[0], "-c", work / "cal.npz", "-o", out / "why"],
        "export": ["export", work / "result.npz", "--to", "tiff", "-o", out / "depth.tiff"],
        "record": ["record", work / "frames", "-o", out / "recorded.mcap", "--frames", "3"],
        "bag": ["bag", work / "frames", "-c", work / "cal.npz", "-o", out / "bag"],
        "track": ["track", work / "frames", "-c", work / "cal.npz", "-o", out / "track.csv"],
    }


def prepare(out: Path) -> None:
    """What is changed in place."""
    (out / "sensor.toml").write_text('name = "known gel"\nmm_per_px = 0.1\n')
