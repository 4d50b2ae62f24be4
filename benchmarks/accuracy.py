"""Accuracy: integrators on exact slopes, real held-out presses, simulated truth. No scale is ever fitted.

    python benchmarks/accuracy.py            # all (about 45 minutes); writes results/accuracy.json after each part
    python benchmarks/accuracy.py anchor sigma
    python benchmarks/accuracy.py --quick    # checks that the parts run; not for `integrators` and `simulated`

The real presses are read from GELFORM_DATA (default ../shared/data). Without that folder their parts are left out, with a
message.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from accuracy.heights import at_least, heights_drawn, walls_drawn
from accuracy.objects import anchor, deep, objects, walls
from accuracy.real import calibrated, few, real, sigma
from accuracy.shapes import cube, shapes
from gelform.calibration.circles.find import find_contact, scale_of, why_no_contact
from gelform.image.background import ChangeSettings
from gelform.simulate import LAYOUTS, Ball, Coin, Punch, Screw, simulate_ball_presses, simulate_press
from presses import DATA, data_is_missing, depth_by, mini_ball, presses_of, unlabeled
from report import command_line, parts_asked, recorded, table, write
from scenes import BUMP, PLANE, SCENES, ball, scene

PEERS = json.loads((Path(__file__).parent / "peers.json").read_text())
FIVE = {
    "smooth bump": BUMP,
    "ball R 4 mm, contact radius 2.5 mm": ball(4.0, 2.5, (0.4, -0.3)),
    "ball R 2 mm, contact radius 1 mm": ball(2.0, 1.0, (0.4, -0.3)),
    "the first ball, cut by the border": ball(4.0, 2.5, (9.0, -0.3)),
    "tilted plane": PLANE,
}


def integrators() -> dict[str, Any]:
    """Recovered peak over true on exact slopes, and RMSE with every way to fix the offset."""
    peaks, offsets = {}, {}
    for name, surface in FIVE.items():
        truth = scene(surface)
        depth = gelform.depth_from_gradients(truth.gradients, mm_per_px=truth.mm_per_px)
        peaks[name] = 100 * _peak(depth, truth) / _peak(truth.depth_mm, truth)
    rows = [
        [name, *(f"{v} %" for v in PEERS["recovered_peak_percent"][name].values()), f"{peaks[name]:.2f} %"]
        for name in FIVE
    ]
    print(
        table(["peak recovered over true", *PEERS["recovered_peak_percent"]["smooth bump"], "gelform"], rows)
    )
    for name in ("ball", "balls", "peaks", "texture"):  # the last two have no pixel at rest
        offsets[name] = _rmse_by_offset(scene(SCENES[name]))
    print("\n" + table(["RMSE, um", *offsets["ball"]], [[k, *v.values()] for k, v in offsets.items()]))
    return {"recovered_peak_percent": peaks, "rmse_um": offsets}


def _peak(depth: np.ndarray, truth: Any) -> float:
    """Peak above the median of the pixels at rest; the range if there are none."""
    untouched = (truth.gradients == 0).all(axis=-1)
    if not untouched.any():
        return float(depth.max() - depth.min())
    return float(depth.max() - np.median(depth[untouched]))


def _rmse_by_offset(truth: Any) -> dict[str, float]:
    untouched = (np.abs(truth.gradients) < 1e-3).all(axis=-1)
    depth = truth.depth_mm
    modes: dict[str, dict[str, Any]] = {
        "zero mean": {"zero": "mean"},
        "border": {"zero": "border"},
        "untouched pixels": {"zero": untouched},
        "plane": {"zero": untouched, "level": "plane"},
        "quadratic": {"zero": untouched, "level": "quadratic"},
        "median slope": {"zero": untouched, "level": "slope"},
    }
    reference = {
        "zero mean": depth - depth.mean(),
        "border": depth - np.median(np.concatenate([depth[0], depth[-1], depth[1:-1, 0], depth[1:-1, -1]])),
    }
    errors = {}
    for name, mode in modes.items():
        if name not in reference and np.count_nonzero(untouched) < 0.05 * untouched.size:
            errors[name] = float("nan")
            continue
        found = gelform.depth_from_gradients(truth.gradients, mm_per_px=truth.mm_per_px, **mode)
        wanted = reference.get(name, depth - np.median(depth[untouched]))
        errors[name] = float(1e3 * np.sqrt(np.mean((found - wanted) ** 2)))
    return errors


def whole(quick: bool) -> dict[str, Any]:
    """All 67 presses of mini-ball, end to end, and circles found in single images."""
    presses, _ = mini_ball()
    calibration, seconds = calibrated(presses)
    distance = [
        np.hypot(row.center_x_px - press.label[0], row.center_y_px - press.label[1])
        for row, press in zip(calibration.report.presses, presses.presses)
    ]
    found = {
        "cpu_s": seconds,
        "accepted": sum(row.accepted for row in calibration.report.presses),
        "circles within 3 px of the reference": int(np.sum(np.array(distance) <= 3)),
        "largest distance, px": float(max(distance)),
        "held_out": calibration.held_out,
    }
    print("\nAll 67 presses: " + json.dumps(found, default=float))
    return {"all presses": found, "circles": _circles()}


def _circles() -> dict[str, Any]:
    """Circles found in single images, with equal settings on every data set; a gross failure is more than 10 px off."""
    rows = []
    for name in ("mini-ball", "gelsight-ball-deep", "digit-ball"):
        presses = mini_ball()[0] if name == "mini-ball" else gelform.read_presses(DATA / name)
        wanted = [p.label for p in presses.presses]
        rows.append([name, *_against(presses.background, [p.image for p in presses.presses], wanted)])
    pack = np.load(DATA / "taxim-ball-lowres" / "dataPack.npz")
    wanted = [(*c, r) for c, r in zip(pack["touch_center"], pack["touch_radius"])]
    rows.append(["taxim-ball-lowres", *_against(pack["f0"].astype(np.float32), list(pack["imgs"]), wanted)])
    for name, sensor in LAYOUTS.items():
        simulated = simulate_ball_presses(
            sensor, ball_diameters_mm=[5.0, 8.0], count=24, rng=np.random.default_rng(1)
        )
        truth = [(*p.center_px, p.contact_radius_px) for p in simulated.presses]
        images = [p.image for p in simulated.presses]
        rows.append([f"simulated {name}", *_against(simulated.background.astype(np.float32), images, truth)])
    header = [
        "one image at a time",
        "images",
        "rejected",
        "median px",
        "scatter px",
        "gross, accepted",
        "offset",
    ]
    print("\n" + table(header, rows))
    return {str(row[0]): dict(zip(header[1:], row[1:])) for row in rows}


def _against(background: np.ndarray, images: list[Any], wanted: list[Any]) -> list[Any]:
    settings = ChangeSettings(blur_px=1.25 * scale_of(background.shape[:2]))
    found = [find_contact(gelform.color_change_from_image(image, background, settings)) for image in images]
    good = [k for k, contact in enumerate(found) if why_no_contact(contact) is None]
    if wanted[0] is None:
        return [len(images), len(images) - len(good), "no labels", "", "", ""]
    offset = np.array([np.subtract((found[k].x_px, found[k].y_px), wanted[k][:2]) for k in good])
    middle = np.median(offset, axis=0)
    distance, scatter = np.hypot(*offset.T), np.hypot(*(offset - middle).T)
    return [
        len(images),
        len(images) - len(good),
        float(np.median(distance)),
        float(np.median(scatter)),
        int(np.sum(scatter > 10)),
        f"({middle[0]:.1f}, {middle[1]:.1f})",
    ]


def simulated() -> dict[str, Any]:
    """Objects on three simulated sensors, each calibrated only on its own presses."""
    figures, rows = {}, []
    for name, sensor in LAYOUTS.items():
        presses = simulate_ball_presses(
            sensor, ball_diameters_mm=[5.0, 8.0], count=30, rng=np.random.default_rng(1)
        )
        calibration = gelform.calibrate(unlabeled(presses_of(presses)))
        reconstruct = gelform.Reconstructor(calibration)
        objects = {
            "ball": (Ball(3.0), 0.6, (0.0, 0.0)),
            "coin": (Coin(), 0.35, (0.0, 0.0)),
            "screw": (Screw(), 0.4, (0.0, 0.0)),
            "flat punch": (Punch(6.0), 0.3, (0.0, 0.0)),
            "flat punch, shallow": (Punch(6.0), 0.1, (-2.0, 1.0)),
            "ball cut by the border": (Ball(3.0), 0.6, (8.8, 0.0)),
        }
        figures[name] = {"held_out": calibration.held_out, "settings": dict(calibration.settings)}
        for what, (indenter, depth_mm, center) in objects.items():
            rng = np.random.default_rng(7)
            press = simulate_press(sensor, indenter, depth_mm=depth_mm, center_mm=center, rng=rng)
            result = reconstruct.from_image(press.image)
            error = 1e3 * (result.depth_mm - press.depth_mm)
            plain = 1e3 * (depth_by("dct", reconstruct, press.image) - press.depth_mm)
            within = np.abs(error) < 1e3 * result.depth_sigma_mm
            found = {
                "rmse_um": float(np.sqrt(np.mean(error**2))),
                "contact_um": float(np.sqrt(np.mean(error[press.contact] ** 2))),
                "peak_percent": float(100 * result.depth_mm.max() / press.depth_mm.max()),
                "rmse_um_without_weights_and_anchor": float(np.sqrt(np.mean(plain**2))),
                "contact_um_without": float(np.sqrt(np.mean(plain[press.contact] ** 2))),
                "contact_within_sigma_percent": float(100 * within[press.contact].mean()),
            }
            figures[name][what] = found
            rows.append([name, what, *found.values()])
    header = ["simulated sensor", "object", "RMSE um", "in contact um", "peak %"]
    header += ["RMSE without weights, anchor", "in contact without", "contact within sigma %"]
    print("\n" + table(header, rows))
    return figures


PARTS: dict[str, Any] = {
    "integrators": lambda quick: integrators(),
    "real": real,
    "whole": whole,
    "sigma": sigma,
    "few": few,
    "simulated": lambda quick: simulated(),
    "anchor": anchor,
    "deep": deep,
    "objects": objects,
    "walls": walls,
    "walls_drawn": walls_drawn,
    "at_least": at_least,
    "heights_drawn": heights_drawn,
    "shapes": shapes,
    "cube": cube,
}
NEEDS_DATA = ("real", "whole", "sigma", "few", "at_least", "cube")


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others. A quick run writes nothing."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true", help="check that the parts run; write nothing")
    asked = parts_asked(command, PARTS)
    figures = recorded("accuracy")
    for name in asked.parts:
        if name in NEEDS_DATA and data_is_missing(name):
            continue
        start = time.perf_counter()
        figures[name] = PARTS[name](asked.quick)
        print(f"\n{name}: {time.perf_counter() - start:.0f} s")
        if not asked.quick:
            write("accuracy", figures)


if __name__ == "__main__":
    main()
