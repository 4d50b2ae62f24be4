"""Touch -> force in newtons, each with its standard deviation or the reason for none; and its fit to known loads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from functools import cached_property
from itertools import product
from typing import Any, NamedTuple

import cv2
import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Mask, Numbers
from gelform.errors import DataError
from gelform.foundations.checks import (
    check_list,
    check_mm_per_px,
    check_number,
    check_numbers,
    check_positive,
    check_values,
    check_within,
)
from gelform.image.light import REST_SIGMA
from gelform.slopes.sigma import ONE_SIGMA


class DotMotion(NamedTuple):
    """The motion of all dots together: mean displacement, mm, turn about the view, rad, and tilt, mm/mm."""

    x_mm: float
    y_mm: float
    turn_rad: float
    tilt_x: float
    tilt_y: float


@dataclass(frozen=True, eq=False)
class Touch:
    """The numbers of one result from which a force is read."""

    # Of the depth in the contact; 0 without a contact; None without a scale, or from a zero that was set.
    volume_mm3: float | None = None
    confidence: float = 0.0  # mean in the contact
    # Median outside the contact over the mean inside; None: no contact, or no outside.
    outside_change: float | None = None
    inside_change: float | None = None  # mean inside the contact, RMS of a channel
    border_share: float = 0.0  # the part of the volume that lies in the band along the border
    dots: DotMotion | None = None  # None if the gel has none, or fewer than half are seen
    rest_mm: Numbers | None = None  # (N, 2), positions of all dots at rest; None without dots
    calibration_digest: str = ""  # of the calibration behind the result
    volume_sigma_mm3: float = 0.0  # standard deviation of the volume
    falling: bool = False  # whether the contact had more volume before, as `touches_in_order` tells


def touch_from_result(result: Any) -> Touch:
    """The touch of a result, which is a `Reconstruction`; TypeError: it is none."""
    if not all(hasattr(result, name) for name in ("contact", "mm_per_px", "zero", "confidence", "depth")):
        raise TypeError(f"Expected a Reconstruction, got {type(result).__name__}.")
    contact, pitch = result.contact, result.mm_per_px
    motion, rest = _dots_of(result)
    known: dict[str, Any] = {"dots": motion, "rest_mm": rest, "calibration_digest": result.calibration_digest}
    if pitch is None or result.zero == "set":
        return Touch(**known)
    if not contact.any():
        return Touch(volume_mm3=0.0, **known)
    x, y, width, height = cv2.boundingRect(contact.view(np.uint8))
    box = slice(y, y + height), slice(x, x + width)
    touched, pressed = contact[box], result.depth[box] * contact[box]
    rim, (rows, columns) = max(1, round(len(contact) / 30)), contact.shape  # 8 px of 240 along the border
    inside = pressed[max(rim - y, 0) : max(rows - rim - y, 0), max(rim - x, 0) : max(columns - rim - x, 0)]
    # Neighbors err alike, so the volume is as uncertain as the depth.
    deviation = result.depth_sigma_mm
    sigma = 0.0 if deviation is None else float(deviation[box][touched].sum(dtype=np.float64))
    area = float(np.prod(check_mm_per_px(pitch)))
    whole, inner = float(pressed.sum(dtype=np.float64)), float(inside.sum(dtype=np.float64))
    return Touch(
        volume_mm3=whole * area,
        volume_sigma_mm3=sigma * area,
        confidence=float(result.confidence[box][touched].mean()),
        outside_change=result.outside_change,
        inside_change=result.inside_change,
        border_share=min(max(1 - inner / whole, 0.0), 1.0) if whole > 0 else 0.0,
        **known,
    )


def touches_in_order(results: Iterable[Any]) -> Iterator[Touch]:
    """The touches of results, or of touches, in the order of their frames: they know whether the force falls.

    A gel that is released keeps its force longer than its contact, so a volume says less about a falling force. It falls
    with less than 0.9 of the largest volume of the contact.
    """
    largest = 0.0
    for one in results:
        touch = one if isinstance(one, Touch) else touch_from_result(one)
        volume = touch.volume_mm3 or 0.0
        largest = max(largest, volume) if volume > 0 else 0.0
        yield replace(touch, falling=volume < 0.9 * largest)


def touch_from_dots(rest_mm: ArrayLike, displacement_mm: ArrayLike) -> Touch:
    """The touch that dots alone show.

    Parameters
    ----------
    rest_mm : (N, 2) or (N, 3), positions of the dots at rest
    displacement_mm : (N, 3), x, y, and z toward the camera; or (N, 2), which shows no tilt

    Raises
    ------
    ValueError, TypeError
        Wrong shapes, NaN, or fewer than three dots, or all in a line.
    """
    rest = np.asarray(check_values(rest_mm, "rest_mm", (), np.float64))
    moved = np.asarray(check_values(displacement_mm, "displacement_mm", (), np.float64))
    if rest.shape[-1:] not in ((2,), (3,)) or moved.shape not in ((len(rest), 2), (len(rest), 3)):
        raise ValueError(f"Expected dots of shape (N, 2) or (N, 3), got {rest.shape} and {moved.shape}.")
    if (motion := _motion(rest, moved)) is None:
        raise ValueError("Expected three dots or more that are not in a line.")
    return Touch(dots=motion, rest_mm=rest[:, :2])


def _motion(rest: Numbers, moved: Numbers) -> DotMotion | None:
    """The motion of dots (N, 2 or 3) from rest (N, 2 or more), mm; None for fewer than three, or a line."""
    if len(rest) < 3:
        return None
    places = np.column_stack([rest[:, :2] - rest[:, :2].mean(axis=0), np.ones(len(rest))])
    # Dots within 1e-6 of their length lie in a line, however their places were rounded.
    along, _, rank, _ = np.linalg.lstsq(places, moved, rcond=1e-6)
    if rank < 3:
        return None
    tilt = along[:2, 2] if moved.shape[1] == 3 else np.zeros(2)
    return DotMotion(*map(float, (*along[2, :2], (along[0, 1] - along[1, 0]) / 2, *tilt)))


def _dots_of(result: Any) -> tuple[DotMotion | None, Numbers | None]:
    """Motion and rest of a result's dots; the depth at a dot is its displacement toward the camera."""
    flow, scale = result.markers, result.mm_per_px
    if flow is None or scale is None:
        return None, None
    pitch = np.array(check_mm_per_px(scale))
    rest = flow.rest_px * pitch
    if 2 * np.count_nonzero(flow.seen) < len(flow):
        return None, rest
    height, width = result.depth.shape
    x, y = np.clip(np.rint(flow.now_px).astype(int), 0, (width - 1, height - 1)).T
    moved = np.column_stack([flow.displacement_px * pitch, result.depth[y, x]])
    return _motion(rest[flow.seen], moved[flow.seen]), rest


