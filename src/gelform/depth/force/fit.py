"""Presses with known loads -> ForceModel, and the errors of a model on further presses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.depth.force.model import (
    DotForce,
    Force,
    ForceModel,
    NormalForce,
    Spread,
    force_from_touch,
    why_no_normal,
    why_other_dots,
)
from gelform.depth.force.touch import Pressed, Touch, as_touches
from gelform.errors import DataError
from gelform.foundations.checks import check_list

LEAST_LOADS, LEAST_RANGE = 3, 3.0  # loads, and the largest over the smallest
LEAST_SHARE = 0.05  # of the largest load; smaller ones, also below 0, are the gauge's zero and do not count
KNOWN_K = 0.045  # N/mm^3, middle of hard objects on the studied gel (.036 to .051)
G_PER_N, KG_PER_N = 1000 / 9.80665, 1 / 9.80665
LOADS_PER_TERM = 3  # loads for each weight of a dot force; with fewer, only its first term is fitted
LONE_SPREAD = (
    0.30  # relative standard deviation, at least, if one object was pressed: it does not show that of objects
)
ONE_SIGMA = 0.683  # of a normal distribution within one standard deviation
FOLDS = 5  # parts in time of a lone object
SMALL = 0.25  # of the forces, that tell the floor
TERMS = 6


@dataclass(frozen=True)
class Load:
    """The known load of one press; what was not measured is None.

    Attributes
    ----------
    object : name of what pressed, or of the recording
    normal_n : into the gel, N
    shear_n : (x, y) along the gel, N
    torsion_n_mm : about the view, N mm
    """

    object: str
    normal_n: float | None = None
    shear_n: tuple[float, float] | None = None
    torsion_n_mm: float | None = None


@dataclass(frozen=True)
class ForceEvaluation:
    """Errors of a model.

    Attributes
    ----------
    normal, shear, torsion : a row for each object, and one of all ("all"). A row has the `presses` with that load, the part
        `refused`, the errors of the others (`mae`; `median` and `q90` of the relative error, where normal loads count from
        2 N), the part `within_1` and `within_2` sigma, and `constant`: the same errors of the best constant
    reasons : number of presses without a normal force, by reason
    """

    normal: tuple[dict[str, Any], ...]
    shear: tuple[dict[str, Any], ...]
    torsion: tuple[dict[str, Any], ...]
    reasons: dict[str, int]

    def to_dict(self) -> dict[str, Any]:
        """The evaluation, as values that JSON can hold."""
        return asdict(self)


def calibrate_force(
    presses: Sequence[Touch | Pressed], loads: Sequence[Load], *, sure_of_unit: bool = False
) -> ForceModel:
    """Fit a force model to presses with known loads.

    The normal force is K times the volume of the depth in the contact, with the median of log F - log V. Shear and torsion
    are linear in the motion of the dots. Standard deviations come from leaving out one object after the other.

    Parameters
    ----------
    presses : results or touches, of one calibration
    loads : of the same presses; three objects with three or four loads each, over a range of 1 to 10, are good
    sure_of_unit : do not compare the normal loads with the stiffness of known gels

    Raises
    ------
    DataError
        Fewer than three usable loads, a range under 1 to 3, negative loads, loads that are not in newtons, no contact,
        dots of several gels, or results of several calibrations.
    ValueError, TypeError
        Another number of loads than of presses, or no loads.
    """
    touches, known = _matched(presses, loads)
    digests = {touch.calibration_digest for touch in touches}
    if len(digests) > 1:
        raise DataError(
            "Expected presses of one calibration and one gel, got results of several calibrations."
        )
    normal = _fit_normal(touches, known, sure_of_unit)
    shear = _fit_dots(touches, known, lambda load: load.shear_n)
    torsion = _fit_dots(
        touches, known, lambda load: None if load.torsion_n_mm is None else (load.torsion_n_mm,)
    )
    if normal is None and shear is None and torsion is None:
        raise DataError("Expected loads: a column force_n, or force_x_n and force_y_n.")
    rest = next((one.rest_mm for one in touches if one.rest_mm is not None), np.empty((0, 2)))
    return ForceModel(
        normal,
        shear,
        torsion,
        tuple((float(x), float(y)) for x, y in rest),
        tuple(sorted({load.object for load in known})),
        digests.pop(),
        datetime.now(timezone.utc).isoformat(timespec="seconds"),
    )


def evaluate_force(
    model: ForceModel, presses: Sequence[Touch | Pressed], loads: Sequence[Load]
) -> ForceEvaluation:
    """Errors of a model on presses with known loads, beside those of the best constant.

    Parameters
    ----------
    model : from `calibrate_force`
    presses : results or touches
    loads : of the same presses

    Raises
    ------
    ValueError, TypeError
        Another number of loads than of presses, or no loads.
    """
    touches, known = _matched(presses, loads)
    forces = [force_from_touch(touch, model) for touch in touches]
    return ForceEvaluation(
        _rows(forces, known, _normal_of, least=LEAST_RELATIVE_N),
        _rows(forces, known, _shear_of),
        _rows(forces, known, _torsion_of),
        dict(Counter(force.normal_reason.partition(":")[0] for force in forces if force.normal_reason)),
    )


def _matched(presses: Sequence[Touch | Pressed], loads: Sequence[Load]) -> tuple[list[Touch], list[Load]]:
    known = check_list(loads, "loads", Load)
    touches = as_touches(check_list(presses, "presses"))
    if len(touches) != len(known):
        raise ValueError(f"Expected one load for each press, got {len(known)} for {len(touches)} presses.")
    return touches, known


def _fit_normal(touches: list[Touch], loads: list[Load], sure_of_unit: bool) -> NormalForce | None:
    weighed = [
        (t, load.object, load.normal_n) for t, load in zip(touches, loads) if load.normal_n is not None
    ]
    if not weighed:
        return None
    force = np.array([one[2] for one in weighed], dtype=np.float64)
    _check_loads(force)
    reasons = [why_no_normal(one[0]) for one in weighed]
    usable = np.array([reason == "" for reason in reasons])
    usable &= force >= LEAST_SHARE * np.max(force[usable], initial=0)
    usable &= force > 0
    if np.count_nonzero(usable) < LEAST_LOADS:
        most = Counter(filter(None, reasons)).most_common(1)
        why = f" Most others: {most[0][0]}." if most else ""
        raise DataError(
            f"Expected at least {LEAST_LOADS} loads of presses that show one hard, whole contact, got "
            f"{np.count_nonzero(usable)} of {len(weighed)}.{why}"
        )
    volume = np.array([one[0].volume_mm3 for one in weighed], dtype=np.float64)[usable]
    force, objects = force[usable], np.array([one[1] for one in weighed])[usable]
    if force.max() < LEAST_RANGE * force.min():
        raise DataError(
            f"Expected loads over a range of 1 to {LEAST_RANGE:g} or more, got {force.min():.3g} to {force.max():.3g} N. "
            "Press lightly and firmly."
        )
    k = _stiffness(volume, force)
    if not sure_of_unit:
        _check_unit(k)
    predicted = np.concatenate(
        [_stiffness(volume[~out], force[~out]) * volume[out] for out in _folds(objects)]
    )
    truth = np.concatenate([force[out] for out in _folds(objects)])
    spread = _spread(predicted[:, None], truth[:, None], lone=len(set(objects)) == 1)
    return NormalForce(k, (float(force.min()), float(force.max())), spread, len(force))


def _check_loads(force: NDArray[np.float64]) -> None:
    """Refuse loads that are not finite, or negative beyond the error of a gauge's zero."""
    if not np.isfinite(force).all():
        raise DataError("Expected every load as a finite number.")
    largest = float(force.max())
    if (lowest := float(force.min())) < -LEAST_SHARE * max(largest, 0.0) or largest <= 0:
        raise DataError(
            f"Expected loads of 0 N or more into the gel, got {lowest:.3g} N. Turn the sign of the gauge, or set its "
            "zero while nothing touches."
        )


