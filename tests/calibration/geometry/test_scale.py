"""Scales carry what they come from: hand-worked uncertainties, weights, and disagreements that are refused."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform import Reconstructor, calibrate, with_scale
from gelform.calibration.geometry.scale import Scale, combined_scale, scale_from_points, scale_from_profile
from gelform.errors import DataError, SensorError


def test_two_points():
    scale = scale_from_points((10, 20), (310, 420), 25.0, sigma_px=0.5, sigma_mm=0.05)
    assert scale.mm_per_px == pytest.approx(0.05)
    # 25 mm +- 0.05 over 500 px +- 0.707: 0.2 % and 0.1414 %
    assert scale.sigma / scale.mm_per_px == pytest.approx(np.hypot(0.002, np.sqrt(0.5) / 500))
    assert "500.0 px and 25 mm" in scale.source


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 1000))
def test_sigma_is_the_scatter_of_marked_points(seed):
    rng = np.random.default_rng(seed)
    a, b = np.array([30.0, 40.0]), np.array([250.0, 130.0])
    marked = [
        scale_from_points(tuple(a + rng.normal(0, 0.5, 2)), tuple(b + rng.normal(0, 0.5, 2)), 12.0)
        for _ in range(400)
    ]
    scatter = np.std([scale.mm_per_px for scale in marked])
    assert scatter == pytest.approx(marked[0].sigma, rel=0.2)


def test_points_too_near_are_refused():
    with pytest.raises(ValueError, match=r"at least 5 px apart, got 4 px"):
        scale_from_points((0, 0), (4, 0), 1.0)


def test_a_mean_is_weighted_and_better_than_each():
    mean = combined_scale([Scale(0.0600, 0.0006, "a"), Scale(0.0606, 0.0003, "b")])
    assert mean.mm_per_px == pytest.approx((0.0600 + 4 * 0.0606) / 5)
    assert mean.sigma == pytest.approx(0.0003 * np.sqrt(4 / 5))
    assert mean.source == "a; b"
    assert combined_scale([mean]).mm_per_px == pytest.approx(mean.mm_per_px)


def test_scales_that_disagree_are_refused():
    with pytest.raises(DataError, match=r"0\.06 .*\(a\) and 0\.07 .*\(b\): 7\.1 standard deviations"):
        combined_scale([Scale(0.06, 0.001, "a"), Scale(0.07, 0.001, "b")])
    with pytest.raises(ValueError, match="a step of a stage"):
        combined_scale([])


def test_lengths_along_both_axes_show_pixels_that_are_not_square():
    """A block of 7 x 5 mm at 11.7 and 10.8 px/mm, and its diagonal."""
    x = scale_from_points((10, 20), (10 + 7 * 11.7, 20), 7.0)
    y = scale_from_points((10, 20), (10, 20 + 5 * 10.8), 5.0)
    diagonal = scale_from_points((10, 20), (10 + 7 * 11.7, 20 + 5 * 10.8), np.hypot(7, 5))
    for scales in ((x, y), (y, diagonal, x)):
        with pytest.raises(DataError, match=r"not square: mm_per_px = \[0\.08547, 0\.092593\] fits"):
            combined_scale(scales)
    wrong = scale_from_points((10, 20), (10 + 7 * 11.7, 20 + 5 * 10.8), 7.0)
    longer = scale_from_points((10, 20), (10 + 7 * 11.7, 20), 8.0)
    for scales in ((x, y, wrong), (x, longer), (x, y, Scale(0.2, 0.001, "a grid"))):
        with pytest.raises(DataError, match="Leave the wrong one out"):
            combined_scale(scales)


def test_a_profile_has_its_doubt():
    scale = scale_from_profile("gelsight-mini")
    assert (scale.mm_per_px, scale.sigma) == (0.0634, 0.0009)
    assert "0.0625" in scale.source
    with pytest.raises(SensorError):
        scale_from_profile("mini")


@pytest.mark.slow
def test_depth_is_off_by_the_square_of_a_wrong_scale(presses, simulated):
    """The slopes of the balls and the steps between pixels are both off by its factor."""
    few, deepest = presses.subset(range(0, 14, 2)), []
    for wrong in (1.0, 1.04):
        scaled = with_scale(few, Scale(wrong * simulated.sensor.mm_per_px, 1e-4, "stated"))
        reconstruct = Reconstructor(calibrate(scaled, color_model="polynomial"))
        deepest.append(reconstruct(simulated.presses[0].image).depth_mm.max())
    assert deepest[1] / deepest[0] == pytest.approx(1.04**2, abs=0.01)
