"""Whether sigma and causes are right: on simulated frames with faults, and on real ones without.

    python benchmarks/confidence.py                        # about 10 minutes; writes results/confidence.json
    python benchmarks/confidence.py coverage causes --quick # a tenth of the frames, nothing written
    python benchmarks/confidence.py --calibrations DIR     # keeps the calibrations there, and reuses them

Thresholds were chosen on the layout three-edges and on the calibrating presses of mini-ball. The figures use the layouts
ring-120 and homemade, and the other presses. Contacts are in real_frames.py.
`digit` and `alarms` read real data (GELFORM_DATA, default ../shared/data).
"""

from __future__ import annotations

import json
import tempfile
import time
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from confidence import faults
from confidence.drawn import press
from gelform.calibration.circles.find import ColorChanges, find_contact, why_no_contact
from gelform.result.metrics import fit_sphere
from gelform.sensors.files import read_background
from gelform.simulate import LAYOUTS, simulate_ball_presses
from presses import DATA, by_name, data_is_missing, depth_by, presses_of
from report import command_line, parts_asked, recorded, table, write

REPORTED = ("ring-120", "homemade")
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
        reconstruct = gelform.Reconstructor(calibration)
        errors = []
        for _ in range(run.frames(20)):
            truth = press(name, rng)
            image = faults.saturated(faults.shadow(faults.shadow(truth.image, rng), rng), rng)
            depths = [depth_by(solver, reconstruct, image) for solver in ("multigrid", "dct")]
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
    reconstruct = gelform.Reconstructor(calibration)
    changes = ColorChanges(reconstruct.background, calibration.change)
    rows = []
    for one in test.presses[:: 10 if run.quick else 1]:
        contact = find_contact(changes(one.image)[0])
        if why_no_contact(contact) is None:
            depths = [depth_by(solver, reconstruct, one.image) for solver in ("multigrid", "dct")]
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
    center_mm, radius_mm = fit_sphere(depth, inside, mm_per_px=mm_per_px, radius_mm=one.ball_diameter_mm / 2)
    places = np.stack([x[inside] * mm_per_px, y[inside] * mm_per_px, depth[inside]], axis=-1)
    apart = np.linalg.norm(places - center_mm, axis=-1) - radius_mm
    return 1e3 * float(np.sqrt(np.mean(apart**2))), 1e3 * float(
        np.sqrt(np.mean(depth[away > 2.5 * circle[2]] ** 2))
    )


def causes(run: Run) -> dict[str, Any]:
    """Share of frames with a fault in which the fault is named."""
    found: dict[str, Any] = {}
    for name in REPORTED:
        calibration, rng = run.calibration(name), np.random.default_rng(SEED + 4)
        reconstruct, row = gelform.Reconstructor(calibration), {}
        for cause in (*faults.FAULTS, "marker", "outside"):
            named = []
            for _ in range(run.frames(20)):
                image, used = press(name, rng).image, reconstruct
                if cause in faults.FAULTS:
                    image = faults.FAULTS[cause](image, rng)
                else:
                    own, image = faults.printed(calibration, image, cause, rng)
                    used = gelform.Reconstructor(own)
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
    reconstruct = gelform.Reconstructor(calibration)
    counts: dict[str, Any] = {"frames": len(images)}
    for image in images:
        for finding in reconstruct.explain(image).findings:
            counts[finding.name] = counts.get(finding.name, 0) + 1
    return counts


def cost(run: Run) -> dict[str, Any]:
    """CPU time of a frame whose confidence, contacts and findings are read, over that of one whose depth alone is."""
    rng, count = np.random.default_rng(SEED + 5), run.frames(200)
    name = REPORTED[0]
    return {name: _cost(run.calibration(name), [press(name, rng).image for _ in range(4)], count)}


def _cost(calibration: gelform.Calibration, images: list[np.ndarray], count: int) -> dict[str, float]:
    reconstruct = gelform.Reconstructor(calibration)
    seconds: dict[bool, list[float]] = {True: [], False: []}
    for index in range(count):
        for whole in (index % 2 == 0, index % 2 == 1):
            began = time.process_time()
            result = reconstruct.from_image(images[index // 2 % len(images)])
            if whole:
                result.confidence, result.contacts, result.health  # noqa: B018 - computed when asked for
            seconds[whole].append(time.process_time() - began)
    whole_ms, without_ms = (1e3 * float(np.median(seconds[kind])) for kind in (True, False))
    return {"whole_ms": whole_ms, "without_ms": without_ms, "ratio": whole_ms / without_ms}


PARTS = {
    "coverage": coverage,
    "weights": weights,
    "digit": digit,
    "causes": causes,
    "alarms": alarms,
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
