"""Touch -> force in newtons, each with its standard deviation, or the reason for none."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.depth.force.touch import Touch, touch_from_result
from gelform.foundations.checks import check_numbers, check_positive, check_values, check_within

KINDS = {"normal": "n", "shear": "n", "torsion": "n_mm"}  # of force, with their units
SHAPES = {"normal": (1, 1), "shear": (2, 6), "torsion": (1, 6)}  # of their weights: components, terms
UNIT = "N"
# Where no normal force is stated. Of the first, hard objects have .08 to .34 and soft ones .40 to 1.09; docs/force.md has
# the rates of errors.
MOST_OUTSIDE_CHANGE = 0.4  # color change outside the contact, over that inside
LEAST_CONFIDENCE = 0.5  # mean in the contact
MOST_IN_BORDER = 0.05  # of the volume, in the band along the border
MOST_VOLUME_SIGMA = 0.4  # of the volume
FALLING_SIGMA = 0.5  # of a falling normal force
BEYOND_RANGE = 1.2  # of the largest calibrated load
DOT_TOLERANCE = 0.15  # of the dots' spacing; a shifted grid of that pitch passes in 7 % (pi 0.15^2)
NO_LOADS = "no loads were calibrated (gelform force calibrate)"


@dataclass(frozen=True)
class ForcePart:
    """One kind of force, which is linear in the terms of a touch.

    Attributes
    ----------
    weights : one row for each component. Of a normal force, K in N/mm^3, which is empirical, no constant of the material; of
        shear and torsion, those of x, y, turn, tilt along x and y, and the constant of the gauge
    range : smallest and largest magnitude of the loads
    relative, floor : standard deviation over the force, and at no force, learnt by leaving grasps out
    loads : number of loads that were used
    """

    weights: tuple[tuple[float, ...], ...]
    range: tuple[float, float]
    relative: float
    floor: float
    loads: int

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any], shape: tuple[int, int]) -> ForcePart:
        """The part from its fields; KeyError, TypeError or ValueError: these are none."""
        weights = np.asarray(check_values(stored["weights"], "weights", (), np.float64))
        if weights.shape != shape:
            raise ValueError(f"Expected weights of shape {shape}, got {weights.shape}.")
        low, high = check_numbers(stored["range"], "range", 2)
        relative, floor = (check_within(stored[name], name, 0, 1e6) for name in ("relative", "floor"))
        high, loads = check_positive(high, "range"), int(check_positive(stored["loads"], "loads"))
        return cls(tuple(map(tuple, weights.tolist())), (low, high), relative, floor, loads)

    def sigma(self, force: NDArray[np.float64], touch: Touch | None = None) -> float:
        """The standard deviation of each component of a force; one of a touch's volume has that of the volume too."""
        size, relative = np.linalg.norm(force), self.relative
        if touch is not None and touch.volume_mm3:
            relative = max(self.relative, FALLING_SIGMA) if touch.falling else self.relative
            relative = np.hypot(relative, touch.volume_sigma_mm3 / touch.volume_mm3)
        return float(np.hypot(relative * size, self.floor))


