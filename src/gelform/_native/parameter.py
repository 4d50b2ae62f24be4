"""One parameter of a kernel: read from its declaration, checked, and made into what ctypes passes on."""

from __future__ import annotations

import ctypes
import math
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from gelform._native.loader import instruction_set, library

DTYPES = {
    "f32": np.dtype(np.float32),
    "f64": np.dtype(np.float64),
    "u8": np.dtype(np.uint8),
    "u16": np.dtype(np.uint16),
    "i32": np.dtype(np.int32),
    "i64": np.dtype(np.int64),
    "bool": np.dtype(np.bool_),
}
NUMBERS = {"f32": ctypes.c_float, "f64": ctypes.c_double, "i32": ctypes.c_int32, "i64": ctypes.c_int64}
_WRITTEN = re.compile(r"(out |finite )?(\w+)(\[[\w.,]*\]|\*|)(\??) (\w+)")


@dataclass(frozen=True)
class Parameter:
    """One parameter of a kernel.

    `axes` are the names or lengths of an array's axes, None for what is no array.
    """

    name: str
    kind: str
    axes: tuple[str, ...] | None
    role: str
    optional: bool

    @property
    def is_handle(self) -> bool:
        """It is memory that C owns."""
        return self.axes is None and self.kind not in NUMBERS

    @property
    def ctype(self) -> Any:
        """What ctypes converts it to."""
        return NUMBERS[self.kind] if self.axes is None and not self.is_handle else ctypes.c_void_p

    @property
    def plain_dtype(self) -> Any:
        """The dtype of arrays that need no closer look where they are writeable and in C order; None: all need one."""
        return DTYPES.get(self.kind) if self.axes is not None and self.role != "finite" else None

    def pointer(self, array: Any) -> Any:
        """An array as C takes it: of the declared dtype, in C order.

        Raises
        ------
        TypeError, ValueError
            It is not, or it holds NaN where that was to be checked.
        """
        if array is None and self.optional:
            return None
        if not isinstance(array, np.ndarray) or array.dtype != DTYPES[self.kind]:
            got = getattr(array, "dtype", type(array).__name__)
            raise TypeError(f"expected {self.name} as an array of {DTYPES[self.kind]}, got {got}.")
        flags = array.flags
        if not flags.c_contiguous:
            raise ValueError(
                f"expected {self.name} in C order. Use numpy.ascontiguousarray where it is made."
            )
        if self.role == "out" and not flags.writeable:
            raise ValueError(f"expected {self.name}, which is written, to be writeable.")
        if self.role == "finite" and not is_finite(array):
            raise ValueError(f"expected finite {self.name}, got NaN or infinity.")
        return array.ctypes.data

    def match_axes(self, shape: tuple[int, ...] | None, sizes: dict[str, int]) -> None:
        """Compare an array's shape with the declared one; `sizes` collects the lengths of the named axes."""
        axes = self.axes
        if shape is None or axes is None:
            return
        if axes[:1] == ("...",):
            leading = max(len(shape) - len(axes) + 1, 0)
            shape, axes = (math.prod(shape[:leading]), *shape[leading:]), ("count", *axes[1:])
        lengths = [int(axis) if axis.isdigit() else sizes.get(axis) for axis in axes]
        if len(shape) != len(axes) or any(n not in (None, m) for n, m in zip(lengths, shape)):
            known = "".join(f", {axis} = {length}" for axis, length in sizes.items())
            raise ValueError(f"expected {self.name} of shape ({', '.join(axes)}){known}, got {shape}.")
        sizes.update((axis, length) for axis, length in zip(axes, shape) if not axis.isdigit())


def parameters_of(declaration: str) -> tuple[Parameter, ...]:
    """The parameters of a declaration such as 'f32[h,w] weights, out f32[h,w] depth, f32 factor'."""
    parameters = []
    for text in re.split(r",\s*(?![^\[]*\])", declaration):
        match = _WRITTEN.fullmatch(text.strip())
        if match is None or (match[3] != "*" and match[2] not in DTYPES):
            raise ValueError(f"Expected a parameter such as 'out f32[h,w] depth', got {text!r}.")
        role, kind, brackets, optional, name = match.groups()
        axes = tuple(brackets[1:-1].split(",")) if brackets.startswith("[") else None
        parameters.append(Parameter(name, kind, axes, (role or "").strip(), bool(optional)))
    return tuple(parameters)


def sizes_of(parameters: tuple[Parameter, ...]) -> tuple[str, ...]:
    """The names of the axes, in the order of their first use."""
    axes = [
        "count" if axis == "..." else axis for p in parameters for axis in p.axes or () if not axis.isdigit()
    ]
    return tuple(dict.fromkeys(axes))


def is_finite(array: np.ndarray) -> bool:
    """No NaN and no infinity; float32 in C order is read at the speed of memory."""
    if array.dtype != np.float32 or not array.flags.c_contiguous:
        return bool(np.isfinite(array).all())
    function = library(instruction_set()).finite_f32
    return bool(function(ctypes.c_void_p(array.ctypes.data), ctypes.c_ssize_t(array.size)))
