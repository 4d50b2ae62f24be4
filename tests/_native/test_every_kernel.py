"""Every kernel, with arguments drawn from its own declaration: sizes, values, None in all combinations.

The instruction sets agree bit for bit, wherever the arrays lie; nothing but `out` arrays is written; what does not fit the
declaration is refused.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from kernel_agreement import declarations, drawn, usable_isas

KERNELS = {
    name: kernel
    for name, (_, kernel) in declarations().items()
    if not any(p.is_handle for p in kernel.parameters)
}
DRAWS, GUARD = 16, 256  # of the arguments; bytes around an array that have to stay


def called(kernel, arguments, shift):
    """Its status and what it wrote, with its arrays at other addresses; inputs that may only be read."""
    placed, memory = [], []
    for p, value in zip(kernel.parameters, arguments):
        if isinstance(value, np.ndarray):
            memory.append(np.full(value.nbytes + 2 * GUARD, 0xA5, np.uint8))
            own = memory[-1][GUARD - 16 * shift :][: value.nbytes].view(value.dtype).reshape(value.shape)
            own[...] = value
            own.flags.writeable = p.role == "out"
            placed.append(own)
        else:
            placed.append(value)
    status = kernel(*placed)
    for p, value, own in zip(kernel.parameters, arguments, placed):
        if isinstance(value, np.ndarray):
            edges = memory.pop(0)
            edges = np.delete(edges, np.s_[GUARD - 16 * shift : GUARD - 16 * shift + value.nbytes])
            assert np.all(edges == 0xA5), f"{kernel.name} writes beside {p.name}"
            assert p.role == "out" or own.tobytes() == value.tobytes(), f"{kernel.name} writes {p.name}"
    written = [a for p, a in zip(kernel.parameters, placed) if p.role == "out" and p.name != "work"]
    return status, [None if a is None else a.tobytes() for a in written]


@pytest.mark.parametrize("name", KERNELS)
def test_instruction_sets_agree_and_nothing_else_is_written(name):
    kernel, rng = KERNELS[name], np.random.default_rng(5)
    for turn in range(DRAWS):
        arguments = drawn(kernel, rng, turn)
        runs = [called(kernel.on(isa), arguments, shift) for shift, isa in enumerate(usable_isas())]
        assert all(run == runs[0] for run in runs), [np.shape(a) for a in arguments]


@pytest.mark.parametrize("name", KERNELS)
def test_what_is_not_as_declared_is_refused(name):
    kernel = KERNELS[name]
    arguments = drawn(kernel, np.random.default_rng(6), 1)
    axes = [
        a for p, value in zip(kernel.parameters, arguments) if value is not None for a in set(p.axes or ())
    ]
    for k, (p, value) in enumerate(zip(kernel.parameters, arguments)):
        if p.axes is None or value is None:
            continue
        wrong = [value.astype(np.complex64), value.tolist(), *([] if p.optional else [None])]
        if p.axes[0] != "...":
            wrong += [value[None], value[..., None]]
        tied = [i for i, a in enumerate(p.axes) if a != "..." and (a.isdigit() or axes.count(a) > 1)]
        wrong += [np.repeat(value, 2, axis=i) for i in tied]
        wrong += [value[:-1]] if p.name == "work" and len(p.axes) == 1 else []
        wrong += [value[..., ::-1]] if value.shape[-1] > 1 else []
        if p.role == "out":
            wrong += [np.frombuffer(value.tobytes(), value.dtype).reshape(value.shape)]
        for one in wrong:
            with pytest.raises((TypeError, ValueError), match=f"^{name}: (expected|arrays of shapes)"):
                kernel(*arguments[:k], one, *arguments[k + 1 :])


STEPPED = [name for name, kernel in KERNELS.items() if re.search(r"\bi\d+ step\b", kernel.declaration)]


@pytest.mark.parametrize("name", STEPPED)
def test_a_step_of_0_is_refused_before_anything_is_divided_by_it(name):
    arguments = drawn(kernel := KERNELS[name], np.random.default_rng(6), 1)
    stepless = [0 if p.name == "step" else value for p, value in zip(kernel.parameters, arguments)]
    with pytest.raises(ValueError, match="arrays of shapes"):
        kernel(*stepless)