class Dots:
    """The dots of a gel, by whose places (N, 2) at rest, mm, it is told from another one."""

    def __init__(self, places: NDArray[np.float64]) -> None:
        self._tree, self._count = scipy.spatial.cKDTree(places), len(places)
        spacing = np.median(self._tree.query(places, k=2)[0][:, 1]) if len(places) else 0.0
        self._near = DOT_TOLERANCE * float(spacing)

    def why_none(self, touch: Touch) -> str:
        """Why a touch tells no motion of these dots; "" if it does."""
        if (rest := touch.rest_mm) is None:
            return "no dots, or no scale"
        alike = 2 * min(len(rest), self._count) > max(len(rest), self._count)
        if not alike or np.median(self._tree.query(rest)[0]) > self._near:
            return f"dots of another gel: {len(rest)} at other places than the calibrated {self._count}"
        return "few dots: more than half are not seen" if touch.dots is None else ""


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
    lag_frames : that the gauge lagged behind the images of its recordings; None if unknown
    """

    normal: ForcePart | None
    shear: ForcePart | None
    torsion: ForcePart | None
    rest_mm: tuple[tuple[float, ...], ...]
    objects: tuple[str, ...]
    calibration_digest: str
    created_utc: str
    lag_frames: int | None = None

    @cached_property
    def dots(self) -> Dots:
        """The dots at rest."""
        return Dots(np.array(self.rest_mm, dtype=np.float64).reshape(-1, 2))

    def to_dict(self) -> dict[str, Any]:
        """The model, as values that JSON can hold."""
        return {"unit": UNIT, **asdict(self)}

    @classmethod
    def from_dict(cls, stored: Mapping[str, Any]) -> ForceModel:
        """The model from `to_dict`; KeyError, TypeError or ValueError: it is no model."""
        texts = [stored["unit"], stored["calibration_digest"], stored["created_utc"], *stored["objects"]]
        if not all(isinstance(text, str) for text in texts) or stored["unit"] != UNIT:
            raise TypeError(f"Expected a force in {UNIT}, with a digest, a date and objects as texts.")
        normal, shear, torsion = (
            None if stored[kind] is None else ForcePart.from_dict(stored[kind], SHAPES[kind])
            for kind in KINDS
        )
        rest = tuple(check_numbers(place, "rest_mm", 2) for place in stored["rest_mm"])
        _, digest, created, *objects = texts
        lag = stored.get("lag_frames")
        lag = None if lag is None else int(check_within(lag, "lag_frames", -1e6, 1e6))
        return cls(normal, shear, torsion, rest, tuple(objects), digest, created, lag)


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
    normal_reason: str = NO_LOADS
    shear_n: tuple[float, float] | None = None
    shear_sigma_n: float | None = None
    shear_reason: str = NO_LOADS
    torsion_n_mm: float | None = None
    torsion_sigma_n_mm: float | None = None
    torsion_reason: str = NO_LOADS

    @property
    def reason(self) -> str:
        """Why a part is None, each reason once; "" if all are known."""
        return "; ".join(
            dict.fromkeys(filter(None, (self.normal_reason, self.shear_reason, self.torsion_reason)))
        )

    @property
    def vector_n(self) -> NDArray[np.float64]:
        """(3,), N: x and y along the gel, and z; what presses into the gel pushes toward the camera, -z. NaN: not known."""
        x, y = self.shear_n or (None, None)
        return np.array([x, y, self.normal_n], dtype=np.float64) * (1, 1, -1)

    def columns(self) -> dict[str, float | str | None]:
        """The cells of a table, by name: None where a force is not known, and `force_reason`."""
        cells = {name: value for name, value in vars(self).items() if not name.endswith("_reason")}
        x, y = cells.pop("shear_n") or (None, None)
        return {"shear_x_n": x, "shear_y_n": y, **cells, "force_reason": self.reason}


def force_from_result(result: Any, model: ForceModel | None) -> Force:
    """The force of one result.

    Parameters
    ----------
    result : a `Reconstruction`, or its touch
    model : of the result's calibration, `calibration.force`; None if no loads were calibrated

    Returns
    -------
    Force
        With a standard deviation for each part, or None and the reason: a soft object or a contact beyond the view, low
        confidence, an uncertain volume, a contact at the border, a force beyond the calibrated range, another gel, no dots.

    Raises
    ------
    TypeError
        No result, or no model.
    """
    if model is not None and not isinstance(model, ForceModel):
        raise TypeError(f"Expected a ForceModel or None as model, got {type(model).__name__}.")
    touch = result if isinstance(result, Touch) else touch_from_result(result)
    found: dict[str, Any] = {}
    for kind, unit in KINDS.items():
        part: ForcePart | None = getattr(model, kind, None)
        if model is None or part is None:
            continue
        reason = _why_other(touch, model) or (
            why_no_normal(touch) if kind == "normal" else model.dots.why_none(touch)
        )
        if reason == "":
            force = np.asarray(part.weights) @ terms_of(touch, kind)
            if np.linalg.norm(force) <= BEYOND_RANGE * part.range[1]:
                value = force.tolist()
                found[f"{kind}_{unit}"] = value[0] if len(value) == 1 else tuple(value)
                found[f"{kind}_sigma_{unit}"] = part.sigma(force, touch if kind == "normal" else None)
            else:
                reason = f"beyond the calibrated range: loads were up to {part.range[1]:.3g}"
        found[f"{kind}_reason"] = reason
    return Force(**found)


def terms_of(touch: Touch, kind: str) -> NDArray[np.float64]:
    """The terms that the weights of a kind of force multiply."""
    return np.array([touch.volume_mm3] if kind == "normal" else [*(touch.dots or ()), 1.0], dtype=np.float64)


def why_no_normal(touch: Touch) -> str:
    """Why a touch tells no normal force, whatever the model; "" if it does."""
    if touch.volume_mm3 is None:
        return "no scale, or a depth from a zero that was set"
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
    if (share := touch.volume_sigma_mm3 / touch.volume_mm3) > MOST_VOLUME_SIGMA:
        return f"an uncertain volume: its standard deviation is {100 * share:.0f} % of it"
    if touch.border_share > MOST_IN_BORDER:
        return f"a contact at the border: {100 * touch.border_share:.0f} % of it, so part of it may be out of view"
    return ""


def _why_other(touch: Touch, model: ForceModel) -> str:
    same = touch.calibration_digest == model.calibration_digest
    return "" if same else "another gel, or another calibration, than the one of the loads"
