"""Starters: depth of a unit without presses, few presses with a starter, and detection of a wrong ball diameter.

    python benchmarks/starters.py             # about an hour; writes results/starters.json
    python benchmarks/starters.py units       # one part: units, presses, few, balls, simulated
    python benchmarks/starters.py presses --draws 3
    python benchmarks/starters.py --make      # makes the starters that the package ships, from the data

The tested unit had no part in the starter. Real presses are read from GELFORM_DATA (default ../shared/data). The stated
diameter of mini-d's ball, 4.0 mm, is doubtful: its contacts are as wide as those of a ball of 4.70 mm, which counts as right
here.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import gelform
from accuracy.real import EDGES, KEYS, scored, summary
from gelform.calibration.circles.locate import locate
from gelform.calibration.inputs import MOST_SIGMAS, ball_readings
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report import report_content
from gelform.calibration.start import start_from
from gelform.calibration.starters import Starter, load_starter, starter_from_calibration
from gelform.errors import CalibrationError
from gelform.result.metrics import OFF_CONTACT
from presses import DATA, data_is_missing, labeled, mini_ball, unlabeled
from real_frames.beyond import slopes_inside, sure_inner
from report import command_line, parts_asked, recorded, table, write
from starters.make import LAYOUT, LIKELY, make, real_unit, simulated_unit, stated, unit_of

FOLDS, DRAWS = 3, 10
SIZES = (3, 5, 8, 12, 20, 33)
FACTORS = (0.5, 0.8, 1.0, 1.2, 1.25, 2.0)
SETS = ("mini-ball", "mini-d", "digit-ball", "gelslim", "gelslim-dots", "gelsight-ball-deep")
PAIRS = {"digit-c": "digit-ball", "digit-ball": "digit-c", "mini-d": "mini-ball", "mini-ball": "mini-d"}
FEW, TEST = (5, 7, 9, 3, 8), 10  # presses that calibrate, and at most so many others that judge
SHARES = ("within_sigma_percent", "within_2_sigma_percent", "sure_inner_percent", "off_stated_um")
SHOWN = (*KEYS, *SHARES)
UNSEEN = 11  # number of a simulated unit outside the starter


def mini_d() -> Presses:
    """mini-d with its likely diameter and the circles for scoring."""
    return labeled(real_unit("mini-d"))


def judged(calibration: gelform.Calibration, presses: Presses, edge: float) -> dict[str, float]:
    """Errors on labeled presses; shares of slopes inside the edge within one sigma, and of sure pixels in 0.6 of it."""
    reconstruct, rows, within = gelform.Reconstructor(calibration), [], []
    pitch = calibration.known_mm_per_px
    for press in presses.presses:
        result = reconstruct.from_image(press.image)
        rows.append(scored((press, result), press.label, pitch, edge))
        _, off, _ = slopes_inside(press, result, edge)
        y, x = np.ogrid[: result.depth_mm.shape[0], : result.depth_mm.shape[1]]
        far = np.hypot(x - press.label[0], y - press.label[1]) > OFF_CONTACT * press.label[2]
        stated = 1e3 * float(np.sqrt(np.square(result.depth_sigma_mm[far]).mean())) if far.any() else np.nan
        shares = 100 * (off <= 1).mean(), 100 * (off <= 2).mean(), 100 * sure_inner(result, press)
        within.append((*shares, stated))
    return {**summary(rows), **dict(zip(SHARES, np.nanmean(within, axis=0)))}


def units() -> dict[str, Any]:
    """No press: the starter of one unit on another, against that unit's own calibration on held-out presses."""
    found: dict[str, Any] = {}
    presses = mini_d()
    ball, order = mini_ball()
    of_ball, of_d = (of_one(gelform.calibrate(unlabeled(one), start=None)) for one in (ball, presses))
    unit = unit_of(of_ball, presses.background, presses.mm_per_px)
    found["mini-d, the starter made of mini-ball"] = judged(unit, presses, EDGES["mini-d"])
    unit = unit_of(of_d, ball.background, ball.mm_per_px)
    found["mini-ball, the starter made of mini-d"] = judged(unit, ball.subset(order), EDGES["mini-ball"])
    found["mini-d, its own calibration"] = _folds(presses, EDGES["mini-d"])
    for name, (own, other) in {"even": (order[0::2], order[1::2]), "odd": (order[1::2], order[0::2])}.items():
        half = unit_of(of_one(gelform.calibrate(unlabeled(ball, own), start=None)), ball.background)
        found[f"mini-ball, {name} presses made the starter"] = judged(
            half, ball.subset(other), EDGES["mini-ball"]
        )
    print(table(["no press", *SHOWN], [[n, *(v[k] for k in SHOWN)] for n, v in found.items()]))
    return found


