"""Checks of shapes, dtypes and ranges: every public function checks its arguments here, once.

Arrays that pass are in C order and of the machine's bytes, whatever view of whatever array was given.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Sequence
from numbers import Real
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from gelform._native import Kernel
from gelform.arrays import Array, Map, Mask, Slopes
from gelform.errors import DataError

_range = Kernel("range_f32", "f32[...] values, out f32[2] range")

POSSIBLE_RESPONSES = (0.05, 20.0)  # exponents of a camera's response curve, levels = light^response
LARGEST = 1e18  # its squares, and sums of those, fit into float32


def as_array(values: ArrayLike, name: str) -> Array:
    """The values as an array, whatever its type; refused if they are no rectangle of values, or partly masked.

    ValueError: rows of different lengths, or masked values; a separate mask marks unknown values. TypeError: a path, or an
    object that fails to become an array; what it raised is the cause.
    """
    if isinstance(values, (str, PathLike)):
        raise TypeError(
            f"Expected {name} as an array, got the path {os.fspath(values)!r:.80}. Read it first: a picture by "
            "gelform.read_image(path)."
        )
    # numpy.ma takes 20 ms to import; nothing is masked before someone imports it
    if type(values) is not np.ndarray and "numpy.ma" in sys.modules and np.ma.is_masked(values):
        raise ValueError(
            f"Expected {name} without masked values. Give numbers everywhere and say where with mask=."
        )
    try:
        return np.asarray(values)
    except MemoryError:
        raise
    except Exception as problem:  # of numpy, or of the object's own conversion
        kind = type(values).__name__
        if isinstance(values, (list, tuple)) and isinstance(problem, (ValueError, TypeError, OverflowError)):
            raise ValueError(f"Expected {name} as an array, got a {kind} of unequal parts.") from problem
        raise TypeError(
            f"Expected {name} as an array, got {kind}, which does not become one: {problem!r:.200}. Convert it first."
        ) from problem


def check_values(
    values: ArrayLike, name: str, trailing: tuple[int, ...] = (), dtype: Any = np.float32
) -> Array:
    """Return finite numbers (..., *trailing), such as lights (3, 3) or color changes (..., 3)."""
    array = as_array(values, name)
    if (
        array.ndim < len(trailing)
        or array.shape[array.ndim - len(trailing) :] != trailing
        or 0 in array.shape
    ):
        wanted = ", ".join(("...", *map(str, trailing)))
        raise ValueError(f"Expected {name} of shape ({wanted}), got {array.shape}.")
    return check_finite(_as_float(array, name, dtype), name)


def check_image(image: ArrayLike, *, shape: tuple[int, int] | None = None, name: str = "image") -> Array:
    """Return an RGB image (H, W, 3) in C order: uint8 as it is, float (0-255) as float32.

    TypeError: the array is neither uint8 nor float.
    ValueError: wrong shape, a gray image, a value that is not finite or outside 0-255, or floats that look like 0-1.
    """
    array = as_array(image, name)
    if array.ndim == 2:
        raise ValueError(
            f"Expected {name} of shape (H, W, 3) in RGB, got a gray image of shape {array.shape}. "
            "Three lights need three channels: take or read it in color."
        )
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        hint = " Drop the alpha channel." if array.ndim == 3 and array.shape[2] == 4 else ""
        if array.ndim == 3 and array.shape[0] == 3:
            hint = " Move the axis of the channels last."
        raise ValueError(f"Expected {name} of shape (H, W, 3) in RGB, got {array.shape}.{hint}")
    if shape is not None and array.shape[:2] != tuple(shape):
        raise ValueError(
            f"Expected {name} of {shape[0]}x{shape[1]} px (height x width), got {array.shape[0]}x{array.shape[1]}."
        )
    if array.dtype == np.uint8:
        return np.ascontiguousarray(array)
    if not np.issubdtype(array.dtype, np.floating):
        raise TypeError(
            f"Expected {name} as uint8 or float (0-255), got {array.dtype}. "
            "Scale it to 0-255 and convert it to uint8."
        )
    low, high = float(array.min()), float(array.max())
    if not (np.isfinite(low) and np.isfinite(high)) or low < 0 or high > 255:
        raise ValueError(f"Expected {name} within 0-255, got values from {low:g} to {high:g}.")
    if 0 < high <= 1:
        raise ValueError(
            f"Expected {name} within 0-255, got float values up to {high:g}, which looks like a 0-1 range. "
            "Multiply by 255."
        )
    return np.ascontiguousarray(array, dtype=np.float32)


def check_gradients(
    gradients: ArrayLike, *, shape: tuple[int, int] | None = None, dtype: Any = np.float32
) -> Array:
    """Return finite gradients (..., H, W, 2) as float32; `shape` is the expected (H, W)."""
    array = as_array(gradients, "gradients")
    wanted = f"({shape[0]}, {shape[1]}, 2)" if shape is not None else "(H, W, 2)"
    bad_shape = array.ndim < 3 or array.shape[-1] != 2 or 0 in array.shape
    if bad_shape or (shape is not None and array.shape[-3:-1] != tuple(shape)):
        moved = array.ndim >= 3 and array.shape[-3] == 2 and array.shape[-1] != 2
        if moved and shape is None:
            wanted = f"({array.shape[-2]}, {array.shape[-1]}, 2)"
        hint = " Move the axis of the components last." if moved else ""
        raise ValueError(f"Expected gradients of shape {wanted}, got {array.shape}.{hint}")
    _check_signed(array, "gradients")
    return check_finite(_as_float(array, "gradients", dtype), "gradients")


def check_normals(normals: ArrayLike) -> Map:
    """Return finite normals (..., 3) with n_z > 0 as float32; their length need not be 1."""
    array = as_array(normals, "normals")
    if array.ndim < 1 or array.shape[-1] != 3:
        raise ValueError(f"Expected normals of shape (..., 3), got {array.shape}.")
    _check_signed(array, "normals")
    array = check_finite(_as_float(array, "normals"), "normals")
    if array.size and float(array[..., 2].min()) < 1 / LARGEST:
        raise ValueError(
            f"Expected normals that face the camera (n_z > 0), got n_z down to {array[..., 2].min():g}. "
            "z points toward the camera: flip the sign if yours points away."
        )
    return array


def check_map(
    values: ArrayLike,
    name: str,
    *,
    shape: tuple[int, int] | None = None,
    nonnegative: bool = False,
    dtype: Any = np.float32,
) -> Array:
    """Return a finite map (..., H, W), such as a depth or weights, as float32."""
    array = as_array(values, name)
    if array.ndim < 2 or 0 in array.shape or (shape is not None and array.shape[-2:] != tuple(shape)):
        wanted = f"({shape[0]}, {shape[1]})" if shape is not None else "(H, W)"
        raise ValueError(f"Expected {name} of shape {wanted}, got {array.shape}.")
    array = _as_float(array, name, dtype)
    low, _ = finite_range(array, name)
    if nonnegative and low < 0:
        raise ValueError(f"Expected {name} >= 0, got {low:g}.")
    return array


def check_mask(
    mask: ArrayLike, *, shape: tuple[int, int], name: str = "mask", may_be_empty: bool = False
) -> Mask:
    """Return a boolean mask (H, W) in C order with at least one True pixel, unless it may be empty."""
    array = as_array(mask, name)
    if array.dtype != np.bool_:
        raise TypeError(f"Expected {name} as bool, got {array.dtype}. Convert it: {name} > 0.")
    if array.shape != tuple(shape):
        raise ValueError(f"Expected {name} of shape ({shape[0]}, {shape[1]}), got {array.shape}.")
    if not (may_be_empty or array.any()):
        raise ValueError(f"Expected {name} with at least one True pixel, got none.")
    return np.ascontiguousarray(array)


def check_finite(array: Array, name: str) -> Array:
    """Return the array if every value is finite, and its square too."""
    finite_range(array, name)
    return array


def finite_range(array: Array, name: str) -> tuple[float, float]:
    """The smallest and the largest value of an array, which is refused as by `check_finite`."""
    low, high = value_range(array)
    if not (low >= -LARGEST and high <= LARGEST):
        bad = int(np.count_nonzero(~(np.abs(array.astype(np.float64)) <= LARGEST)))
        raise ValueError(
            f"Expected finite {name}, got {bad} values that are NaN or infinite (or beyond {LARGEST:g}). "
            "Put any finite value there and say where with mask=."
        )
    return low, high


def value_range(array: Array) -> tuple[float, float]:
    """The smallest and the largest value; NaN if a value is NaN or infinite, 0 if there is none."""
    if not array.size:
        return 0.0, 0.0
    if array.dtype != np.float32 or not array.flags.c_contiguous:
        return float(array.min()), float(array.max())
    found = np.empty(2, dtype=np.float32)
    _range(array, found)
    return float(found[0]), float(found[1])


def _check_signed(array: Array, name: str) -> None:
    """Refuse a picture in which a map is coded: its numbers have no sign."""
    if array.dtype.kind == "u":
        raise TypeError(
            f"Expected {name} as numbers with a sign, got {array.dtype}. Decode a picture of them first, such as normals "
            "by picture / 127.5 - 1."
        )


def _as_float(array: Array, name: str, dtype: Any = np.float32) -> Array:
    if array.dtype == np.bool_ or not (
        np.issubdtype(array.dtype, np.floating) or np.issubdtype(array.dtype, np.integer)
    ):
        raise TypeError(f"Expected {name} as numbers, got {array.dtype}.")
    # A value that does not fit becomes infinite and is refused.
    with np.errstate(over="ignore", under="ignore"):
        return np.ascontiguousarray(array, dtype=dtype).reshape(array.shape)


T = TypeVar("T")
MAX_PATH, MAX_NAME = 4096, 255  # characters, on Linux


def check_is(value: Any, kind: type[T], name: str) -> T:
    """Return a value if it is of a kind, such as a View or a Reconstruction."""
    if not isinstance(value, kind):
        raise TypeError(f"Expected {name} as {kind.__name__}, got {type(value).__name__}.")
    return value


def check_choice(value: Any, choices: Iterable[str], what: str) -> str:
    """Return a value if it is among the choices; anything else, of any kind, is a ValueError."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"Expected {what} among {', '.join(choices)}, got {value!r}.")
    return value


