"""Every command that writes files, with its output below a folder, and its inputs."""

from __future__ import annotations

from pathlib import Path

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


def commands(work: Path, out: Path) -> dict[str, list[str]]:
    """The arguments of each command that writes, with its output below `out`."""
    images = " ".join(f"{work}/image{k}.png" for k in range(3))
    leds = " ".join(f"{work}/{name}.png" for name in ("red", "green", "blue"))
    cal = f"-c {work}/cal.npz"
    imported = f"--from gsrobotics-web --position true --background {work}/rest.png --mm-per-px 0.1"
    calls = {
        "demo": f"demo -o {out}/demo",
        "calibrate": f"calibrate {work}/presses --model polynomial --report {out}/report -o {out}/cal.npz",
        "force": f"force calibrate {work}/loads {cal} -o {out}/force.npz",
        "starter": f"starter digit --background {work}/digit.png -o {out}/unit.npz",
        "reconstruct": f"reconstruct {images} {cal} -o {out}/results",
        "scale": f"scale {out}/sensor.toml --points 20,30,60,30,4",
        "lens": f"lens {out}/sensor.toml --image {work}/grid.png --grid 8x6 --pitch-mm 1.2",
        "crosstalk": f"crosstalk {out}/sensor.toml {leds}",
        "simulate": f"simulate -o {out}/set --count 2 --sensor three-edges",
        "design": f"design three-edges --presses 4 -o {out}/design.png",
        "import": f"import {work}/net.bin {imported} -o {out}/imported.npz",
        "batch": f"batch {work}/image*.png {cal} -o {out}/batch",
        "compare": f"compare {work}/image0.png {cal} {cal} -o {out}/compared",
        "explain": f"explain {work}/image0.png {cal} -o {out}/why",
        "export": f"export {work}/result.npz --to tiff -o {out}/depth.tiff",
        "measure": f"measure {work}/result.npz --line 20,32,60,32 -o {out}/measured --csv {out}/measured.csv",
        "record": f"record {work}/frames -o {out}/recorded.mcap --frames 3",
        "bag": f"bag {work}/frames {cal} -o {out}/bag",
        "track": f"track {work}/frames {cal} -o {out}/track.csv",
    }
    return {name: call.split() for name, call in calls.items()}


def prepare(out: Path) -> None:
    """What is changed in place."""
    (out / "sensor.toml").write_text('name = "known gel"\nmm_per_px = 0.1\n')