def of_one(calibration: gelform.Calibration) -> Starter:
    """A starter of one unit of a Mini, with the differences between units that the shipped starter states."""
    shipped = load_starter("gelsight-mini")
    stated = {"spread": shipped.spread, "color_variance": shipped.color_variance}
    return starter_from_calibration(calibration, "gelsight-mini", units=("one",), **stated)


def _folds(presses: Presses, edge: float) -> dict[str, float]:
    parts = []
    for fold in range(FOLDS):
        others, own = (
            [i for i in range(len(presses.presses)) if (i % FOLDS == fold) == held] for held in (False, True)
        )
        calibration = gelform.calibrate(unlabeled(presses, others), start=None)
        parts.append(judged(calibration, presses.subset(own), edge))
    return {key: float(np.mean([part[key] for part in parts])) for key in parts[0]}


def presses(draws: int = DRAWS) -> dict[str, Any]:
    """The learning curve of a second Mini, without and with the other one as a start, on presses new to both."""
    found: dict[str, Any] = {}
    units = {"mini-d": mini_d(), "mini-ball": mini_ball()[0]}
    starts = {name: of_one(gelform.calibrate(unlabeled(one), start=None)) for name, one in units.items()}
    for (name, known), other in zip(units.items(), reversed(units)):
        unit, rng = unit_of(starts[other], known.background, known.mm_per_px), np.random.default_rng(0)
        for size in SIZES:
            found[f"{name}, {size} presses"] = row = _drawn(name, known, unit, size, draws, rng)
            print(f"{name}, {size} presses, {draws} draws", *(f"{kind}: {one['edge_deg']:.2f} deg (between draws "
                  f"{one['between_draws_deg']:.2f}), {one['radius_percent']:.1f} %, within sigma "
                  f"{one['within_sigma_percent']:.0f} %" for kind, one in row.items()), sep="; ", flush=True)  # fmt: skip
    return {**found, "draws": draws}