KINDS = {"normal": "n", "shear": "n", "torsion": "n_mm"}  # of force, with their units
TERMS = len(DotMotion._fields) + 1
SHAPES = {"normal": (1, 1), "shear": (2, TERMS), "torsion": (1, TERMS)}  # of their weights: components, terms
UNIT = "N"
NO_LOADS = "no loads were calibrated (gelform force calibrate)"


@dataclass(frozen=True)
class ForcePart:
    """One kind of force, which is linear in the terms of a touch.

    Each component has a row of weights. Of a normal force it is K in N/mm^3, which is empirical, no constant of the
    material; of shear and torsion, those of x, y, turn, tilt along x and y, and the constant of the gauge.
    """

    weights: tuple[tuple[float, ...], ...]
    range: tuple[float, float]  # smallest and largest magnitude of the loads
    relative: float  # standard deviation over the force, learnt by leaving grasps out
    floor: float  # the one at no force
    loads: int  # number of loads that were used

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

    def sigma(self, force: Numbers, touch: Touch | None = None) -> float:
        """The standard deviation of each component of a force; one of a touch's volume has that of the volume too."""
        size, relative = np.linalg.norm(force), self.relative
        if touch is not None and touch.volume_mm3:
            relative = max(self.relative, 0.5) if touch.falling else self.relative
            relative = np.hypot(relative, touch.volume_sigma_mm3 / touch.volume_mm3)
        return float(np.hypot(relative * size, self.floor))


