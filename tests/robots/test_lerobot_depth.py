"""Depth for LeRobot: every whole micrometer is recovered, and nothing is clipped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelform.errors import DataError
from gelform.robots import depth_from_lerobot_levels, lerobot_levels_from_depth

EVERY_LEVEL = np.arange(1, 65536, dtype=np.uint16).reshape(1, -1)


def test_every_level_comes_back_also_those_that_the_page_names():
    depth_mm = depth_from_lerobot_levels(EVERY_LEVEL)
    assert depth_mm.dtype == np.float32
    np.testing.assert_array_equal(lerobot_levels_from_depth(depth_mm), EVERY_LEVEL)
    assert depth_from_lerobot_levels(np.array([[1000.5]])) == pytest.approx(0.0005)
    depth_mm = np.array([[0.0, 0.001, -0.999, 1.0, 64.535]], np.float32)
    levels = lerobot_levels_from_depth(depth_mm)
    assert levels.dtype == np.uint16
    assert levels.tolist() == [[1000, 1001, 1, 2000, 65535]]
    np.testing.assert_array_equal(depth_from_lerobot_levels(levels), depth_mm)


@given(st.floats(-0.99, 64.5, allow_nan=False))
def test_any_depth_is_rounded_to_half_a_micrometer(depth_mm):
    back = depth_from_lerobot_levels(lerobot_levels_from_depth([[depth_mm]]))
    assert abs(float(back[0, 0]) - depth_mm) <= 0.0005 + 4e-6  # float32 at 64 mm


def test_out_of_range_or_no_number_is_an_error():
    for depth_mm in [-1.0, 64.536, -0.9996]:
        with pytest.raises(DataError, match=r"-0\.999 to 64\.535 mm"):
            lerobot_levels_from_depth(np.array([[0.0, depth_mm]]))
    with pytest.raises(ValueError, match="depth_mm"):
        lerobot_levels_from_depth(np.array([[np.nan]]))
    with pytest.raises((ValueError, TypeError)):
        depth_from_lerobot_levels(np.array([["a"]]))