def check_list(values: Any, name: str, kind: type[Any] | None = None) -> list[Any]:
    """Return the items of a sequence or an array as a list; `kind` is that of each."""
    is_array = isinstance(values, np.ndarray) and values.ndim > 0
    if isinstance(values, (str, bytes)) or not (is_array or isinstance(values, Sequence)):
        raise TypeError(f"Expected {name} as a list, got {type(values).__name__}.")
    return [one if kind is None else check_is(one, kind, f"each of {name}") for one in values]


def remedy_for(missing: Path) -> str:
    """The advice for a file that is missing: the one beside it that differs in case or suffix alone, if there is one."""
    stem = missing.stem.casefold()
    alike = sorted(one.name for one in missing.parent.glob("*") if one.stem.casefold() == stem)
    return f"Did you mean {alike[0]}?" if alike else "Check the path."


def check_path(path: Any, what: str = "a path") -> Path:
    """Return a path that a file system can have; DataError: it is empty or too long, or has a zero byte."""
    if not isinstance(path, (str, PathLike)):
        raise TypeError(f"Expected {what} as text or a Path, got {type(path).__name__}.")
    text = os.fspath(path)
    if not isinstance(text, str):
        raise TypeError(f"Expected {what} as text or a Path, got {type(text).__name__}.")
    longest = max(map(len, text.split(os.sep)))
    try:
        os.fsencode(text)
        is_text = bool(text) and "\0" not in text
    except UnicodeEncodeError:  # half a character
        is_text = False
    if not is_text or len(text) > MAX_PATH or longest > MAX_NAME:
        raise DataError(f"Expected {what}, got {text[:60]!r}, which no file can be called.")
    return Path(text)


