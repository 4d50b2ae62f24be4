"""The C kernels: their library is found and loaded, and a function of it is declared in one line.

Declare a C function in one line and call it with arrays that have been checked.

    _scale = Kernel("scale_rows", "f32[h,w] values, f32[w] factors, out f32[h,w] scaled, f32 offset")

is the C function

    int scale_rows(const float *values, const float *factors, float *scaled, float offset, ptrdiff_t h, ptrdiff_t w)

Parameters come in the order of the declaration, then the sizes in the order of their first use.

| in a declaration | is |
|---|---|
| `f32[h,w,3] name` | an array that C reads: dtype and shape as said, C order |
| `out f32[h,w] name` | an array that C writes, or reads and writes |
| `finite f32[h,w] name` | an array without NaN and infinity |
| `f32[...] name`, `f32[...,2] name` | any leading axes: C gets their product, as `count` |
| `f32[h,w]? name` | an array or None, which is NULL in C |
| `f32 name`, `f64 name`, `i32 name`, `i64 name` | a number |
| `solver* name` | a `Handle("solver", ...)` |
"""

from __future__ import annotations

import ctypes
import math
import os
import platform
import re
import sys
from ctypes import CDLL
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any
from weakref import finalize

import numpy as np

from gelform._native.sources import (
    digest_of_library,
    digest_of_sources,
    digest_of_version,
    is_cut_off,
    native_folder,
)
from gelform.errors import GelformError

# Name -> required level of the processor, as `cpu_level` in native/cpu.c counts.
ISAS = {"base": 1, "v3": 3, "v4": 4}
_FOLDER = Path(__file__).parent
_SUFFIX = ".dll" if sys.platform == "win32" else ".so"


@cache
def library(isa: str) -> CDLL:
    """The kernels compiled for one instruction set, loaded once.

    GelformError: the file is missing or cut off; made for another platform, another version, or from C sources other than
    the present ones; or the processor lacks the instructions. The message says what to do.
    """
    if isa not in ISAS:
        raise ValueError(f"Expected GELFORM_ISA to be one of {', '.join(ISAS)}, got {isa!r}.")
    if isa != "base" and library("base").cpu_level() < ISAS[isa]:
        raise GelformError(f"This processor cannot run the kernels for {isa!r}. Unset GELFORM_ISA.")
    path = _FOLDER / f"kernels_{isa}{_SUFFIX}"
    here = f"{sys.platform} {platform.machine()}"
    if not path.exists():
        raise GelformError(f"gelform's compiled kernels for {here} are missing ({path}). {_remedy()}")
    try:
        if is_cut_off(path):
            raise GelformError(f"The end of gelform's compiled kernels is missing ({path}). {_remedy()}")
        kernels = CDLL(str(path))
    except OSError as error:
        raise GelformError(
            f"gelform's compiled kernels do not load on {here} ({error}). {_remedy()}"
        ) from error
    sources = native_folder()
    if sources is None and digest_of_library(kernels, "version") != digest_of_version(_version()):
        raise GelformError(
            f"gelform's compiled kernels ({path}) are not of gelform {_version()}, which is half installed: "
            f"calling them could crash Python. {_remedy()}"
        )
    if sources is not None and digest_of_library(kernels) not in (None, _digest_of(sources)):
        raise GelformError(
            f"gelform's compiled kernels ({path}) were made from other C sources than those in {sources}: "
            f"calling them could crash Python. {_remedy()}"
        )
    return kernels


def _remedy() -> str:
    if native_folder() is not None:
        return "Compile them again: python hatch_build.py"
    return "Install gelform again, on this machine itself: pip install --force-reinstall --no-deps gelform"


def _version() -> str:
    from gelform import __version__

    return __version__


@cache
def _digest_of(sources: Path) -> int:
    """Digest of a checkout's C sources, which do not change while Python runs."""
    return digest_of_sources(sources)


