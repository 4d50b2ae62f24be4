"""Force in newtons on real data, with the objects or the recording left out that it is judged on.

    python benchmarks/force.py                    # about 2 minutes; writes results/force.json
    python benchmarks/force.py --output FILE      # writes there
    python benchmarks/force.py shear              # one part; the others' figures stay

It reads force-wedge and force-dots (GELFORM_DATA, default ../shared/data). The wedge is calibrated on its golf ball. Beside
every error stands that of the best constant: the gripper nearly always stops at 24 N.
"""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.calibration.loads import LoadedPresses
from gelform.calibration.presses.press_set import table_rows
from gelform.depth.contact import Surround
from gelform.depth.force import Load, force_from_result, why_no_normal
from presses import DATA, data_is_missing
from report import RESULTS, command_line, machine, median_ms, parts_asked, table

HARD = ("golf_ball", "rigid_strawberry")  # the other objects of force-wedge are soft
GOLF_BALL_MM, PRESSED_N, SOFT_N, LEAST_N = 42.67, 2.0, 10.0, 2.0
PRESS_COUNTS, DRAWS, SEED = (1, 3, 5, 10), 200, 20261126
RECORDINGS = 3


@cache
def wedge() -> gelform.Calibration:
    """The calibration of the wedge, on the golf ball's frames from 2 N."""
    return wedge_of(pressed_names())


def pressed_names() -> list[str]:
    """The golf ball's frames from 2 N, by the names of their images."""
    rows = (row for _, row in table_rows(DATA / "force-wedge" / "loads.csv", ("image", "object")))
    return [
        row["image"] for row in rows if row["object"] == "golf_ball" and float(row["force_n"]) > PRESSED_N
    ]


def wedge_of(pressed: Sequence[str]) -> gelform.Calibration:
    """The calibration of the wedge, on these frames of the golf ball, with the mean of its three images at rest."""
    source = DATA / "force-wedge"
    with tempfile.TemporaryDirectory() as made:
        folder = Path(made)
        (folder / "background").mkdir()
        for k in range(3):
            rest = (source / f"images/golf_ball-{k}" / "rest.png").resolve()
            (folder / "background" / f"{k}.png").symlink_to(rest)
        (folder / "images").symlink_to((source / "images").resolve())
        lines = [f"{image},{GOLF_BALL_MM}" for image in pressed]
        (folder / "presses.csv").write_text("\n".join(["image,ball_diameter_mm", *lines, ""]))
        (folder / "sensor.toml").write_text((source / "sensor.toml").read_text())
        return gelform.calibrate(gelform.read_presses(folder), start=None)


@cache
def pressed() -> LoadedPresses:
    """All frames of force-wedge."""
    return gelform.read_loads(DATA / "force-wedge", wedge())


def normal() -> dict[str, Any]:
    """Normal force above 2 N: relative errors with one object, or one grasp, left out; soft contacts refused."""
    found = pressed()
    objects = np.array([load.object for load in found.loads])
    grasps = np.array([str(Path(name).parent) for name in found.names])
    figures: dict[str, Any] = {"lag_frames": found.lag_frames}
    for left_out, groups in (("object", objects), ("grasp", grasps)):
        rows = list(_left_out(found, groups))
        hard = [row for row in rows if row["object"] in HARD]
        by_hard = list(_left_out(found, groups, by=np.isin(objects, HARD)))
        figures[f"leave_{left_out}_out"] = {
            "hard, calibrated on hard objects alone": _errors(
                [row for row in by_hard if row["object"] in HARD]
            ),
            "hard": _errors(hard),
            "accepted": _errors(rows),
        }
    figures["refused"] = _refused(found)
    return figures


def _left_out(
    found: LoadedPresses, groups: np.ndarray, by: np.ndarray | bool = True
) -> Iterator[dict[str, Any]]:
    """Force, its sigma and the load of each accepted press above 2 N, by a model that did not see its group.

    Only the presses `by` calibrate.
    """
    for name in np.unique(groups):
        others = np.flatnonzero((groups != name) & by)
        model = gelform.calibrate_force([found.touches[i] for i in others], [found.loads[i] for i in others])
        for i in np.flatnonzero(groups == name):
            force, load = force_from_result(found.touches[i], model), found.loads[i]
            if force.normal_n is not None and load.normal_n > LEAST_N:
                known = {"force": force.normal_n, "sigma": force.normal_sigma_n, "load": load.normal_n}
                yield {"object": load.object, **known}


def _errors(rows: list[dict[str, Any]]) -> dict[str, Any]:
    force, sigma, load = (np.array([row[name] for row in rows]) for name in ("force", "sigma", "load"))
    error, constant = np.abs(force - load), np.abs(np.median(load) - load)
    return {
        "presses": len(rows),
        "median": float(np.median(error / load)),
        "q90": float(np.quantile(error / load, 0.9)),
        "mae_n": float(error.mean()),
        "within_1": float(np.mean(error <= sigma)),
        "within_2": float(np.mean(error <= 2 * sigma)),
        "constant": {
            "median": float(np.median(constant / load)),
            "q90": float(np.quantile(constant / load, 0.9)),
            "mae_n": float(constant.mean()),
        },
    }


