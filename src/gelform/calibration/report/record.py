"""The record of a calibration run: the presses, the candidates, the held-out errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from gelform.arrays import Array, Map
from gelform.calibration.circles.locate import Located
from gelform.calibration.coverage import NEEDED
from gelform.calibration.held_out import Judged
from gelform.calibration.inputs import BallReading
from gelform.calibration.selection import Fitted, Selection
from gelform.calibration.start import Start
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
            *located.notes,
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
    """Whether the fit began with the starter, and the held-out slope errors behind that decision."""
    if offered is None:
        return ()
    with_start, without = (
        [one.mean_log() for one in selection.trials if (one.candidate.start is not None) == begun]
        for begun in (True, False)
    )
    if not without:
        return (
            f"{offered.subject} was used. With under {NEEDED.edge.presses} presses no fit without it is tried.",
        )
    used = "was used" if selection.chosen.start is not None else "was not used"
    errors = [float(np.exp(min(logs))) if logs else float("nan") for logs in (with_start, without)]
    return (
        f"{offered.subject} {used}. Held-out slopes are off by {errors[0]:.3f} with it and by {errors[1]:.3f} without it.",
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
    return f"{sum(row.accepted for row in rows)} of {len(rows) - again} presses used{more}"


def setting_in_words(value: Any) -> str:
    """A setting as a person reads it: four significant digits, lists joined, the beginning of a digest; none: nothing."""
    if isinstance(value, dict):
        return ", ".join(f"{name}: {setting_in_words(one)}" for name, one in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return " / ".join(setting_in_words(one) for one in value) or "none"
    if isinstance(value, float):
        return f"{value:.4g}"
    text = "none" if value in (None, "") else str(value)
    is_digest = len(text) == 64 and set(text) <= set("0123456789abcdef")
    return f"{text[:DIGEST_SHOWN]}…" if is_digest else text


def _how_held_out(presses: int, selection: Selection) -> str:
    agree = sum(candidate == selection.chosen for candidate in selection.by_fold)
    folds = len(selection.by_fold)
    split = "that are each left out in turn" if folds == presses else f"in {folds} folds"
    return (
        f"Held-out errors are of {presses} presses {split}, and hold where presses are. gelform finds circles and model "
        f"without the presses of the fold that it judges. {agree} of {folds} folds chose the model that all presses "
        "together chose."
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
