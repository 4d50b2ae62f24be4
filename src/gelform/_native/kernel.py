"""Declare a C function in one line and call it with arrays that have been checked.

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
from typing import Any
from weakref import finalize

from gelform._native.loader import instruction_set, library
from gelform._native.parameter import parameters_of, sizes_of

_byref, _from_buffer = ctypes.byref, ctypes.c_char.from_buffer  # four times as fast as array.ctypes.data
_NO_MEMORY, _WRONG_SIZE = -1, -2  # of native/common.h; what is 0 or more is for the caller
_SHAPES_REMEMBERED = 64  # by each kernel


class Kernel:
    """A C function behind a check of its arguments. Calling it releases the interpreter's lock."""

    def __init__(self, name: str, declaration: str, isa: str | None = None) -> None:
        self.name = name
        self.declaration = declaration
        self.parameters = parameters_of(declaration)
        self.sizes = sizes_of(self.parameters)
        self._arrays = [(i, p, p.plain_dtype) for i, p in enumerate(self.parameters) if p.axes is not None]
        self._handles = [(i, p) for i, p in enumerate(self.parameters) if p.is_handle]
        self._sizes_of_shapes: dict[tuple[tuple[int, ...] | None, ...], tuple[int, ...]] = {}
        self._isa = isa
        self._function: Any = None

    def on(self, isa: str) -> Kernel:
        """The same kernel compiled for another instruction set: for tests that compare them."""
        return Kernel(self.name, self.declaration, isa)

    def __call__(self, *arguments: Any) -> int:
        """Call it; what C returned.

        Raises
        ------
        TypeError, ValueError
            An array's dtype, shape or order is not as declared, or does not fit the handle.
        MemoryError
            C could not allocate.
        """
        if len(arguments) != len(self.parameters):
            raise TypeError(f"{self.name}: expected {len(self.parameters)} arguments, got {len(arguments)}.")
        values, seen = list(arguments), []
        try:
            for place, parameter in self._handles:
                _check_handle(values[place], parameter.kind)
            for place, parameter, dtype in self._arrays:
                array = arguments[place]
                try:
                    if array.dtype is not dtype:
                        raise TypeError
                    values[place] = _byref(_from_buffer(array))
                except (AttributeError, TypeError, ValueError):  # not what most arrays are: looked at closely
                    values[place] = parameter.pointer(array)
                seen.append(None if array is None else array.shape)
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
        """The sizes that C gets, remembered for the shapes that were seen."""
        sizes: dict[str, int] = {}
        for (_, parameter, _), shape in zip(self._arrays, shapes):
            parameter.match_axes(shape, sizes)
        if len(self._sizes_of_shapes) >= _SHAPES_REMEMBERED:
            self._sizes_of_shapes.clear()
        found = self._sizes_of_shapes[shapes] = tuple(sizes.get(name, 0) for name in self.sizes)
        return found

    def _load(self) -> Any:
        function = getattr(library(self._isa or instruction_set()), self.name)
        function.argtypes = [*(p.ctype for p in self.parameters), *(ctypes.c_ssize_t for _ in self.sizes)]
        function.restype = ctypes.c_int
        self._function = function
        return function


class Handle:
    """Memory that C owns: made by `<name>_new(sizes...)`, freed by `<name>_free` when Python lets go of it.

    One thread at a time may use it.
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


def _check_handle(handle: Any, kind: str) -> None:
    if not isinstance(handle, Handle) or handle.name != kind:
        raise TypeError(f'expected Handle("{kind}", ...), got {handle!r}.')
