"""Touch -> force in newtons, each with its standard deviation, or the reason for none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.depth.force.touch import Pressed, Touch, same_dots, touch_from_result
from gelform.foundations.checks import check_numbers, check_positive, check_values, check_within

# Where no normal force is stated. Of the first, hard objects have .08 to .34 and soft ones .40 to 1.09; docs/force.md has
# the rates of errors.
MOST_OUTSIDE_CHANGE = 0.4  # color change outside the contact, over that inside
LEAST_CONFIDENCE = 0.5  # mean in the contact
MOST_IN_BORDER = 0.05  # of the volume, in the band along the border
BEYOND_RANGE = 1.2  # of the largest calibrated load
DOT_TOLERANCE = (
    0.15  # of the dots' spacing; a shifted grid of the same pitch passes by chance in 7 % (pi 0.15^2)
)
UNIT = "N"
NO_LOADS = "no loads were calibrated. Press with known loads: gelform force calibrate"


@dataclass(frozen=True)
class Spread:
    """The standard deviation of a force: a relative part and a floor, learnt by leaving objects out.

    Attributes
    ----------
    relative : standard deviation over the force
    floor : standard deviation at no force, in the unit of the force
    """

    relative: float
    floor: float

    def __post_init__(self) -> None:
        check_within(self.relative, "relative", 0, 1e3)
        check_within(self.floor, "floor", 0, 1e6)

    def of(self, force: float) -> float:
        """The standard deviation of a force."""
        return float(np.hypot(self.relative * force, self.floor))


@dataclass(frozen=True)
class NormalForce:
    """F = K V.

    Attributes
    ----------
    k_n_per_mm3 : K; it is empirical, no constant of the material
    range_n : smallest and largest load
    spread : of the force
    loads : number of loads that were used
    """

    k_n_per_mm3: float
    range_n: tuple[float, float]
    spread: Spread
    loads: int


@dataclass(frozen=True)
class DotForce:
    """A force that is linear in the motion of the dots.

    Attributes
    ----------
    weights : one row for each component of the force: of x, y, turn, tilt along x and y, and the constant of the gauge
    range : the largest magnitude of the loads
    spread : of each component
    loads : number of loads that were used
    """

    weights: tuple[tuple[float, ...], ...]
    range: float
    spread: Spread
    loads: int

    def __call__(self, motion: tuple[float, ...]) -> NDArray[np.float64]:
        """The components of the force."""
        return np.asarray(self.weights) @ np.array([*motion, 1.0])


@dataclass(frozen=True, eq=False)
class ForceModel:
    """Converts touches to newtons; it belongs to one calibration and its gel.

    Attributes
    ----------
    normal, shear, torsion : of each kind of force; None without loads of that kind
    rest_mm : positions of the dots at rest, ((x, y), ...); empty without dots
    objects : what was pressed
    calibration_digest : of the calibration; results of another one are refused. "" for dots without images
    created_utc : time
    """

    normal: NormalForce | None
    shear: DotForce | None
    torsion: DotForce | None
    rest_mm: tuple[tuple[float, float], ...]
    objects: tuple[str, ...]
    calibration_digest: str
    created_utc: str

    @cached_property
    def dots(self) -> NDArray[np.float64]:
        """`rest_mm` as an array (N, 2)."""
        return np.array(self.rest_mm, dtype=np.float64).reshape(-1, 2)

    def to_dict(self) -> dict[str, Any]:
        """The model, as values that JSON can hold."""
        return {"unit": UNIT, **asdict(self)}

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> ForceModel:
        """The model from `to_dict`; KeyError, TypeError or ValueError: it is no model."""
        if stored["unit"] != UNIT:
            raise ValueError(f"Expected a force in {UNIT}, got {stored['unit']!r}.")
        normal, shear, torsion = (stored[name] for name in ("normal", "shear", "torsion"))
        texts = [stored["calibration_digest"], stored["created_utc"], *stored["objects"]]
        if not all(isinstance(text, str) for text in texts):
            raise TypeError("Expected objects, a digest and a date as texts.")
        return cls(
            None if normal is None else _normal_from(normal),
            None if shear is None else _dots_from(shear, 2),
            None if torsion is None else _dots_from(torsion, 1),
            tuple((x, y) for x, y in (check_numbers(place, "rest_mm", 2) for place in stored["rest_mm"])),
            tuple(stored["objects"]),
            stored["calibration_digest"],
            stored["created_utc"],
        )


def _normal_from(stored: Mapping[str, Any]) -> NormalForce:
    low, high = check_numbers(stored["range_n"], "range_n", 2)
    k = check_positive(stored["k_n_per_mm3"], "k_n_per_mm3")
    return NormalForce(
        k, (low, check_positive(high, "range_n")), Spread(**stored["spread"]), int(stored["loads"])
    )


def _dots_from(stored: Mapping[str, Any], rows: int) -> DotForce:
    weights = np.asarray(check_values(stored["weights"], "weights", (), np.float64))
    if weights.shape != (rows, 6):
        raise ValueError(f"Expected weights of shape ({rows}, 6), got {weights.shape}.")
    reach = check_positive(stored["range"], "range")
    return DotForce(
        tuple(map(tuple, weights.tolist())), reach, Spread(**stored["spread"]), int(stored["loads"])
    )


@dataclass(frozen=True)
class Force:
    """The force on the gel; what is not known is None, and has a reason.

    Attributes
    ----------
    normal_n, normal_sigma_n : into the gel, N, and its standard deviation
    shear_n, shear_sigma_n : (x, y) along the gel, in the axes of the loads, N, and the standard deviation of each
    torsion_n_mm, torsion_sigma_n_mm : about the view, N mm
    normal_reason, shear_reason, torsion_reason : why the force is None; "" if it is known
    """

    normal_n: float | None = None
    normal_sigma_n: float | None = None
    shear_n: tuple[float, float] | None = None
    shear_sigma_n: float | None = None
    torsion_n_mm: float | None = None
    torsion_sigma_n_mm: float | None = None
    normal_reason: str = ""
    shear_reason: str = ""
    torsion_reason: str = ""

    @property
    def reason(self) -> str:
        """Why a part is None, each reason once; "" if all are known."""
        return "; ".join(
            dict.fromkeys(filter(None, (self.normal_reason, self.shear_reason, self.torsion_reason)))
        )


def force_from_result(result: Pressed, model: ForceModel | None) -> Force:
    """The force of one result.

    Parameters
    ----------
    result : a `Reconstruction`
    model : of the result's calibration, `calibration.force`; None if no loads were calibrated

    Returns
    -------
    Force
        With a standard deviation for each part, or None and the reason: a soft object or a contact beyond the view, low
        confidence, a contact at the border, a force beyond the calibrated range, another gel, no dots.
    """
    return force_from_touch(touch_from_result(result), model)


def force_from_touch(touch: Touch, model: ForceModel | None) -> Force:
    """As `force_from_result`, of a touch."""
    if model is None:
        return Force(normal_reason=NO_LOADS, shear_reason=NO_LOADS, torsion_reason=NO_LOADS)
    normal, normal_reason = _normal(touch, model)
    shear, shear_reason = _of_dots(touch, model, model.shear)
    torsion, torsion_reason = _of_dots(touch, model, model.torsion)
    return Force(
        normal_n=normal,
        normal_sigma_n=None if normal is None or model.normal is None else model.normal.spread.of(normal),
        shear_n=None if shear is None else (float(shear[0]), float(shear[1])),
        shear_sigma_n=_sigma(shear, model.shear),
        torsion_n_mm=None if torsion is None else float(torsion[0]),
        torsion_sigma_n_mm=_sigma(torsion, model.torsion),
        normal_reason=normal_reason,
        shear_reason=shear_reason,
        torsion_reason=torsion_reason,
    )


def why_no_normal(touch: Touch) -> str:
    """Why a touch tells no normal force, whatever the model; "" if it does."""
    if touch.volume_mm3 is None:
        return "the scale is unknown"
    if touch.volume_mm3 <= 0 or touch.outside_change is None:
        return "no contact: nothing touches, or something too soft or too flat to be seen"
    if touch.outside_change >= MOST_OUTSIDE_CHANGE:
        return (
            f"a soft object, or a contact beyond the view: the color around the contact changed by "
            f"{touch.outside_change:.2f} of the change inside"
        )
    if touch.confidence < LEAST_CONFIDENCE:
        return (
            f"low confidence: its mean in the contact is {touch.confidence:.2f}, below {LEAST_CONFIDENCE:g}"
        )
    if touch.border_share > MOST_IN_BORDER:
        return f"a contact at the border: {100 * touch.border_share:.0f} % of it, so part of it may be out of view"
    return ""


def _normal(touch: Touch, model: ForceModel) -> tuple[float | None, str]:
    if model.normal is None:
        return None, NO_LOADS
    if reason := _other_gel(touch, model) or why_no_normal(touch):
        return None, reason
    force = model.normal.k_n_per_mm3 * float(touch.volume_mm3 or 0)
    most = BEYOND_RANGE * model.normal.range_n[1]
    if force > most:
        return (
            None,
            f"beyond the calibrated range: {force:.3g} N, and loads were up to {model.normal.range_n[1]:.3g} N",
        )
    return force, ""


def _of_dots(
    touch: Touch, model: ForceModel, part: DotForce | None
) -> tuple[NDArray[np.float64] | None, str]:
    if part is None:
        return None, NO_LOADS
    if touch.rest_mm is None:
        return None, "the gel has no dots, or no scale"
    if reason := _other_gel(touch, model) or why_other_dots(touch.rest_mm, model.dots):
        return None, reason
    if touch.dots is None:
        return None, "fewer than half of the dots are seen"
    force = part(touch.dots)
    if np.linalg.norm(force) > BEYOND_RANGE * part.range:
        return None, f"beyond the calibrated range: loads were up to {part.range:.3g}"
    return force, ""


def _other_gel(touch: Touch, model: ForceModel) -> str:
    if touch.calibration_digest == model.calibration_digest:
        return ""
    return "another gel, or another calibration, than the one of the loads"


def why_other_dots(rest_mm: NDArray[np.float64], known_mm: NDArray[np.float64]) -> str:
    """Why dots (N, 2) are not the known ones (M, 2); "" if they are."""
    if same_dots(rest_mm, known_mm, DOT_TOLERANCE):
        return ""
    return f"dots of another gel: {len(rest_mm)} at other places than the calibrated {len(known_mm)}"


def _sigma(force: NDArray[np.float64] | None, part: DotForce | None) -> float | None:
    return None if force is None or part is None else part.spread.of(float(np.linalg.norm(force)))
