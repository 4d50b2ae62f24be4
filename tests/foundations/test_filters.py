"""Medians without sorting are those of numpy, to the last bit."""

import numpy as np
import pytest

from gelform.foundations import filters
from gelform.foundations.filters import MEDIAN_SAMPLES, lattice_step, medians_where
from kernel_agreement import assert_kernel_agrees


def by_numpy(values, chosen, step):
    where = np.ones(values.shape[:2], bool) if chosen is None else chosen
    picked = values[::step, ::step][where[::step, ::step]]
    return np.median(picked, axis=0) if len(picked) else np.zeros(values.shape[2], np.float32)


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 2, 1), (7, 5, 2), (40, 61, 3)])
@pytest.mark.parametrize("kind", ["noise", "ties", "all alike", "huge and tiny", "negative"])
def test_medians_are_those_of_numpy(shape, step, kind):
    rng = np.random.default_rng(0)
    values = {
        "noise": lambda: rng.normal(0, 1, shape),
        "ties": lambda: rng.integers(-2, 3, shape),
        "all alike": lambda: np.full(shape, -0.25),
        "huge and tiny": lambda: rng.normal(0, 1, shape) * 10.0 ** rng.integers(-40, 38, shape),
        "negative": lambda: -rng.random(shape) - 1,
    }[kind]().astype(np.float32)
    for chosen in (None, rng.random(shape[:2]) < 0.6, np.zeros(shape[:2], bool)):
        found, count = medians_where(values, chosen, step)
        np.testing.assert_array_equal(found, by_numpy(values, chosen, step))
        assert count == np.count_nonzero(
            np.ones(shape[:2], bool)[::step, ::step] if chosen is None else chosen[::step, ::step]
        )


def test_the_kernel_agrees_with_numpy():
    rng = np.random.default_rng(1)
    values, chosen = rng.normal(0, 1, (30, 41, 3)).astype(np.float32), rng.random((30, 41)) < 0.4
    work, out = np.empty(2 * 30 * 41, np.float32), np.empty(3, np.float32)
    assert_kernel_agrees(
        filters._medians_where, lambda v, c, s, *_: by_numpy(v, c, s), values, chosen, 1, work, out
    )


@pytest.mark.parametrize("shape", [(240, 320), (720, 960), (2000, 3000)])
def test_a_lattice_has_about_as_many_pixels_as_medians_need(shape):
    step = lattice_step(shape[0] * shape[1])
    assert 0.7 * MEDIAN_SAMPLES < np.zeros(shape)[::step, ::step].size < 1.5 * MEDIAN_SAMPLES
    assert lattice_step(12) == 1