class Dots:
    """The dots of a gel, by whose places (N, 2) at rest, mm, it is told from another one."""

    def __init__(self, places: Numbers) -> None:
        self._tree, self._count = scipy.spatial.cKDTree(places), len(places)
        spacing = np.median(self._tree.query(places, k=2)[0][:, 1]) if len(places) else 0.0
        self._near = 0.15 * float(spacing)  # a shifted grid of that pitch passes in 7 % (pi 0.15^2)

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
    """The force on the gel with its standard deviations; what is not known is None, and has a reason."""

    normal_n: float | None = None  # into the gel, N
    normal_sigma_n: float | None = None
    normal_reason: str = NO_LOADS  # why it is None; "" if it is known
    shear_n: tuple[float, float] | None = None  # (x, y) along the gel, in the axes of the loads, N
    shear_sigma_n: float | None = None  # of each
    shear_reason: str = NO_LOADS
    torsion_n_mm: float | None = None  # about the view, N mm
    torsion_sigma_n_mm: float | None = None
    torsion_reason: str = NO_LOADS

    @property
    def reason(self) -> str:
        """Why a part is None, each reason once; "" if all are known."""
        reasons = self.normal_reason, self.shear_reason, self.torsion_reason
        return "; ".join(dict.fromkeys(filter(None, reasons)))

    @property
    def vector_n(self) -> Numbers:
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
        With a standard deviation for each part, or None and the reason: a contact cut by the view, a light and wide one, a
        soft object, low confidence, an uncertain volume, a force beyond the calibrated range, another gel, no dots.

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
        if touch.calibration_digest != model.calibration_digest:
            reason = "another gel, or another calibration, than the one of the loads"
        else:
            reason = why_no_normal(touch) if kind == "normal" else model.dots.why_none(touch)
        if reason == "":
            force = np.asarray(part.weights) @ terms_of(touch, kind)
            if np.linalg.norm(force) <= 1.2 * part.range[1]:
                value = force.tolist()
                found[f"{kind}_{unit}"] = value[0] if len(value) == 1 else tuple(value)
                found[f"{kind}_sigma_{unit}"] = part.sigma(force, touch if kind == "normal" else None)
            else:
                reason = f"beyond the calibrated range: loads were up to {part.range[1]:.3g}"
        found[f"{kind}_reason"] = reason
    return Force(**found)


def terms_of(touch: Touch, kind: str) -> Numbers:
    """The terms that the weights of a kind of force multiply."""
    return np.array([touch.volume_mm3] if kind == "normal" else [*(touch.dots or ()), 1.0], dtype=np.float64)


def why_no_normal(touch: Touch) -> str:
    """Why a touch tells no normal force, whatever the model; "" if it does. docs/force.md has the rates of errors."""
    if touch.volume_mm3 is None:
        return "no scale, or a depth from a zero that was set"
    if touch.volume_mm3 <= 0 or (touch.outside_change is None and touch.inside_change is None):
        return "no contact: nothing touches, or something too soft or too flat to be seen"
    if touch.outside_change is None or touch.border_share > 0.05:
        return (
            f"a contact cut by the view: {100 * touch.border_share:.0f} % of it lies at the border. Press in the middle, or "
            "with less force"
        )
    # On a GelSight Wedge nine of ten touches of hard objects have less than .28 and of soft ones more than .32.
    if touch.outside_change >= (soft := 0.3):
        around = f"the color around it changed by {touch.outside_change:.2f} of the {touch.inside_change or 0:.3f} inside"
        # The change around a contact is then no more than that between two moments at rest.
        if (touch.inside_change or np.inf) < REST_SIGMA / soft:
            return (
                f"a light and wide contact: {around}, so that soft and hard objects look alike. Press harder"
            )
        return f"a soft object: {around}. Its force does not follow from the depth"
    if touch.confidence < 0.5:
        return f"low confidence: its mean in the contact is {touch.confidence:.2f}, below 0.5"
    if (share := touch.volume_sigma_mm3 / touch.volume_mm3) > 0.4:
        return f"an uncertain volume: its standard deviation is {100 * share:.0f} % of it"
    return ""


LEAST_LOADS, LEAST_OBJECTS, LEAST_RANGE = 3, 3, 3.0  # the last: the largest load over the smallest
LEAST_SHARE = 0.05  # of the largest normal load; smaller ones, also below 0, are the gauge's zero
LARGEST_LOAD = 1e9  # N and N mm; no press has more, and its square is far from the end of numbers
KNOWN_K = 0.045  # N/mm^3, middle of hard objects on the studied gel (.036 to .051)