# mm, smallest and largest values of sensors; a number outside is in another unit.
GEL_THICKNESS_MM, PITCH_MM = (0.05, 50.0), (1e-4, 1.0)


def check_mm_per_px(mm_per_px: float | Sequence[float] | Array | None) -> tuple[float, float]:
    """Return the pixel pitch as (x, y) in mm, each as `check_sensor_pitch`; one number stands for square pixels."""
    if mm_per_px is None:
        raise ValueError("Expected mm_per_px, got None. Give the pixel pitch in mm, for example 0.0634.")
    if type(mm_per_px) is float and PITCH_MM[0] <= mm_per_px <= PITCH_MM[1]:  # the usual case of each frame
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
    return check_sensor_pitch(float(values[0])), check_sensor_pitch(float(values[-1]))


def check_sensor_pitch(mm_per_px: float) -> float:
    """Return the pixel pitch of a sensor, mm: a number that a camera over a gel can have, at most 1 mm.

    TypeError, ValueError: it is no number, or too large; the message gives its value as pixels per mm.
    """
    pitch = check_positive(mm_per_px, "mm_per_px")
    if pitch > PITCH_MM[1]:
        hint = f" If these are pixels per mm, give 1/{pitch:g} = {1 / pitch:.4g}." if pitch < 1e4 else ""
        raise ValueError(f"Expected mm_per_px up to {PITCH_MM[1]:g} mm, got {pitch:g}.{hint}")
    if pitch < PITCH_MM[0]:
        raise ValueError(f"Expected mm_per_px of at least {PITCH_MM[0]:g} mm, got {pitch:g}. Is it in mm?")
    return pitch