@cache
def instruction_set() -> str:
    """The instruction set in use: GELFORM_ISA from the environment, else the best one of this processor."""
    wanted = os.environ.get("GELFORM_ISA")
    if wanted:
        return wanted
    best = library("base").cpu_level()
    return max((isa for isa in ISAS if ISAS[isa] <= best), key=ISAS.__getitem__)


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

    `axes` are the names or lengths of an array's axes; None for other parameters.
    """

    name: str
    kind: str
    axes: tuple[str, ...] | None
    role: str
    optional: bool

    @property
    def is_handle(self) -> bool:
        """Whether it is memory that C owns."""
        return self.axes is None and self.kind not in NUMBERS

    def pointer(self, array: Any) -> Any:
        """An array in C's form: of the declared dtype, in C order.

        TypeError, ValueError: the array has another form, or contains NaN where the declaration says finite.
        """
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
    """Whether there is no NaN and no infinity; float32 in C order is read at the speed of memory."""
    if array.dtype != np.float32 or not array.flags.c_contiguous:
        return bool(np.isfinite(array).all())
    function = library(instruction_set()).finite_f32
    return bool(function(ctypes.c_void_p(array.ctypes.data), ctypes.c_ssize_t(array.size)))


_byref, _from_buffer = ctypes.byref, ctypes.c_char.from_buffer  # four times as fast as array.ctypes.data
_NO_MEMORY, _WRONG_SIZE = -1, -2  # of native/common.h; callers interpret values from 0 up
_SHAPES_REMEMBERED = 64  # argument shapes remembered per kernel


class Kernel:
    """A C function behind a check of its arguments. A call releases the interpreter's lock."""

    def __init__(self, name: str, declaration: str, isa: str | None = None) -> None:
        self.name = name
        self.declaration = declaration
        self.parameters = parameters_of(declaration)
        self.sizes = sizes_of(self.parameters)
        self._names = tuple(parameter.name for parameter in self.parameters)
        # With the dtype of arrays that need no further check if they are writeable and in C order; None: all need one.
        self._arrays = [
            (i, p, DTYPES[p.kind] if p.role != "finite" else None)
            for i, p in enumerate(self.parameters)
            if p.axes is not None
        ]
        self._handles = [(i, p) for i, p in enumerate(self.parameters) if p.is_handle]
        self._sizes_of_shapes: dict[tuple[tuple[int, ...] | None, ...], tuple[int, ...]] = {}
        self._isa = isa
        self._function: Any = None

    def on(self, isa: str) -> Kernel:
        """The same kernel compiled for another instruction set, for tests that compare them."""
        return Kernel(self.name, self.declaration, isa)

    def __call__(self, *arguments: Any, **named: Any) -> int:
        """Call the kernel with its parameters in order, or by name after the first ones; return C's value.

        TypeError, ValueError: arguments are missing, too many or of other names; an array's dtype, shape or order is not as
        declared, or does not fit the handle. MemoryError: C could not allocate.
        """
        if named:
            rest = self._names[len(arguments) :]
            if named.keys() != set(rest):
                raise TypeError(f"{self.name}: expected {', '.join(rest)} by name, got {', '.join(named)}.")
            arguments += tuple(map(named.__getitem__, rest))
        if len(arguments) != len(self.parameters):
            raise TypeError(f"{self.name}: expected {len(self.parameters)} arguments, got {len(arguments)}.")
        values: list[Any] = list(arguments)
        seen: list[tuple[int, ...] | None] = []
        try:
            for place, parameter in self._handles:
                handle = arguments[place]
                if not isinstance(handle, Handle) or handle.name != parameter.kind:
                    raise TypeError(f'expected Handle("{parameter.kind}", ...), got {handle!r}.')
            for place, parameter, dtype in self._arrays:
                array = arguments[place]
                if array is None and parameter.optional:
                    seen.append(None)
                    continue
                try:
                    if array.dtype is not dtype:
                        raise TypeError
                    values[place] = _byref(_from_buffer(array))
                except (AttributeError, TypeError, ValueError):  # unusual arrays: check them closely
                    values[place] = parameter.pointer(array)
                seen.append(array.shape)
            shapes = tuple(seen)
            sizes = self._sizes_of_shapes.get(shapes) or self._match(shapes)
        except (TypeError, ValueError) as error:
            raise type(error)(f"{self.name}: {error}") from None
        status = (self._function or self._load())(*values, *sizes)
        if status == _NO_MEMORY:
            raise MemoryError(f"{self.name}: not enough memory.")
        if status == _WRONG_SIZE:
            raise ValueError(f"{self.name}: arrays of shapes {shapes} do not fit the handle's sizes.")
        return status

    def _match(self, shapes: tuple[tuple[int, ...] | None, ...]) -> tuple[int, ...]:
        """The sizes for C, remembered for earlier shapes."""
        sizes: dict[str, int] = {}
        for (_, parameter, _), shape in zip(self._arrays, shapes):
            parameter.match_axes(shape, sizes)
        if len(self._sizes_of_shapes) >= _SHAPES_REMEMBERED:
            self._sizes_of_shapes.clear()
        found = self._sizes_of_shapes[shapes] = tuple(sizes.get(name, 0) for name in self.sizes)
        return found

    def _load(self) -> Any:
        function = getattr(library(self._isa or instruction_set()), self.name)
        pointer = ctypes.c_void_p
        types = [pointer if p.axes is not None else NUMBERS.get(p.kind, pointer) for p in self.parameters]
        function.argtypes = [*types, *(ctypes.c_ssize_t for _ in self.sizes)]
        function.restype = ctypes.c_int
        self._function = function
        return function


class Handle:
    """Memory that C owns: made by `<name>_new(sizes...)`, freed by `<name>_free` when Python deletes the handle.

    Only one thread at a time may use it.
    """

    def __init__(self, name: str, *sizes: int) -> None:
        kernels = library(instruction_set())
        new, free = getattr(kernels, f"{name}_new"), getattr(kernels, f"{name}_free")
        new.argtypes, new.restype = [ctypes.c_ssize_t] * len(sizes), ctypes.c_void_p
        free.argtypes, free.restype = [ctypes.c_void_p], None
        address = new(*sizes)
        if not address:
            raise MemoryError(f"{name}: not enough memory for {' x '.join(map(str, sizes))}.")
        self.name = name
        self._as_parameter_ = ctypes.c_void_p(address)
        finalize(self, free, address)