@dataclass(frozen=True)
class Load:
    """The known load of one press; what was not measured is None.

    Attributes
    ----------
    object : name of what pressed, or of the recording
    normal_n : into the gel, N
    shear_n : (x, y) along the gel, N
    torsion_n_mm : about the view, N mm
    grasp : of the object, by name: its presses err alike
    """

    object: str
    normal_n: float | None = None
    shear_n: tuple[float, float] | None = None
    torsion_n_mm: float | None = None
    grasp: str = ""


def calibrate_force(
    presses: Sequence[Any], loads: Sequence[Load], *, sure_of_unit: bool = False
) -> ForceModel:
    """Fit a force model to presses with known loads.

    The normal force is K times the volume of the depth in the contact, with the median of log F - log V. Shear and torsion
    are linear in the motion of the dots. Standard deviations come from leaving out one grasp after the other, or object
    without grasps. Falling forces are left out.

    Parameters
    ----------
    presses : results or touches, of one calibration
    loads : of the same presses; three objects with three or four loads each, over a range of 1 to 10, are good
    sure_of_unit : do not compare the normal loads with the stiffness of known gels

    Raises
    ------
    DataError
        Fewer than three usable loads, a range under 1 to 3, negative loads, loads not in newtons or no numbers, no contact,
        dots of several gels, or results of several calibrations.
    ValueError, TypeError
        Another number of loads than of presses, or no loads.
    """
    touches, loads = _matched(presses, loads)
    digests = {touch.calibration_digest for touch in touches}
    if len(digests) > 1:
        raise DataError("Expected presses of one calibration and gel, got results of several calibrations.")
    normal, shear, torsion = (_fit(kind, touches, loads) for kind in KINDS)
    if normal is None and shear is None and torsion is None:
        raise DataError("Expected loads: a column force_n, or force_x_n and force_y_n.")
    k = KNOWN_K if normal is None or sure_of_unit else normal.weights[0][0]
    for unit, per_newton in (("grams", 1000 / scipy.constants.g), ("kilograms", 1 / scipy.constants.g)):
        if np.log(k / KNOWN_K) / np.log(per_newton) > 0.5:  # nearer to that unit than to newtons
            raise DataError(
                f"The loads look like {unit}: {k:.3g} of their unit for each mm^3, where newtons give about {KNOWN_K:g}. "
                f"Multiply them by {1 / per_newton:.4g} to get newtons. If they are newtons, say so: sure_of_unit=True "
                "(--sure-of-unit)."
            )
    rest = next((one.rest_mm for one in touches if one.rest_mm is not None), np.empty((0, 2)))
    objects = tuple(sorted({load.object for load in loads}))
    now = datetime.now(timezone.utc).isoformat(timespec="seconds")
    places = tuple(map(tuple, rest.tolist()))
    return ForceModel(normal, shear, torsion, places, objects, digests.pop(), now)


def evaluate_force(model: ForceModel, presses: Sequence[Any], loads: Sequence[Load]) -> dict[str, Any]:
    """Errors of a model on presses with known loads, beside those of the best constant, as values that JSON can hold.

    Parameters
    ----------
    model : from `calibrate_force`
    presses : results or touches
    loads : of the same presses

    Returns
    -------
    evaluation : `normal`, `shear` and `torsion`, each a row for each object and one of "all": the `presses` with that load,
        the part `refused`, the errors of the others (`mae`; `median` and `q90` of the relative error, of normal loads from
        2 N), the part `within_1` and `within_2` sigma, and `constant`, the same errors of the best constant. `reasons`: the
        number of presses without a normal force, by reason

    Raises
    ------
    ValueError, TypeError
        Another number of loads than of presses, or no loads.
    """
    touches, loads = _matched(presses, loads)
    forces = [force_from_result(touch, model) for touch in touches]
    reasons = Counter(force.normal_reason.partition(":")[0] for force in forces if force.normal_reason)
    return {kind: _rows(kind, forces, loads) for kind in KINDS} | {"reasons": dict(reasons)}


def sigma_ratio(model: ForceModel, presses: Sequence[Any], loads: Sequence[Load]) -> float | None:
    """Errors of the normal force over their stated sigma: the ratio that 68.3 % stay below; 1 is right. None without any."""
    touches, loads = _matched(presses, loads)
    found = [(force_from_result(touch, model), load.normal_n) for touch, load in zip(touches, loads)]
    ratios = [
        abs(force.normal_n - truth) / force.normal_sigma_n
        for force, truth in found
        if force.normal_n is not None and force.normal_sigma_n and truth is not None
    ]
    return float(np.quantile(ratios, ONE_SIGMA)) if ratios else None