def _refused(found: LoadedPresses) -> dict[str, Any]:
    """Share of presses without a normal force: hard ones above 2 N, soft ones above 10 N, and each object's."""
    reasons = [why_no_normal(touch) for touch in found.touches]
    shares: dict[str, Any] = {}
    names = sorted({load.object for load in found.loads})
    groups = {"hard": HARD, "soft": tuple(set(names) - set(HARD)), **{name: (name,) for name in names}}
    for group, members in groups.items():
        for least in (LEAST_N, SOFT_N):
            chosen = [
                reason != ""
                for reason, load in zip(reasons, found.loads)
                if load.object in members and load.normal_n > least
            ]
            shares[f"{group}, above {least:g} N"] = float(np.mean(chosen))
    return shares


def presses() -> dict[str, Any]:
    """K from 1, 3, 5, 10 presses of one hard object, judged on the other: median error, and that of 90 % of draws."""
    found, rng = pressed(), np.random.default_rng(SEED)
    usable = [
        (load.object, touch.volume_mm3, load.normal_n)
        for touch, load in zip(found.touches, found.loads)
        if load.object in HARD and not why_no_normal(touch) and load.normal_n > LEAST_N
    ]
    of = {name: np.array([one[1:] for one in usable if one[0] == name]) for name in HARD}
    figures = {}
    for count in PRESS_COUNTS:
        errors = []
        for draw in range(DRAWS):
            own, other = (of[HARD[(draw + k) % 2]] for k in (0, 1))
            volume, load = own[rng.choice(len(own), count, replace=False)].T
            k = np.exp(np.median(np.log(load / volume)))
            errors.append(np.median(np.abs(k * other[:, 0] / other[:, 1] - 1)))
        figures[str(count)] = {"median": float(np.median(errors)), "q90": float(np.quantile(errors, 0.9))}
    return figures


@cache
def recording(k: int) -> tuple[list[Any], list[Load]]:
    """Touches and loads of a recording of force-dots."""
    with np.load(DATA / "force-dots" / f"recording-{k}.npz") as file:
        rest, moved, force, torque = (file[n] for n in ("rest_mm", "displacement_mm", "force_n", "torque"))
    touches = [gelform.touch_from_dots(rest, one) for one in moved]
    loads = [
        Load(f"recording {k}", shear_n=(float(x), float(y)), torsion_n_mm=1e3 * float(t))
        for (x, y, _), (_, _, t) in zip(force, torque)
    ]
    return touches, loads


def shear() -> dict[str, Any]:
    """Shear and torsion with one recording left out: mean error, share within 1 and 2 sigma, and a constant's error."""
    figures: dict[str, Any] = {}
    for k in range(RECORDINGS):
        others = [recording(j) for j in range(RECORDINGS) if j != k]
        model = gelform.calibrate_force(
            [t for one in others for t in one[0]], [x for one in others for x in one[1]]
        )
        found = gelform.evaluate_force(model, *recording(k))
        for part, rows in (("shear", found["shear"]), ("torsion", found["torsion"])):
            row = rows[-1]
            kept = {name: row[name] for name in ("presses", "refused", "mae", "within_1", "within_2")}
            figures[f"{part}, recording {k}"] = {**kept, "constant_mae": row["constant"]["mae"]}
    for part in ("shear", "torsion"):
        rows = [figures[f"{part}, recording {k}"] for k in range(RECORDINGS)]
        figures[part] = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
    return figures


def cost() -> dict[str, Any]:
    """Time that the force adds to a frame of 240x320, ms."""
    folder, found = DATA / "force-wedge", pressed()
    calibration = wedge()
    image = gelform.read_image(
        folder / next(n for n, t in zip(found.names, found.touches) if not why_no_normal(t))
    )
    result = gelform.Reconstructor(calibration)(image)
    surround = Surround(calibration.background)
    model = gelform.calibrate_force(found.touches, found.loads)
    calls = (
        lambda: surround(image, result.contact),
        lambda: force_from_result(result, model),
    )
    surround_ms, force_ms = median_ms(calls, rounds=200)
    return {"outside_change_ms": surround_ms, "force_ms": force_ms, "both_ms": surround_ms + force_ms}


PARTS = {"normal": normal, "presses": presses, "shear": shear, "cost": cost}


def main() -> None:
    """Run the named parts, or all; keep the earlier figures of the others."""
    command = command_line(__doc__)
    command.add_argument("--output", type=Path, metavar="FILE", default=RESULTS / "force.json")
    asked = parts_asked(command, PARTS)
    figures = json.loads(asked.output.read_text()) if asked.output.is_file() else {}
    for name in asked.parts:
        if data_is_missing(name):
            continue
        started = time.monotonic()
        figures[name] = PARTS[name]()
        print(f"\n{name} ({time.monotonic() - started:.0f} s): {(PARTS[name].__doc__ or '').splitlines()[0]}")
        print(
            table([name, "figures"], [[key, json.dumps(value)] for key, value in figures[name].items()]),
            flush=True,
        )
        asked.output.write_text(json.dumps({**figures, "machine": machine()}, indent=1, default=float) + "\n")


if __name__ == "__main__":
    main()
