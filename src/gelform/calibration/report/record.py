"""The record of a calibration run: its presses, candidates and held-out errors, and the error by the number of presses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from hashlib import sha256
from typing import Any

import numpy as np
from scipy.optimize import nnls

from gelform.arrays import Array, Map
from gelform.calibration.circles.find import prepare
from gelform.calibration.circles.locate import Located, Refined
from gelform.calibration.coverage import NEEDED
from gelform.calibration.held_out import Judged
from gelform.calibration.inputs import UNCHECKED, BallReading
from gelform.calibration.presses.press_set import Presses
from gelform.calibration.selection import (
    Candidate,
    Fitted,
    HeldOutPresses,
    Selection,
    candidates_for,
    candidates_from,
    fold_of,
    mean_of,
)
from gelform.calibration.start import Start
from gelform.calibration_file import Calibration
from gelform.errors import Progress, counted, no_progress
from gelform.foundations.files import DIGEST_SHOWN
from gelform.result.metrics import PressErrors


@dataclass(frozen=True)
class PressReport:
    """One press: its circle, whether it was used, and its errors when it was held out."""

    name: str  # path below the folder
    ball_diameter_mm: float
    center_x_px: float
    center_y_px: float
    contact_radius_px: float
    accepted: bool  # whether the calibration uses it
    reason: str | None  # the reason if not
    # As `PressErrors`, from a model that has not seen this press; None if rejected.
    errors: dict[str, float] | None
    center_sigma_px: float | None = None  # standard deviations (`circle_sigmas`); None if rejected
    contact_radius_sigma_px: float | None = None
    repeats: str | None = None  # name of the frame that stays, if this one shows its press again


@dataclass(frozen=True)
class CalibrationReport:
    """A calibration run; `pixels`, `caps_um`, `start` and `offered` are neither in `to_dict` nor saved."""

    presses: tuple[PressReport, ...]  # every press of the folder
    # The trials, selected or not: name, typical (geometric mean) slope error and mean normal error of the slopes that are
    # read on held-out presses.
    candidates: tuple[dict[str, Any], ...]
    # Errors over the presses (free center), each from a model selected and fitted without it: the errors of the whole
    # procedure on new presses.
    held_out: dict[str, float]
    seconds: float  # duration of the run
    notes: tuple[str, ...] = ()  # for the reader
    # The same errors for the saved model's kind and settings, fitted without each press; a little too small, because those
    # were selected on the same presses; empty in reports from before it was measured.
    held_out_saved: dict[str, float] = field(default_factory=dict)
    pixels: Array | None = field(default=None, repr=False, compare=False)  # some of each press (`PIXEL`)
    # index of the press -> depth minus the ball's cap (`errors_of`)
    caps_um: Mapping[int, Map] = field(default_factory=dict, repr=False, compare=False)
    balls: tuple[BallReading, ...] = ()  # of each stated diameter; empty if nothing could check it
    start: Start | None = field(default=None, repr=False)  # another unit's model that the fit began with
    offered: Start | None = field(default=None, repr=False)  # the starter's model that was offered to it

    def to_dict(self) -> dict[str, Any]:
        """The report, as values that JSON can hold, without the pixels, the caps and the start."""
        content = asdict(replace(self, pixels=None, caps_um={}, start=None, offered=None))
        del content["pixels"], content["caps_um"], content["start"], content["offered"]
        return {**content, "balls": [one.to_dict() for one in self.balls]}


def report_of_run(
    fitted: Fitted, judged: Judged, balls: Sequence[BallReading], *, notes: Sequence[str], seconds: float
) -> CalibrationReport:
    """The report of a calibration run from the results of its steps; `notes` follow its own."""
    located = fitted.held_out.located
    presses, begun = located.presses, located.start
    offered = begun if begun is not None and begun.offered else None
    candidates: list[dict[str, Any]] = [
        {
            "candidate": trial.candidate.describe(),
            "slope_error": float(np.exp(trial.mean_log())),
            "normal_free_deg": trial.normal_deg,
            "chosen": trial.candidate == fitted.selection.chosen,
        }
        for trial in fitted.selection.trials
    ]
    return CalibrationReport(
        presses=_press_rows(located, judged),
        candidates=tuple(sorted(candidates, key=lambda row: row["slope_error"])),
        held_out=summary(list(judged.errors.values())),
        seconds=seconds,
        notes=(
            _how_held_out(len(judged.errors), fitted.selection),
            *_of_repeated(located),
            *_of_starter(fitted.selection, offered),
            *presses.geometry.notes(presses.response, presses.mm_per_px_sigma),
            *(note for note in located.notes if note != UNCHECKED or not balls),
            *fitted.notes,
            *notes,
        ),
        held_out_saved=summary(list(judged.saved_errors.values())),
        pixels=judged.pixels,
        caps_um=judged.caps_um,
        balls=tuple(balls),
        start=fitted.selection.chosen.start,
        offered=offered,
    )


def _of_repeated(located: Located) -> tuple[str, ...]:
    again, all_ = len(located.repeated), len(located.presses.presses)
    if not again:
        return ()
    return (
        f"{again} of {all_} images show a press of another image again, with the same ball at the same place. They tell "
        f"nothing new, so {all_ - again} presses count. Lift the ball and press at another place for each image.",
    )


def _of_starter(selection: Selection, offered: Start | None) -> tuple[str, ...]:
    """How much a fit from the starter counts, and the held-out slope errors that weigh it."""
    if offered is None:
        return ()
    trials = {trial.candidate: trial for trial in selection.trials}
    share, _ = selection.chosen.parts[0]
    errors = [float(np.exp(trials[part].mean_log())) for _, part in selection.chosen.parts]
    return (
        f"{offered.subject} counts {100 * share:.0f} % in an average with a fit without it. Held-out slopes are off by "
        f"{errors[0]:.3f} with it and by {errors[1]:.3f} without it.",
    )


def _press_rows(located: Located, judged: Judged) -> tuple[PressReport, ...]:
    rows, refined, presses = [], located.refined, located.presses.presses
    for i, (press, contact, reason) in enumerate(zip(presses, refined.contacts, refined.reasons)):
        sigmas = judged.circle_sigmas.get(i, (None, None)) if reason is None else (None, None)
        rows.append(
            PressReport(
                press.name,
                press.ball_diameter_mm,
                *contact.circle_px,
                accepted=reason is None,
                reason=reason,
                errors=asdict(judged.errors[i]) if i in judged.errors else None,
                center_sigma_px=sigmas[0],
                contact_radius_sigma_px=sigmas[1],
                repeats=presses[located.repeated[i]].name if i in located.repeated else None,
            )
        )
    return tuple(rows)


def used_in_words(rows: Sequence[PressReport]) -> str:
    """The number of used presses among those that differ, and of the images that show them again."""
    again = sum(row.repeats is not None for row in rows)
    more = f" ({again} more images show them again)" if again else ""
    return f"{sum(row.accepted for row in rows)} of {counted(len(rows) - again, 'press')} used{more}"


def setting_in_words(value: Any) -> str:
    """A setting as a person reads it: four significant digits, lists joined, the beginning of a digest; none: nothing."""
    if isinstance(value, dict):
        return ", ".join(f"{name}: {setting_in_words(one)}" for name, one in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return " / ".join(setting_in_words(one) for one in value) or "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    text = "none" if value in (None, "") else str(value)
    is_digest = len(text) == 2 * sha256().digest_size and set(text) <= set("0123456789abcdef")
    return f"{text[:DIGEST_SHOWN]}…" if is_digest else text


def _how_held_out(presses: int, selection: Selection) -> str:
    agree = sum(candidate == selection.chosen for candidate in selection.by_fold)
    folds = len(selection.by_fold)
    by_folds = (
        "Each fold weighs the two fits by the presses of the others."
        if selection.chosen.parts
        else f"{agree} of {folds} folds chose the model that all presses together chose."
    )
    split = "that are each left out in turn" if folds == presses else f"in {folds} folds"
    return (
        f"Held-out errors are of {presses} presses {split}, and hold where presses are. gelform finds circles and model "
        f"without the presses of the fold that it judges. {by_folds}"
    )


FIGURES = {  # the figures of `summary`, with labels for people
    "presses": "presses",
    "normal_deg": "normal error, center from the circle (°)",
    "normal_free_deg": "normal error, center fitted (°)",
    "normal_rim_deg": "normal error up to the visible rim (°)",
    "cap_um": "depth error in the contact, center from the circle (um)",
    "cap_free_um": "depth error in the contact, center fitted (um)",
    "radius_percent": "ball radius error (%)",
    "radius_signed_percent": "ball radius error, with sign (%)",
    "off_contact_um": "depth error off the contact (um)",
}


def summary(errors: list[PressErrors]) -> dict[str, float]:
    """Means over presses; the median for a fitted sphere, because its errors have a long tail.

    Off-contact errors are averaged over the presses that leave any of the frame beyond 2.5 contact radii.
    """
    means = ("normal_deg", "normal_free_deg", "normal_rim_deg", "cap_um", "cap_free_um")
    off = [one.off_contact_um for one in errors if np.isfinite(one.off_contact_um)]
    radius = [one.radius_percent for one in errors]
    return {
        "presses": float(len(errors)),
        **{name: float(np.mean([getattr(one, name) for one in errors])) for name in means},
        "radius_percent": float(np.median(np.abs(radius))),
        "radius_signed_percent": float(np.median(radius)),
        **({"off_contact_um": float(np.mean(off))} if off else {}),
    }


DRAWS = 3  # draws of presses for each size
MORE = 10  # presses, whose gain is predicted
HELPS = 0.03  # fraction of the error, from which on a gain is worth saying


def learning_curve(
    presses: Presses, calibration: Calibration, *, rng: np.random.Generator, progress: Progress = no_progress
) -> dict[str, Any] | None:
    """Error of held-out presses by the number of training presses, of a calibration's presses in the same order.

    Three times a quarter of the accepted presses is held out, as `rng` splits them, and 5, 10, 15 ... of the others train
    the selected color model, with the same start. Their circles are refined without the held-out presses, so these have no
    part in the model that they judge. Under 30 presses simpler settings of the same color model are tried too, and the best
    is kept.

    The curve has `points` (presses, model, draws_deg, mean_deg), `expected` (the gain from more presses) and `sentence`; if
    a starter was offered, also `other_points`, of models without it, and `other`, which says so. It is
    None with fewer than 8 accepted presses, which leave nothing to hold out.
    """
    accepted = [i for i, row in enumerate(calibration.report.presses) if row.accepted]
    if not NEEDED.learning_curve.met(len(accepted)):
        return None
    own = presses.subset(accepted).reduced()
    ratio = calibration.settings["contact_radius_ratio"]
    prepared = [replace(press, contact_radius_ratio=ratio) for press in prepare(own)]
    rows = [calibration.report.presses[i] for i in accepted]
    of_rows = (own.from_read((row.center_x_px, row.center_y_px, row.contact_radius_px)) for row in rows)
    circles = tuple(
        replace(one.found, x_px=x, y_px=y, radius_px=radius) for one, (x, y, radius) in zip(prepared, of_rows)
    )
    refined = Refined(circles, (None,) * len(circles), None)
    located = Located(own, prepared, refined)
    held_out = HeldOutPresses(located, ())
    sizes = sizes_for(len(own.presses))
    orders = [rng.permutation(len(own.presses)).tolist() for _ in range(DRAWS)]
    begun, offered = calibration.report.start, calibration.report.offered

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
            others += point_of(size, None)
        progress(done + 1, len(sizes), "measuring the learning curve")
    curve = _with_expectation(points, len(own.presses))
    if curve is None or offered is None:
        return curve
    return {**curve, "other_points": others, "other": "without the starter"}


def held_out_count(accepted: int) -> int:
    """Number of accepted presses that a draw holds out."""
    return max(3, round(accepted / 4))


def sizes_for(accepted: int) -> list[int]:
    """Numbers of training presses; the last one is all that are not held out."""
    most = accepted - held_out_count(accepted)
    doubled = [NEEDED.started.presses * 2**k for k in range(most.bit_length())]
    return [size for size in doubled if size < most] + [most]


def candidates_of(calibration: Calibration, presses: int, start: Start | None) -> list[Candidate]:
    """The selected color model with settings that a number of presses can support, and the selected step."""
    if start is not None:  # one strength of the prior for model and step
        known, begun = calibration.settings.others, candidates_from(start, presses)
        begun = [replace(one, step_ridge=dict(one.settings)["ridge"]) for one in begun]
        alone = Candidate(start.model.name, (("ridge", known["own_ridge"]),)).with_steps(presses)[0]
        return [mean_of((one, alone), known["own_share"]) for one in begun]
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
    # The help of more presses is believed only if leaving out any draw gives the same.
    helped = {gain > HELPS for gain in gains}
    help_ = "may help" if len(helped) > 1 else "would help" if True in helped else "would not help much"
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