def _drawn(
    name: str,
    known: Presses,
    unit: gelform.Calibration,
    size: int,
    draws: int,
    rng: np.random.Generator,
) -> dict[str, dict[str, float]]:
    """Mean errors of calibrations on some presses of a unit, without and with a start, on a third of the others."""
    rows: dict[str, list[dict[str, float]]] = {"alone": [], "started": []}
    count = len(known.presses)
    for _ in range(draws):
        order = rng.permutation(count)
        training, test = order[:size].tolist(), known.subset(order[-count // 3 :].tolist())
        for kind, begun in (("alone", None), ("started", unit)):
            calibration = gelform.calibrate(unlabeled(known, training), start=begun)
            rows[kind].append(judged(calibration, test, EDGES[name]))
    found = {kind: {k: float(np.mean([one[k] for one in own])) for k in SHOWN} for kind, own in rows.items()}
    for kind, own in rows.items():
        found[kind]["between_draws_deg"] = float(np.std([one["edge_deg"] for one in own]))
    return found


def few(draws: int = 4) -> dict[str, Any]:
    """Few presses of four units, with the other unit of the make as a start."""
    found: dict[str, Any] = {}
    for name, other in PAIRS.items():
        known, first = (labeled(real_unit(one)) for one in (name, other))
        shipped = load_starter("digit" if name.startswith("digit") else "gelsight-mini")
        stated = {"spread": shipped.spread, "color_variance": shipped.color_variance}
        own = gelform.calibrate(unlabeled(first), start=None)
        starter = starter_from_calibration(own, shipped.sensor, units=(other,), **stated)
        unit, rng = unit_of(starter, known.background, known.mm_per_px), np.random.default_rng(0)
        for size in FEW:
            rows = []
            for _ in range(draws):
                order = rng.permutation(len(known.presses)).tolist()
                test = known.subset(order[size:][-TEST:])
                made = gelform.calibrate(unlabeled(known, order[:size]), start=unit)
                rows.append(judged(made, test, EDGES.get(name, EDGES["digit-ball"])))
            found[f"{name} from {other}, {size} presses"] = {
                key: float(np.mean([row[key] for row in rows])) for key in SHOWN
            }
        print(
            table([f"few presses, {name}", *SHOWN], [[n, *(v[k] for k in SHOWN)] for n, v in found.items()])
        )
    return {**found, "draws": draws}


def balls() -> dict[str, Any]:
    """Every real set with right and wrong diameters: recovered sizes, and the verdict."""
    found: dict[str, Any] = {"read": _read_by_others(), "verdicts": {}}
    for name in SETS:
        right = LIKELY if name == "mini-d" else 1.0
        whole = gelform.read_presses(DATA / name)
        some = unlabeled(whole, range(0, len(whole.presses), 2))
        for factor in FACTORS:
            said = _verdict(stated(some, right * factor))
            found["verdicts"][f"{name} x {factor:g}"] = said
            print(f"{name} x {factor:g}: {said}", flush=True)
    return found


def _verdict(presses: Presses) -> str:
    try:
        calibration = gelform.calibrate(presses)
    except CalibrationError as problem:
        hint = (
            "look like a ball of" in str(problem)
            or "check ball_diameter_mm" in str(problem)
            or "is wrong" in str(problem)
        )
        return "refused, with the diameter named" if hint else "refused"
    content = report_content(presses, calibration, rng=np.random.default_rng(0))
    return str(content["verdict"]["headline"])


def _read_by_others() -> dict[str, Any]:
    """Diameters of Minis recovered with presses of other units, over the right ones, and the factors that are detected."""
    ball, order = mini_ball()
    halves = [order[0::2], order[1::2]]
    cases: list[tuple[str, Presses, Any]] = []
    other = real_unit("mini-d")
    of_ball = of_one(gelform.calibrate(unlabeled(ball), start=None))
    unit = unit_of(of_ball, other.background, other.mm_per_px)
    cases.append(("mini-d", other, start_from(unit, other, "auto")))
    for own, rest in (halves, halves[::-1]):
        of_half = gelform.calibrate(unlabeled(ball, own), start=None)
        test = unlabeled(ball, rest)
        start = start_from(unit_of(of_one(of_half), test.background), test, "auto")
        cases.append((f"mini-ball, {'odd' if own is halves[0] else 'even'}", test, start))
    rows: dict[str, Any] = {}
    for name, test, start in cases:
        for factor in FACTORS:
            for one in ball_readings(locate(stated(test, factor)), start):
                right = one.stated_mm / factor
                rows[f"{name}, {right:.3g} mm x {factor:g}"] = {
                    "read_over_right": one.read_mm / right,
                    "sigmas": one.sigmas,
                    "alarm": one.sigmas > MOST_SIGMAS,
                }
    for name, row in rows.items():
        print(f"{name}: read {row['read_over_right']:.3f} times as large, {row['sigmas']:.1f} sigma")
    return rows


def simulated() -> dict[str, Any]:
    """A simulated unit outside the starter, read by the starter of four others."""
    unit = simulated_unit(UNSEEN)
    known = labeled(unit)
    starter = load_starter(f"simulated-{LAYOUT}")
    found = {
        "starter": judged(starter.for_unit(known.background), known, 0.8),
        "its own calibration": _folds(known, 0.8),
    }
    print(table(["simulated unit", *SHOWN], [[n, *(v[k] for k in SHOWN)] for n, v in found.items()]))
    return found


PARTS = {"units": units, "presses": presses, "few": few, "balls": balls, "simulated": simulated}


def main() -> None:
    """Make the starters, or measure the named parts, or all."""
    command = command_line(__doc__)
    command.add_argument("--make", action="store_true", help="make the starters, and measure nothing")
    command.add_argument("--draws", type=int, default=DRAWS, help="draws of presses for each size")
    asked = parts_asked(command, PARTS)
    if asked.make:
        make()
        return
    results = recorded("starters")
    for name in asked.parts:
        if name != "simulated" and data_is_missing(name):
            continue
        results[name] = presses(asked.draws) if name == "presses" else PARTS[name]()
        write("starters", results)


if __name__ == "__main__":
    main()
