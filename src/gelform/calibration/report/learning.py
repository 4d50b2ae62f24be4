"""The learning curve: the error on held-out presses by the number of presses, and the gain from more presses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import nnls

from gelform.calibration.circles.find import prepare
from gelform.calibration.circles.locate import Located, Refined
from gelform.calibration.coverage import NEEDED
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.selection import Candidate, HeldOutPresses, candidates_for, candidates_from, fold_of
from gelform.calibration.start import Start
from gelform.calibration_file import Calibration
from gelform.foundations.findings import Progress, no_progress

DRAWS = 3  # draws of presses for each size
MORE = 10  # presses, whose gain is predicted


def learning_curve(
    presses: Presses, calibration: Calibration, *, rng: np.random.Generator, progress: Progress = no_progress
) -> dict[str, Any] | None:
    """Error of held-out presses by the number of training presses, of a calibration's presses in the same order.

    Three times a quarter of the accepted presses is held out, as `rng` splits them, and 5, 10, 15 ... of the others train
    the selected color model, with the same start. Their circles are refined without the held-out presses, so these have no
    part in the model that they judge. Under 30 presses simpler settings of the same color model are tried too, and the best
    is kept.

    The curve has `points` (presses, model, draws_deg, mean_deg), `expected` (the gain from more presses) and `sentence`; if
    a starter was offered, also `other_points`, of models with the other choice of start, and `other`, that choice. It is
    None with fewer than 8 accepted presses, which leave nothing to hold out.
    """
    accepted = [i for i, row in enumerate(calibration.report.presses) if row.accepted]
    if not NEEDED.learning_curve.met(len(accepted)):
        return None
    own = presses.subset(accepted)
    ratio = calibration.settings["contact_radius_ratio"]
    prepared = [replace(press, contact_radius_ratio=ratio) for press in prepare(own)]
    rows = [calibration.report.presses[i] for i in accepted]
    circles = tuple(
        replace(one.found, x_px=row.center_x_px, y_px=row.center_y_px, radius_px=row.contact_radius_px)
        for one, row in zip(prepared, rows)
    )
    refined = Refined(circles, (None,) * len(circles), None)
    located = Located(own, prepared, refined)
    held_out = HeldOutPresses(located, ())
    sizes = sizes_for(len(own.presses))
    orders = [rng.permutation(len(own.presses)).tolist() for _ in range(DRAWS)]
    begun, offered = calibration.report.start, calibration.report.offered
    other_start = offered if begun is None else None

    def point_of(size: int, start: Start | None) -> list[dict[str, Any]]:
        candidates, draws = candidates_of(calibration, size, start), []
        started = replace(located, refined_by=None if start is None else start.model)
        for order in orders:
            fold = fold_of(started, order[-held_out_count(len(order)) :], order[:size])
            if NEEDED.model.met(len(fold.training)):
                trials = held_out.try_candidates(candidates, [fold])
                draws.append([trial.normal_deg for trial in trials])
        if not draws:
            return []
        degrees = np.array(draws)
        best = int(degrees.mean(axis=0).argmin())
        point = {
            "presses": size,
            "model": candidates[best].describe(),
            "draws_deg": degrees[:, best].tolist(),
        }
        return [{**point, "mean_deg": float(degrees[:, best].mean())}]

    points, others = [], []
    for done, size in enumerate(sizes):
        points += point_of(size, begun)
        if offered is not None:
            others += point_of(size, other_start)
        progress(done + 1, len(sizes), "measuring the learning curve")
    curve = _with_expectation(points, len(own.presses))
    if curve is None or offered is None:
        return curve
    return {
        **curve,
        "other_points": others,
        "other": "without the starter" if begun else f"from {offered.by}",
    }


def held_out_count(accepted: int) -> int:
    """Number of accepted presses that a draw holds out."""
    return max(3, round(accepted / 4))


def sizes_for(accepted: int) -> list[int]:
    """Numbers of training presses; the last one is all that are not held out."""
    most = accepted - held_out_count(accepted)
    return [size for size in (5, 10, 15, 20, 30, 45, 70, 100, 150) if size < 0.9 * most] + [most]


def candidates_of(calibration: Calibration, presses: int, start: Start | None) -> list[Candidate]:
    """The selected color model with settings that a number of presses can support, and the selected step."""
    if start is not None:  # one strength of the prior for model and step
        options = candidates_from(start, presses)
        return [replace(one, step_ridge=dict(one.settings)["ridge"]) for one in options]
    step = calibration.settings.step_ridge
    options = candidates_for(calibration.color_model.name, presses)
    if calibration.report.start is not None:  # its settings are of the other kind of fit
        return [one.with_steps(presses)[0] for one in options]
    options = [replace(candidate, step_ridge=step) for candidate in options]
    own = tuple((key, calibration.settings.others[key]) for key, _ in options[0].settings)
    chosen = Candidate(calibration.color_model.name, own, None, step)
    if NEEDED.settings.met(presses):
        return [chosen]
    return options[: options.index(chosen) + 1] if chosen in options else [*options, chosen]


def floor_and_slope(presses: Sequence[float], degrees: Sequence[float]) -> tuple[float, float]:
    """(a, b) of `error^2 = a + b/n`, both >= 0: a remains for any number of presses, b/n falls with it.

    It uses least squares on the relative error, so that the small errors of many presses count as much.
    """
    square = np.square(np.asarray(degrees, dtype=np.float64))
    design = np.stack([np.ones(square.size), 1 / np.asarray(presses, dtype=np.float64)], axis=1)
    floor, slope = nnls(design / square[:, None], np.ones(square.size))[0]
    return float(floor), float(slope)


def _with_expectation(points: list[dict[str, Any]], accepted: int) -> dict[str, Any] | None:
    """The curve with the expected gain of `MORE` presses; None if two points do not determine it."""
    late = [p for p in points if NEEDED.learning_law.met(p["presses"])]
    used = late if len(late) >= 3 else points
    if len(used) < 2:
        return None
    now, later, (floor, slope) = _expected(used, accepted, None)
    without = [_expected(used, accepted, draw) for draw in range(DRAWS)]
    gains = [1 - late / soon for soon, late, _ in without]
    # The help of more presses, a gain of over 3 %, is believed only if leaving out any draw gives the same.
    help_ = "would help" if min(gains) > 0.03 else "would not help much" if max(gains) <= 0.03 else "may help"
    return {
        "points": points,
        "held_out_presses": held_out_count(accepted),
        "expected": {
            "presses_now": accepted,
            "now_deg": now,
            "presses_more": MORE,
            "more_deg": later,
            "more_deg_range": [min(one[1] for one in without), max(one[1] for one in without)],
            "floor_deg": float(np.sqrt(floor)),
            "square_slope_deg2": slope,
            "help": help_,
        },
        "sentence": f"More presses {help_}. With {MORE} more, gelform expects an angle error of "
        f"{later:.2f}° instead of {now:.2f}°.",
    }


def _expected(
    points: Sequence[dict[str, Any]], accepted: int, without: int | None
) -> tuple[float, float, tuple[float, float]]:
    """Errors now and with `MORE` presses by the law of the draws' means, without one draw or with all.

    The fit uses the means, not the draws: all sizes of a draw are tested on the same presses, so an easy or a
    hard draw moves the whole curve and cancels.
    """
    means = []
    for p in points:
        kept = [value for draw, value in enumerate(p["draws_deg"]) if draw != without]
        means.append(float(np.mean(kept or p["draws_deg"])))
    floor, slope = floor_and_slope([p["presses"] for p in points], means)
    now, later = (float(np.sqrt(floor + slope / n)) for n in (accepted, accepted + MORE))
    return now, later, (floor, slope)
