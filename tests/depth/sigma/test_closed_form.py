"""Closed forms of the variance of depth, and what a grid of blocks leaves out."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth.sigma.closed_form import (
    correlation_of_blocks,
    fading_within_blocks,
    variance_of_white,
    variance_within_blocks,
    white_as_blurred,
)


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


@pytest.mark.parametrize("length", [2.0, 5.0, 20.0, 100.0])
def test_cells_keep_the_power_at_low_frequencies(length):
    """Variance times the area over which errors hang together; long errors are the same to cells."""
    of_cells, power = correlation_of_blocks(length, 4)
    assert power * 2 * np.pi * (4 * of_cells) ** 2 == pytest.approx(2 * np.pi * length**2, rel=0.01)
    assert of_cells > length / 4
    assert power < 1
    if length == 100:
        assert (of_cells, power) == pytest.approx((25, 1), rel=2e-3)


@pytest.mark.parametrize("aspect", [1.0, 1.6])
@pytest.mark.parametrize("block", [2, 4, 6])
def test_what_blocks_miss_fades_where_an_anchor_holds(block, aspect):
    """Modes summed one by one, for anchors between those that the coefficients were fitted to."""
    c = fading_within_blocks(aspect, block)
    pitch = aspect**0.5, aspect**-0.5

    def variance(size, pixels, anchor):
        k = np.pi * np.arange(size) / size
        x, y = ((2 * np.sin(k / 2) / (pixels * h)) ** 2 for h in pitch)
        gain_x, gain_y = ((np.sin(k) / (pixels * h)) ** 2 for h in pitch)
        terms = (gain_x + gain_y[:, None]) / np.maximum(x + y[:, None] + anchor, 1e-9) ** 2
        terms[0, 0] = 0
        return terms.mean() / pixels**2

    missed = [
        variance(32 * block, 1, anchor) - variance(32, block, anchor) for anchor in (0, 3e-3, 0.07, 0.7, 30)
    ]
    for x, left in zip((3e-3, 0.07, 0.7, 30), missed[1:]):
        ratio = (1 + c[0] * x) / (1 + c[1] * x + c[2] * x**2 + c[3] * x**3)
        assert ratio == pytest.approx(left / missed[0], rel=0.02)


@pytest.mark.parametrize("length", [1e-300, 1e-9, 1e-4])
def test_a_correlation_far_below_a_pixel_is_none(length):
    assert white_as_blurred(1.0, 6, length) == pytest.approx(white_as_blurred(1.0, 6, 0.0), abs=1e-6)
