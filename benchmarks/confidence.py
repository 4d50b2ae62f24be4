"""Whether sigma, causes and contacts are right: on simulated frames with faults, and on real ones without.

    python benchmarks/confidence.py                        # about 10 minutes; writes results/confidence.json
    python benchmarks/confidence.py coverage masks --quick # a tenth of the frames, nothing written
    python benchmarks/confidence.py --calibrations DIR     # keeps the calibrations there, and reuses them

Thresholds were chosen on the layout three-edges and on the calibrating presses of mini-ball. The figures use the layouts
ring-120 and homemade, and the other presses. Thresholds of contacts were chosen on all three layouts and on random sensors,
with other seeds than these figures.
`digit` and `alarms` read real data (GELFORM_DATA, default ../shared/data).
"""

from __future__ import annotations

import json
import tempfile
import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

import gelform
from confidence import faults
from confidence.drawn import object_press, press
from gelform.calibration.circles.find import find_contact, why_no_contact
from gelform.calibration.circles.prepare import ColorChanges
from gelform.image.health import FrameFaults
from gelform.result.metrics import angle_deg
from gelform.result.metrics.ball import fit_sphere
from gelform.sensors.files import read_background
from gelform.simulate import (
    LAYOUTS,
    SimulatedPress,
    simulate_background,
    simulate_ball_presses,
)
from presses import DATA, by_name, data_is_missing, presses_of
from report import command_line, parts_asked, recorded, table, write

REPORTED = ("ring-120", "homemade")
DEPTHS_UM = (5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 50.0, 70.0, 100.0)
FOUND = 0.95
SEED = 20261122