def _matched(presses: Sequence[Any], loads: Sequence[Load]) -> tuple[list[Touch], list[Load]]:
    """The touches of presses and their loads, checked."""
    known, given = check_list(loads, "loads", Load), check_list(presses, "presses")
    for load, kind in product(known, KINDS):
        if not isinstance(load.object, str):
            raise TypeError(f"Expected each load's object as a name, got {load.object!r:.60}.")
        name, count = f"{kind}_{KINDS[kind]}", SHAPES[kind][0]
        if (value := getattr(load, name)) is None:
            continue
        numbers = [check_number(one, name) for one in (check_list(value, name) if count == 2 else [value])]
        if len(numbers) != count or not all(abs(one) <= LARGEST_LOAD for one in numbers):
            raise DataError(
                f"Expected a load's {name} as {count} finite number{'s' * (count > 1)} of at most {LARGEST_LOAD:g}, got "
                f"{value!r:.60}. Leave it out if it was not measured."
            )
    if len(given) != len(known):
        raise ValueError(f"Expected one load for each press, got {len(known)} for {len(given)} presses.")
    return [one if isinstance(one, Touch) else touch_from_result(one) for one in given], known


def _value(one: Load | Force, kind: str) -> Any:
    return getattr(one, f"{kind}_{KINDS[kind]}")


def _fit(kind: str, touches: list[Touch], loads: list[Load]) -> ForcePart | None:
    """The part of the model for a kind of force; None without such loads."""
    measured = [i for i, load in enumerate(loads) if _value(load, kind) is not None]
    if not measured:
        return None
    target = np.array([_value(loads[i], kind) for i in measured], dtype=np.float64).reshape(len(measured), -1)
    if kind == "normal":
        own = [touches[i] for i in measured]
        reasons = [why_no_normal(touch) or ("the force falls" if touch.falling else "") for touch in own]
    else:
        reasons = _why_no_dots([touches[i] for i in measured])
    usable = np.array([reason == "" for reason in reasons])
    if kind == "normal":
        _check_signs(target)
        usable &= target[:, 0] >= max(LEAST_SHARE * np.max(target[usable], initial=0), 1e-9)
    if np.count_nonzero(usable) < LEAST_LOADS:
        most = Counter(filter(None, reasons)).most_common(1)
        why = f" Most others: {most[0][0]}." if most else ""
        raise DataError(
            f"Expected at least {LEAST_LOADS} loads ({kind}) of presses that tell one, got {np.count_nonzero(usable)} of "
            f"{len(measured)}.{why}"
        )
    terms = np.array([terms_of(touches[i], kind) for i, use in zip(measured, usable) if use])
    grasps = np.array([(loads[i].object, loads[i].grasp) for i, use in zip(measured, usable) if use])
    target, solve = target[usable], _stiffness if kind == "normal" else _weights
    size = np.linalg.norm(target, axis=1)
    if size.max() < LEAST_RANGE * size.min() or size.max() <= 0:
        raise DataError(
            f"Expected loads ({kind}) over a range of 1 to {LEAST_RANGE:g} or more, got {size.min():.3g} to "
            f"{size.max():.3g}. Press lightly and firmly."
        )
    predicted = np.empty_like(target)
    for out in _folds(grasps):
        predicted[out] = terms[out] @ solve(terms[~out], target[~out])
    relative, floor = _spread(predicted, target)
    if len(set(grasps[:, 0])) < LEAST_OBJECTS:  # they do not show what others do
        relative = max(relative, 0.3)
    weights = tuple(map(tuple, solve(terms, target).T.tolist()))
    return ForcePart(weights, (float(size.min()), float(size.max())), relative, floor, len(target))


def _why_no_dots(touches: list[Touch]) -> list[str]:
    """Why each touch tells no motion of the first one's dots; DataError for dots of several gels."""
    first = next((touch.rest_mm for touch in touches if touch.rest_mm is not None), np.empty((0, 2)))
    dots = Dots(first)
    reasons = [dots.why_none(touch) for touch in touches]
    if other := next((reason for reason in reasons if "another gel" in reason), ""):
        raise DataError(f"Expected presses of one gel, got {other}.")
    return reasons


