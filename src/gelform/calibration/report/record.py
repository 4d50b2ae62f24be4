"""What a calibration run found: the presses, the candidates, the held-out errors."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from gelform.calibration.report.held_out import HeldOutSample
from gelform.metrics import PressErrors


@dataclass(frozen=True)
class PressReport:
    """One press: its circle, whether it was used, and its errors when it was held out.

    Attributes
    ----------
    name : path below the folder
    ball_diameter_mm : float
    center_x_px, center_y_px, contact_radius_px : the circle found
    center_sigma_px, contact_radius_sigma_px : its standard deviations (`circle_sigmas`); None where rejected
    accepted : whether the calibration uses it
    reason : why not
    errors : names and values of PressErrors, from a model that has not seen this press; None where rejected
    """

    name: str
    ball_diameter_mm: float
    center_x_px: float
    center_y_px: float
    contact_radius_px: float
    accepted: bool
    reason: str | None
    errors: dict[str, float] | None
    center_sigma_px: float | None = None
    contact_radius_sigma_px: float | None = None


@dataclass(frozen=True)
class CalibrationReport:
    """A calibration run.

    Attributes
    ----------
    presses : every press of the folder
    candidates : what was tried: name, held-out normal error and its standard error in degrees, chosen or not
    held_out : errors over the presses, each from a model that has not seen it (centre free)
    seconds : how long it took
    notes : what a reader should know
    samples : of each press that was held out, some pixels with their slopes; not in `to_dict`, not saved
    """

    presses: tuple[PressReport, ...]
    candidates: tuple[dict[str, Any], ...]
    held_out: dict[str, float]
    seconds: float
    notes: tuple[str, ...] = ()
    samples: tuple[HeldOutSample, ...] = field(default=(), repr=False)

    def to_dict(self) -> dict[str, Any]:
        """The report as JSON can hold it, without the samples."""
        content = asdict(replace(self, samples=()))
        del content["samples"]
        return content


def summary(errors: list[PressErrors]) -> dict[str, float]:
    """Means over presses; the median where a sphere is fitted, whose errors have a long tail.

    Off-contact errors are averaged over the presses that leave any of the frame beyond 2.5 contact radii.
    """
    off = [e.off_contact_um for e in errors if np.isfinite(e.off_contact_um)]
    radius = [e.radius_percent for e in errors]
    figures = {
        "presses": float(len(errors)),
        "normal_deg": float(np.mean([e.normal_deg for e in errors])),
        "normal_free_deg": float(np.mean([e.normal_free_deg for e in errors])),
        "cap_um": float(np.mean([e.cap_um for e in errors])),
        "cap_free_um": float(np.mean([e.cap_free_um for e in errors])),
        "radius_percent": float(np.median(np.abs(radius))),
        "radius_signed_percent": float(np.median(radius)),
    }
    return {**figures, "off_contact_um": float(np.mean(off))} if off else figures
