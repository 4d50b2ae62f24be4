"""Closed forms of the variance of depth, and what a grid of blocks leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth_sigma.closed_form import correlation_of_blocks, variance_of_white, variance_within_blocks


def test_what_cells_miss_makes_the_variance_of_pixels():
    """Cells of 4 pixels and what they miss, against the closed form of pixels, off the border."""
    fine = variance_of_white((80, 96), (0.1, 0.1))[0][20:60, 24:72].mean()
    coarse = variance_of_white((20, 24), (0.4, 0.4))[0][5:15, 6:18].mean() / 16
    missed = variance_within_blocks(1.0, 4)[0] * 0.01
    assert coarse + missed == pytest.approx(fine, rel=0.03)
    assert missed > 0.1 * fine


def test_turning_the_frame_swaps_the_slopes():
    x, y = variance_within_blocks(2.0, 4)
    assert x != pytest.approx(y, rel=1e-4)
    assert variance_within_blocks(0.5, 4) == pytest.approx((y, x))


@pytest.mark.parametrize("length", [2.0, 5.0, 20.0])
def test_cells_keep_the_power_at_low_frequencies(length):
    """Variance times the area over which errors hang together."""
    of_cells, power = correlation_of_blocks(length, 4)
    assert power * 2 * np.pi * (4 * of_cells) ** 2 == pytest.approx(2 * np.pi * length**2, rel=0.01)
    assert of_cells > length / 4
    assert power < 1


def test_long_errors_are_the_same_to_cells():
    of_cells, power = correlation_of_blocks(100.0, 4)
    assert of_cells == pytest.approx(25, rel=1e-3)
    assert power == pytest.approx(1, rel=2e-3)