def _check_signs(force: Numbers) -> None:
    """Refuse loads that are negative beyond the error of a gauge's zero."""
    lowest, largest = float(force.min()), float(force.max())
    if lowest < -LEAST_SHARE * max(largest, 0.0) or largest <= 0:
        raise DataError(
            f"Expected loads of 0 N or more into the gel, got {lowest:.3g} N. Turn the sign of the gauge, or set its "
            "zero while nothing touches."
        )


def _stiffness(terms: Numbers, target: Numbers) -> Numbers:
    return np.exp(np.median(np.log(target) - np.log(terms), axis=0, keepdims=True))


def _weights(terms: Numbers, target: Numbers) -> Numbers:
    """Weights (terms, components): all of them, or with few loads only k_t of the displacement, or of the turn."""
    count, components = terms.shape[1], target.shape[1]
    if len(terms) >= 3 * count:
        return np.asarray(np.linalg.lstsq(terms, target, rcond=None)[0])
    weights, first = np.zeros((count, components)), [0, 1] if components == 2 else [2]
    own = terms[:, first]
    weights[first, range(components)] = np.sum(own * target) / max(float(np.sum(own**2)), 1e-12)
    return weights


def _folds(grasps: NDArray[np.str_]) -> list[Mask]:
    """The presses of each object and grasp (N, 2); of a lone one, five parts in the order of the presses."""
    names, part = np.unique(grasps, axis=0, return_inverse=True)
    if len(names) == 1:
        part = np.arange(len(grasps)) * min(5, len(grasps)) // len(grasps)
    return [part.ravel() == k for k in np.unique(part)]


def _spread(force: Numbers, truth: Numbers) -> tuple[float, float]:
    """Standard deviations of forces (N, components): the relative one of all, then the floor from the smallest quarter.

    Both are such that 68 % of the errors are within one standard deviation.
    """
    error, size = np.abs(force - truth), np.linalg.norm(force, axis=1)[:, None]
    larger = np.maximum(size, np.linalg.norm(truth, axis=1)[:, None])
    relative = float(np.quantile(error / np.maximum(larger, 1e-12), ONE_SIGMA))
    small = (larger <= np.quantile(larger, 0.25))[:, 0]
    left = np.maximum(error[small] ** 2 - (relative * size[small]) ** 2, 0)
    return relative, float(np.sqrt(np.quantile(left, ONE_SIGMA)))


def _rows(kind: str, forces: list[Force], loads: list[Load]) -> list[dict[str, Any]]:
    """A row of errors for each object, then one of all; none without such loads."""
    parts = [(f, load) for f, load in zip(forces, loads) if _value(load, kind) is not None]
    if not parts:
        return []
    center = np.median(np.array([_value(load, kind) for _, load in parts], dtype=np.float64), axis=0)
    names = sorted({load.object for _, load in parts})
    groups = [(name, [part for part in parts if part[1].object == name]) for name in names]
    return [_row(kind, name, own, center) for name, own in [*groups, ("all", parts)]]


def _row(kind: str, name: str, parts: list[tuple[Force, Load]], center: Numbers) -> dict[str, Any]:
    known = [part for part in parts if _value(part[0], kind) is not None]
    row: dict[str, Any] = {"object": name, "presses": len(parts), "refused": 1 - len(known) / len(parts)}
    if not known:
        return row
    force, truth = (np.array([_value(one, kind) for one in of]).reshape(len(known), -1) for of in zip(*known))
    sigma = np.array([getattr(f, f"{kind}_sigma_{KINDS[kind]}") for f, _ in known])[:, None]
    off = np.abs(force - truth) / np.maximum(sigma, 1e-12)
    within = {f"within_{n}": float(np.mean(off <= n)) for n in (1, 2)}
    least = 2.0 if kind == "normal" else 0.0  # N; of smaller loads no relative error is stated
    constant = _errors(np.broadcast_to(center, truth.shape), truth, least)
    return row | _errors(force, truth, least) | within | {"constant": constant}


def _errors(force: Numbers, truth: Numbers, least: float) -> dict[str, float | None]:
    """Mean error of the components; median and 90 % of the relative error where the truth is larger than `least`."""
    size = np.linalg.norm(truth, axis=1)
    relative = (np.linalg.norm(force - truth, axis=1) / np.maximum(size, 1e-12))[size > least]
    shares = [float(np.quantile(relative, share)) if relative.size else None for share in (0.5, 0.9)]
    return {"mae": float(np.abs(force - truth).mean()), "median": shares[0], "q90": shares[1]}
