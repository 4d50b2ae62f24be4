"""An error of all slopes together moves depth in proportion."""

import numpy as np
import pytest

from gelform.depth_sigma import total
from gelform.errors import ConvergenceError
from kernel_agreement import assert_kernel_agrees


@pytest.mark.parametrize("size", [1, 255, 700])
def test_squares_add_up_within_the_most(size):
    rng = np.random.default_rng(0)
    sigma, depth = rng.random(size).astype(np.float32), rng.normal(0, 2, size).astype(np.float32)
    expected = np.minimum(np.hypot(sigma, 0.3 * depth), 0.8)
    assert_kernel_agrees(total._add_in_proportion, lambda *_: expected, sigma, depth, 0.3, 0.8)
    assert total.add_in_proportion(sigma, depth, 0.3, 0.8) is sigma


@pytest.mark.parametrize(("bad", "share"), [(np.nan, 0.1), (np.inf, 0.1), (3e38, 0.1), (0.1, 1e30)])
def test_what_float32_does_not_hold_is_named(bad, share):
    sigma = np.full((2, 300), 0.1, np.float32)
    sigma[1, 120] = bad
    with pytest.raises(ConvergenceError, match="Expected a finite standard deviation of depth"):
        total.add_in_proportion(sigma, np.ones_like(sigma), share, 1.0)
