"""One press: determinism, grid, refusals."""

import numpy as np

from gelform.simulate import Ball, simulate_press
from made.sensors import SMALL


def test_same_seed_same_bytes():
    first, second, other = (
        simulate_press(SMALL, Ball(3), depth_mm=0.8, rng=np.random.default_rng(seed)) for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first.image, second.image)
    np.testing.assert_array_equal(first.depth_mm, other.depth_mm)
    assert np.any(first.image != other.image)


def test_truth_lies_on_pixel_centers_whatever_the_oversample():
    one, three = (
        simulate_press(SMALL, Ball(3), depth_mm=0.8, center_mm=(1.1, -2.3), rng=None, oversample=n)
        for n in (1, 3)
    )
    np.testing.assert_allclose(one.depth_mm, three.depth_mm, atol=1e-13)
    np.testing.assert_allclose(one.gradients, three.gradients, atol=1e-13)
    row, column = np.unravel_index(np.argmax(one.depth_mm), one.depth_mm.shape)
    assert abs(column - one.center_px[0]) <= 0.5
    assert abs(row - one.center_px[1]) <= 0.5
    x = SMALL.grid_mm()[0][0, column]
    assert abs(x - 1.1) <= 0.15
