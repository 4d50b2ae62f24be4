"""The check of every kernel: the same bits on every instruction set, and numpy's values within 1e-5."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from gelform._native import ISAS, Kernel, library


def usable_isas() -> list[str]:
    """The instruction sets that this processor runs."""
    return [isa for isa in ISAS if isa == "base" or library("base").cpu_level() >= ISAS[isa]]


def assert_kernel_agrees(
    kernel: Kernel, reference: Callable[..., Any], *arguments: Any, tolerance: float = 1e-5
) -> None:
    """Run a kernel on every instruction set and in numpy.

    `reference` takes the same arguments and returns what the kernel writes into its `out` arrays, in their order (one
    array, or a tuple). An argument that is a function, `lambda: Handle(...)`, is called anew for each run.
    An output named `work` is scratch memory and is not compared.
    `tolerance` is a fraction of the range of the reference's values.
    """
    expected = reference(*_fresh(arguments))
    expected = expected if isinstance(expected, tuple) else (expected,)
    runs = {isa: _written(kernel.on(isa), arguments) for isa in usable_isas()}
    for isa, outputs in runs.items():
        assert len(outputs) == len(expected)
        for output, baseline, wanted in zip(outputs, runs["base"], expected):
            assert output.tobytes() == baseline.tobytes(), f"{kernel.name}: {isa} differs from base"
            _assert_close(output, np.asarray(wanted), tolerance, kernel.name)


def _written(kernel: Kernel, arguments: tuple[Any, ...]) -> list[np.ndarray]:
    arguments = _fresh(arguments)
    kernel(*arguments)
    return [
        argument
        for parameter, argument in zip(kernel.parameters, arguments)
        if parameter.role == "out" and parameter.name != "work"
    ]


def _fresh(arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    return tuple(a.copy() if isinstance(a, np.ndarray) else a() if callable(a) else a for a in arguments)


def _assert_close(got: np.ndarray, wanted: np.ndarray, tolerance: float, name: str) -> None:
    assert got.shape == wanted.shape
    if wanted.dtype.kind in "bui":
        np.testing.assert_array_equal(got, wanted, err_msg=name)
        return
    wanted = wanted.astype(np.float64)
    known = wanted[np.isfinite(wanted)]
    span = max(np.ptp(known), np.abs(known).max()) if known.size else 1.0
    np.testing.assert_allclose(got, wanted, rtol=0, atol=tolerance * span, err_msg=name)
