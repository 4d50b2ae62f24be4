"""Presses with known loads -> ForceModel, and the errors of a model on further presses."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timezone
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.arrays import Mask, Numbers
from gelform.depth.force import (
    KINDS,
    SHAPES,
    Dots,
    Force,
    ForceModel,
    ForcePart,
    Touch,
    force_from_result,
    terms_of,
    touch_from_result,
    why_no_normal,
)
from gelform.errors import DataError
from gelform.foundations.checks import check_list, check_number

LEAST_LOADS, LEAST_RANGE = 3, 3.0  # loads, and the largest over the smallest
LEAST_SHARE = 0.05  # of the largest normal load; smaller ones, also below 0, are the gauge's zero
LARGEST_LOAD = 1e9  # N and N mm; no press has more, and its square is far from the end of numbers
KNOWN_K = 0.045  # N/mm^3, middle of hard objects on the studied gel (.036 to .051)
ONE_SIGMA = 0.683  # of a normal distribution within one standard deviation


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
    for unit, per_newton in (("grams", 1000 / 9.80665), ("kilograms", 1 / 9.80665)):
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
    if len(set(grasps[:, 0])) == 1:  # one object does not show what others do
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
    force, truth = (
        np.array([_value(one, kind) for one in column]).reshape(len(known), -1) for column in zip(*known)
    )
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