def check_sensor_pitches(mm_per_px: float | Sequence[float]) -> float | tuple[float, float]:
    """Return the pixel pitch of a sensor as `check_sensor_pitch` does, or a pair (x, y) of them if they differ."""
    if not isinstance(mm_per_px, (list, tuple)):
        return check_sensor_pitch(mm_per_px)  # type: ignore[arg-type]
    if len(mm_per_px) != 2:
        raise ValueError(f"Expected mm_per_px as one number or as two, [x, y], got {len(mm_per_px)}.")
    x, y = map(check_sensor_pitch, mm_per_px)
    return x if x == y else (x, y)


def check_gel_thickness(thickness_mm: float) -> float:
    """Return the thickness of a gel, mm, if a finger-sized sensor can have it."""
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
    """Return a given number of finite numbers as a tuple of floats, such as a point (x, y)."""
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


def check_response(response: float) -> float:
    """Return the exponent of a camera's response as float; the value may be from a file."""
    return check_within(response, "response", *POSSIBLE_RESPONSES)


HIGHEST_SLOPE = 1e15  # mm/mm; the sum of such squares over a frame does not overflow in float32


def check_slopes(gradients: Slopes) -> None:
    """Refuse slopes that are not finite, or whose squares would overflow.

    ValueError: a slope is NaN or beyond `HIGHEST_SLOPE`.
    """
    low, high = value_range(gradients)
    largest = max(high, -low)
    if not largest <= HIGHEST_SLOPE:
        raise ValueError(
            f"Expected slopes up to {HIGHEST_SLOPE:.0e} mm/mm, got {largest:.1e}: what they add up to is beyond "
            "float32. Mark such pixels with weights of 0 and put any small value there."
        )
