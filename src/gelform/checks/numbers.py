"""Numbers: positive ones, those within limits, and the width of a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.checks.kinds import check_list

GEL_THICKNESS_MM = 0.05, 50.0
MIN_PITCH_MM, MAX_PITCH_MM = 1e-4, 1.0
MM_PER_PX = 1e-6, 1e3  # what square sums of float32 can hold, and far beyond any sensor


def check_mm_per_px(mm_per_px: float | Sequence[float] | NDArray[Any] | None) -> tuple[float, float]:
    """Return the pixel pitch as (x, y) in mm; one number stands for square pixels."""
    if mm_per_px is None:
        raise ValueError("Expected mm_per_px, got None. Give the pixel pitch in mm, for example 0.0634.")
    if type(mm_per_px) is float and MM_PER_PX[0] <= mm_per_px <= MM_PER_PX[1]:  # as each frame gives it
        return mm_per_px, mm_per_px
    try:
        values = np.atleast_1d(np.asarray(mm_per_px))
        if values.dtype.kind not in "fiuO":
            raise TypeError
        values = values.astype(np.float64)
    except (TypeError, ValueError, OverflowError):
        raise TypeError(f"Expected mm_per_px as a number or (x, y), got {mm_per_px!r:.60}.") from None
    if values.shape not in ((1,), (2,)):
        raise ValueError(f"Expected mm_per_px as a number or (x, y), got shape {values.shape}.")
    if not np.all(np.isfinite(values)) or float(values.min()) <= 0:
        raise ValueError(f"Expected mm_per_px > 0 (mm per pixel, not pixels per mm), got {mm_per_px}.")
    if not (MM_PER_PX[0] <= float(values.min()) and float(values.max()) <= MM_PER_PX[1]):
        raise ValueError(
            f"Expected mm_per_px between {MM_PER_PX[0]:g} and {MM_PER_PX[1]:g}, got {mm_per_px}."
        )
    return float(values[0]), float(values[-1])


def check_sensor_pitch(mm_per_px: float) -> float:
    """Return the pixel pitch of a sensor, mm: a number that a camera over a gel can have, up to 1 mm.

    Raises
    ------
    TypeError, ValueError
        It is no number, or too large: the message says what pixels per mm would be.
    """
    pitch = check_positive(mm_per_px, "mm_per_px")
    if pitch > MAX_PITCH_MM:
        hint = f" If these are pixels per mm, give 1/{pitch:g} = {1 / pitch:.4g}." if pitch < 1e4 else ""
        raise ValueError(f"Expected mm_per_px up to {MAX_PITCH_MM:g} mm, got {pitch:g}.{hint}")
    if pitch < MIN_PITCH_MM:
        raise ValueError(f"Expected mm_per_px of at least {MIN_PITCH_MM:g} mm, got {pitch:g}. Is it in mm?")
    return pitch


def check_gel_thickness(thickness_mm: float) -> float:
    """Return the thickness of a gel, mm: one that a finger-sized sensor can have."""
    return check_within(thickness_mm, "gel_thickness_mm", *GEL_THICKNESS_MM)


def check_positive(value: float, name: str) -> float:
    """Return a finite number > 0 as float; text and truth values are none."""
    number = check_number(value, name)
    if not np.isfinite(number) or number <= 0:
        raise ValueError(f"Expected {name} > 0, got {value}.")
    return number


def check_number(value: float, name: str) -> float:
    """Return a number as float, whatever its size; text and truth values are none."""
    if not isinstance(value, Real) or isinstance(value, bool):
        raise TypeError(f"Expected {name} as a number, got {value!r:.60}.")
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def check_numbers(values: Any, name: str, count: int) -> tuple[float, ...]:
    """Return so many finite numbers as a tuple of floats, such as a point (x, y)."""
    numbers = tuple(check_number(value, f"each of {name}") for value in check_list(values, name))
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ValueError(f"Expected {name} as {count} finite numbers, got {values!r:.80}.")
    return numbers


def check_within(value: float, name: str, low: float, high: float) -> float:
    """Return a number between two others as float."""
    number = check_number(value, name)
    if not low <= number <= high:
        raise ValueError(f"Expected {name} between {low:g} and {high:g}, got {value}.")
    return number