def _stiffness(volume: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    return float(np.exp(np.median(np.log(force) - np.log(volume))))


def _check_unit(k: float) -> None:
    """Refuse loads that give a stiffness nearer to that of grams or kilograms than of newtons, on the known gel."""
    for unit, per_n in (("grams", G_PER_N), ("kilograms", KG_PER_N)):
        limit = KNOWN_K * np.sqrt(per_n)
        if (k > limit) if per_n > 1 else (k < limit):
            raise DataError(
                f"The loads look like {unit}: {k:.3g} of their unit for each mm^3, where newtons give about {KNOWN_K:g}. "
                f"Multiply them by {1 / per_n:.4g} to get newtons. If they are newtons, say so: sure_of_unit=True "
                "(--sure-of-unit)."
            )


def _folds(objects: NDArray[np.str_]) -> Iterator[NDArray[np.bool_]]:
    """The presses of each object in turn; of a lone object, its parts in the order of the presses."""
    names = sorted(set(objects.tolist()))
    if len(names) > 1:
        yield from (objects == name for name in names)
        return
    part = np.arange(len(objects)) * min(FOLDS, len(objects)) // len(objects)
    yield from (part == k for k in np.unique(part))


def _spread(force: NDArray[np.float64], truth: NDArray[np.float64], *, lone: bool) -> Spread:
    """The spread of forces (N, components): the relative part of all, then the floor from the smallest quarter.

    Both are such that 68 % of the errors are within one standard deviation.
    """
    error, size = np.abs(force - truth), np.linalg.norm(force, axis=1)[:, None]
    larger = np.maximum(size, np.linalg.norm(truth, axis=1)[:, None])
    relative = float(np.quantile(error / np.maximum(larger, 1e-12), ONE_SIGMA))
    relative = max(relative, LONE_SPREAD) if lone else relative
    small = (larger <= np.quantile(larger, SMALL))[:, 0]
    left = np.maximum(error[small] ** 2 - (relative * size[small]) ** 2, 0)
    return Spread(relative, float(np.sqrt(np.quantile(left, ONE_SIGMA))))


def _fit_dots(
    touches: list[Touch], loads: list[Load], of: Callable[[Load], tuple[float, ...] | None]
) -> DotForce | None:
    measured = [(touch, of(load), load.object) for touch, load in zip(touches, loads) if of(load) is not None]
    if not measured:
        return None
    motions = [touch.dots for touch, _, _ in measured if touch.dots is not None]
    if len(motions) < LEAST_LOADS:
        raise DataError(
            f"Expected at least {LEAST_LOADS} sideways loads of presses whose dots are seen, got {len(motions)} of "
            f"{len(measured)}. Shear is read from the dots of the gel."
        )
    seen = [one for one in measured if one[0].dots is not None]
    first = seen[0][0].rest_mm
    for touch, _, _ in seen:
        if touch.rest_mm is not first and (reason := why_other_dots(touch.rest_mm, first)):  # type: ignore[arg-type]
            raise DataError(f"Expected presses of one gel: {reason}.")
    terms = np.column_stack([np.array(motions), np.ones(len(motions))])
    target, objects = np.array([one[1] for one in seen], dtype=np.float64), np.array([one[2] for one in seen])
    if not np.isfinite(target).all():
        raise DataError("Expected every load as a finite number.")
    size = np.linalg.norm(target, axis=1)
    if size.max() < LEAST_RANGE * size.min() or size.max() <= 0:
        raise DataError(
            f"Expected sideways loads over a range of 1 to {LEAST_RANGE:g} or more, got magnitudes of {size.min():.3g} to "
            f"{size.max():.3g}."
        )
    folds = list(_folds(objects))
    predicted = np.concatenate([terms[out] @ _weights(terms[~out], target[~out]) for out in folds])
    truth = np.concatenate([target[out] for out in folds])
    spread = _spread(predicted, truth, lone=len(set(objects)) == 1)
    rows = _weights(terms, target).T.tolist()
    return DotForce(tuple(map(tuple, rows)), float(size.max()), spread, len(terms))


def _weights(terms: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.float64]:
    """Weights (6, components): all of them, or with few loads only k_t of the displacement, or of the turn."""
    if len(terms) >= LOADS_PER_TERM * TERMS:
        return np.asarray(np.linalg.lstsq(terms, target, rcond=None)[0])
    weights, components = np.zeros((TERMS, target.shape[1])), target.shape[1]
    first = [0, 1] if components == 2 else [2]
    own = terms[:, first]
    weights[first, range(components)] = np.sum(own * target) / max(float(np.sum(own**2)), 1e-12)
    return weights


LEAST_RELATIVE_N = 2.0  # N; of smaller loads no relative error is stated
Part = tuple[tuple[float, ...] | None, float | None, tuple[float, ...] | None]


def _normal_of(force: Force, load: Load) -> Part:
    return _one(force.normal_n), force.normal_sigma_n, _one(load.normal_n)


def _shear_of(force: Force, load: Load) -> Part:
    return force.shear_n, force.shear_sigma_n, load.shear_n


def _torsion_of(force: Force, load: Load) -> Part:
    return _one(force.torsion_n_mm), force.torsion_sigma_n_mm, _one(load.torsion_n_mm)


def _one(value: float | None) -> tuple[float] | None:
    return None if value is None else (value,)


def _rows(
    forces: list[Force], loads: list[Load], of: Callable[[Force, Load], Part], *, least: float = 0.0
) -> tuple[dict[str, Any], ...]:
    """A row of errors for each object, then one of all; none without such loads."""
    parts = [(load.object, *of(force, load)) for force, load in zip(forces, loads)]
    parts = [part for part in parts if part[3] is not None]
    if not parts:
        return ()
    center = np.median(np.array([part[3] for part in parts]), axis=0)
    names = sorted({part[0] for part in parts})
    groups = [(name, [part for part in parts if part[0] == name]) for name in names]
    return tuple(_row(name, own, center, least) for name, own in [*groups, ("all", parts)])


def _row(name: str, parts: list[Any], center: NDArray[np.float64], least: float) -> dict[str, Any]:
    known = [part for part in parts if part[1] is not None]
    row: dict[str, Any] = {"object": name, "presses": len(parts), "refused": 1 - len(known) / len(parts)}
    if not known:
        return row
    force, truth = (np.array([part[k] for part in known], dtype=np.float64) for k in (1, 3))
    off = np.abs(force - truth) / np.array([part[2] for part in known])[:, None]
    return {
        **row,
        **_errors(force, truth, least),
        "within_1": float(np.mean(off <= 1)),
        "within_2": float(np.mean(off <= 2)),
        "constant": _errors(np.broadcast_to(center, truth.shape), truth, least),
    }


def _errors(force: NDArray[np.float64], truth: NDArray[np.float64], least: float) -> dict[str, float | None]:
    """Mean error of the components; median and 90 % of the relative error where the truth is at least so large."""
    size = np.linalg.norm(truth, axis=1)
    large = size > least
    relative = np.linalg.norm(force - truth, axis=1)[large] / size[large]
    shares = [float(np.quantile(relative, share)) for share in (0.5, 0.9)] if large.any() else [None, None]
    return {"mae": float(np.abs(force - truth).mean()), "median": shares[0], "q90": shares[1]}