@dataclass(frozen=True)
class Run:
    """The number of frames, and the folder of calibrations."""

    quick: bool
    calibrations: Path

    def frames(self, whole: int) -> int:
        """That many, or a tenth of them."""
        return max(3, whole // 10) if self.quick else whole

    def calibration(self, name: str) -> gelform.Calibration:
        """The calibration of a layout, from 24 simulated presses; or from every second press of real ones."""
        path = self.calibrations / f"{name}.npz"
        if not path.is_file():
            presses = _simulated_presses(name) if name in LAYOUTS else _real_presses(name)[0]
            gelform.calibrate(presses, color_model="hierarchical").save(path)
        return gelform.load_calibration(path)


def _simulated_presses(name: str, count: int = 24) -> Any:
    rng = np.random.default_rng(11)
    made = simulate_ball_presses(
        LAYOUTS[name], ball_diameters_mm=[5.0, 8.0], count=count, rng=rng, oversample=1
    )
    return presses_of(made)


@cache
def _real_presses(name: str) -> tuple[Any, Any]:
    """The presses for calibration, and the others."""
    presses = gelform.read_presses(DATA / name)
    order = by_name(presses)
    return presses.subset(order[0::2]), presses.subset(order[1::2])


def coverage(run: Run) -> dict[str, Any]:
    """Share of all pixels whose depth is within 1 and 2 sigma, with 5 to 15 % of the frame corrupted."""
    found: dict[str, Any] = {}
    for name in REPORTED:
        reconstruct, rng = gelform.Reconstructor(run.calibration(name)), np.random.default_rng(SEED)
        within = []
        for _ in range(run.frames(20)):
            truth = press(name, rng)
            result = reconstruct.from_image(faults.corrupted(truth.image, rng, rng.uniform(0.05, 0.15))[0])
            off = np.abs(result.depth_mm - truth.depth_mm) / result.depth_sigma_mm
            within.append(((off < 1).mean(), (off < 2).mean()))
        found[name] = dict(zip(("within_1_sigma", "within_2_sigma"), np.mean(within, axis=0).tolist()))
    return found


def weights(run: Run) -> dict[str, Any]:
    """RMS depth error with one saturated and two shadowed spots, over that of the same solver without weights."""
    found: dict[str, Any] = {}
    for name in REPORTED:
        calibration, rng = run.calibration(name), np.random.default_rng(SEED + 1)
        with_weights = gelform.Reconstructor(calibration, depth_sigma=False)
        without = gelform.Reconstructor(calibration, solver="dct", depth_sigma=False)
        errors = []
        for _ in range(run.frames(20)):
            truth = press(name, rng)
            image = faults.saturated(faults.shadow(faults.shadow(truth.image, rng), rng), rng)
            depths = [one.from_image(image).depth_mm for one in (with_weights, without)]
            errors.append([1e3 * np.sqrt(np.mean((z - truth.depth_mm) ** 2)) for z in depths])
        rms = np.sqrt(np.mean(np.square(errors), axis=0))
        found[name] = {
            "um": float(rms[0]),
            "unweighted_um": float(rms[1]),
            "ratio": float(rms[0] / rms[1]),
            "median_ratio": float(np.median(np.divide(*np.transpose(errors)))),
        }
    return found


def digit(run: Run) -> dict[str, Any]:
    """Distance to the sphere fitted in the contact, and depth off it, over those of the solver without weights."""
    calibration, (_, test) = run.calibration("digit-ball"), _real_presses("digit-ball")
    runs = [gelform.Reconstructor(calibration, solver=s, depth_sigma=False) for s in ("auto", "dct")]
    changes = ColorChanges(runs[0].background, calibration.change)
    rows = []
    for one in test.presses[:: 10 if run.quick else 1]:
        contact = find_contact(changes(one.image)[0])
        if why_no_contact(contact) is None:
            depths = [reconstruct.from_image(one.image).depth_mm for reconstruct in runs]
            rows.append([_sphere_um(z, contact.circle_px, one, calibration.mm_per_px) for z in depths])
    mean = np.mean(rows, axis=0)
    return {
        "presses": len(rows),
        "sphere_um": mean[:, 0].tolist(),
        "sphere_ratio": float(mean[0, 0] / mean[1, 0]),
        "off_contact_um": mean[:, 1].tolist(),
        "off_contact_ratio": float(mean[0, 1] / mean[1, 1]),
    }


def _sphere_um(depth: np.ndarray, circle: Any, one: Any, mm_per_px: float) -> tuple[float, float]:
    y, x = np.mgrid[: depth.shape[0], : depth.shape[1]]
    away = np.hypot(x - circle[0], y - circle[1])
    inside = away < circle[2] - 4
    sphere = fit_sphere(depth, inside, mm_per_px=mm_per_px, radius_mm=one.ball_diameter_mm / 2)
    places = np.stack([x[inside] * mm_per_px, y[inside] * mm_per_px, depth[inside]], axis=-1)
    apart = np.linalg.norm(places - sphere.center_mm, axis=-1) - sphere.radius_mm
    return 1e3 * float(np.sqrt(np.mean(apart**2))), 1e3 * float(
        np.sqrt(np.mean(depth[away > 2.5 * circle[2]] ** 2))
    )


def limit(run: Run) -> dict[str, Any]:
    """The shallowest press of a ball that is found in 95 % of the frames, and frames at rest in which one is found."""
    found: dict[str, Any] = {}
    for name in REPORTED:
        calibration, rng = run.calibration(name), np.random.default_rng(SEED + 2)
        reconstruct, count = gelform.Reconstructor(calibration), run.frames(100)
        resting = [simulate_background(LAYOUTS[name], rng) for _ in range(count)]
        false = sum(bool(reconstruct.from_image(image).contacts) for image in resting)
        row: dict[str, Any] = {"frames": count, "false_at_rest": false, "limit_um": None}
        for depth_um in DEPTHS_UM:
            share, frames = _fraction_found(reconstruct, name, depth_um, count, rng)
            row[f"found_at_{depth_um:g}_um"] = [share, frames]
            if share >= FOUND:
                row["limit_um"] = depth_um
                break
        found[name] = row
    return found


def _fraction_found(
    reconstruct: gelform.Reconstructor, name: str, depth_um: float, count: int, rng: np.random.Generator
) -> tuple[float, int]:
    """Share of presses of a depth that are found, and their number; stops once too many are missed."""
    hits = frames = 0
    while frames < count and frames - hits <= (1 - FOUND) * count:
        truth = press(name, rng, (depth_um / 1e3, depth_um / 1e3))
        hits += bool((reconstruct.from_image(truth.image).contact & truth.contact).any())
        frames += 1
    return hits / frames, frames


def masks(run: Run) -> dict[str, Any]:
    """Intersection over union of the contact mask and the pixels that the indenter touches.

    Both masks mark where something presses on the gel. In the simulator gel and indenter meet there, however shallow. In the
    result the surface needs a pressure to be held up. The depth of the gel counts in neither. `one_pixel_wider` is the
    score of a truth one pixel wider all around: edges and tops of textures touch in lines of a pixel or two, while
    images are blurred over three.
    """
    found: dict[str, Any] = {}
    for name in REPORTED:
        reconstruct, rng = gelform.Reconstructor(run.calibration(name)), np.random.default_rng(SEED + 3)
        scores: dict[str, list[float]] = {}
        for _ in range(run.frames(60)):
            kind, truth = object_press(name, rng)
            touched = truth.contact
            wider = cv2.dilate(touched.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
            overlap = _overlap(reconstruct.from_image(truth.image).contact, touched)
            for key in ("median", kind):
                scores.setdefault(key, []).append(overlap)
            for key in ("one_pixel_wider", f"{kind}_one_pixel_wider"):
                scores.setdefault(key, []).append(_overlap(wider, touched))
        found[name] = {key: float(np.median(values)) for key, values in sorted(scores.items())}
    return found


def _overlap(mask: np.ndarray, other: np.ndarray) -> float:
    return float((mask & other).sum() / (mask | other).sum())


def causes(run: Run) -> dict[str, Any]:
    """Share of frames with a fault in which the fault is named."""
    found: dict[str, Any] = {}
    for name in REPORTED:
        calibration, rng = run.calibration(name), np.random.default_rng(SEED + 4)
        reconstruct, row = gelform.Reconstructor(calibration, depth_sigma=False), {}
        for cause in (*faults.FAULTS, "marker", "outside"):
            named = []
            for _ in range(run.frames(20)):
                image, used = press(name, rng).image, reconstruct
                if cause in faults.FAULTS:
                    image = faults.FAULTS[cause](image, rng)
                else:
                    own, image = faults.printed(calibration, image, cause, rng)
                    used = gelform.Reconstructor(own, depth_sigma=False)
                named.append(cause in {finding.name for finding in used.explain(image).findings})
            row[cause] = float(np.mean(named))
        found[name] = row
    return found


def alarms(run: Run) -> dict[str, Any]:
    """Causes that are named on real frames: held-out presses of mini-ball, mini-objects, the marker video."""
    _, test = _real_presses("mini-ball")
    step = 10 if run.quick else 1
    ball = [one.image for one in test.presses[::step]]
    objects = [gelform.read_image(DATA / "mini-objects" / f"{n}.png") for n in ("bead", "key", "seed")]
    rest = read_background(DATA / "mini-objects" / "background.png")
    own = gelform.import_calibration(
        DATA / "peer-calibrations" / "gs_sdk-mini-c-nnmodel.pth",
        package="gs_sdk",
        background=rest,
        mm_per_px=0.0634,
    )
    frames = [frame.image for frame in gelform.Video(DATA / "mini-markers-video" / "mini_example.avi")]
    dotted = gelform.import_calibration(
        DATA / "peer-calibrations" / "gs_sdk-mini-c-nnmodel.pth", package="gs_sdk",
        background=np.median(frames[:20], axis=0), mm_per_px=0.0634,
    )  # fmt: skip
    sets = {
        "mini-ball": (run.calibration("mini-ball"), ball),
        "mini-objects": (own, objects),
        "marker video": (dotted, frames[:: 10 * step]),
    }
    return {name: _named(calibration, images) for name, (calibration, images) in sets.items()}


def _named(calibration: gelform.Calibration, images: list[np.ndarray]) -> dict[str, Any]:
    reconstruct = gelform.Reconstructor(calibration, depth_sigma=False)
    counts: dict[str, Any] = {"frames": len(images)}
    for image in images:
        for finding in reconstruct.explain(image).findings:
            counts[finding.name] = counts.get(finding.name, 0) + 1
    return counts


def few(run: Run) -> dict[str, Any]:
    """Normal error, degrees, in contacts after calibration on five presses.

    Outliers are found by held-out residuals, by training residuals, or not at all.
    """
    name, rng = REPORTED[0], np.random.default_rng(SEED + 6)
    calibration = gelform.calibrate(_simulated_presses(name, 5), color_model="hierarchical")
    forward = calibration.forward
    never = replace(forward, residual_scale=1e12)
    kinds = {"held_out": forward, "training": replace(forward, residual_scale=1.0), "not_asked": never}
    truths = [press(name, rng) for _ in range(run.frames(30))]
    found: dict[str, Any] = {}
    for kind, own in kinds.items():
        reconstruct = gelform.Reconstructor(replace(calibration, forward=own), depth_sigma=False)
        found[f"{kind}_deg"] = float(np.mean([_normal_deg(reconstruct, truth) for truth in truths]))
    return found


def _normal_deg(reconstruct: gelform.Reconstructor, truth: SimulatedPress) -> float:
    gradients = reconstruct.from_image(truth.image).gradients[truth.contact]
    return float(angle_deg(gradients, truth.gradients[truth.contact]).mean())


def cost(run: Run) -> dict[str, Any]:
    """CPU time of a default frame with its contacts, over that without causes, contact, contacts and health."""
    rng, count = np.random.default_rng(SEED + 5), run.frames(200)
    name = REPORTED[0]
    return {name: _cost(run.calibration(name), [press(name, rng).image for _ in range(4)], count)}


def _cost(calibration: gelform.Calibration, images: list[np.ndarray], count: int) -> dict[str, float]:
    reconstruct = gelform.Reconstructor(calibration)
    seconds: dict[bool, list[float]] = {True: [], False: []}
    for index in range(count):
        for whole in (index % 2 == 0, index % 2 == 1):
            with ExitStack() as stack:
                if not whole:
                    _leave_out(stack, reconstruct)
                began = time.process_time()
                result = reconstruct.from_image(images[index // 2 % len(images)])
                if whole:
                    result.contacts  # noqa: B018 - worked out when asked for
                seconds[whole].append(time.process_time() - began)
    whole_ms, without_ms = (1e3 * float(np.median(seconds[kind])) for kind in (True, False))
    return {"whole_ms": whole_ms, "without_ms": without_ms, "ratio": whole_ms / without_ms}


def _leave_out(stack: ExitStack, reconstruct: gelform.Reconstructor) -> None:
    """Within the stack: frames are not examined, sigma is the usual noise, and no contact is searched for."""
    full = np.float32(reconstruct.calibration.slope_sigma.full_confidence_sigma)
    nowhere, today = np.zeros(reconstruct.calibration.image_shape, dtype=bool), reconstruct._today

    def confidence(
        gradients: Any, sigma: Any, unseen: Any, image: Any, step: Any = None, maps: Any = None
    ) -> Any:
        return np.minimum(np.square(full / sigma), 1)

    stack.enter_context(patch.object(today, "health", FrameFaults))
    stack.enter_context(patch.object(today, "causes", confidence))
    stack.enter_context(patch.object(today, "contact", lambda *_: nowhere))


PARTS = {
    "coverage": coverage,
    "weights": weights,
    "digit": digit,
    "limit": limit,
    "masks": masks,
    "causes": causes,
    "alarms": alarms,
    "few": few,
    "cost": cost,
}
REAL = ("digit", "alarms")


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others."""
    command = command_line(__doc__)
    command.add_argument("--quick", action="store_true", help="a tenth of the frames; write nothing")
    command.add_argument("--calibrations", type=Path, metavar="DIR", help="keep the calibrations there")
    asked = parts_asked(command, PARTS)
    figures = recorded("confidence")
    with tempfile.TemporaryDirectory() as folder:
        run = Run(asked.quick, asked.calibrations or Path(folder))
        for name in asked.parts:
            if name in REAL and data_is_missing(name):
                continue
            started = time.monotonic()
            figures[name] = PARTS[name](run)
            print(
                f"\n{name} ({time.monotonic() - started:.0f} s): {(PARTS[name].__doc__ or '').splitlines()[0]}"
            )
            rows = figures[name].items()
            print(table([name, "figures"], [[key, json.dumps(value)] for key, value in rows]), flush=True)
            if not asked.quick:
                write("confidence", figures)


if __name__ == "__main__":
    main()
