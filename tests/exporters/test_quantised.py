"""16-bit depth comes back within half a step, and nothing is clipped."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from gelform.errors import DataError
from gelform.exporters.quantised import depth_from_levels, levels_from_depth

DEPTHS = arrays(np.float64, (3, 4), elements=st.floats(-3.2766, 3.2766))


@given(DEPTHS, arrays(bool, (3, 4)))
def test_depth_comes_back(depth, known):
    back, back_known = depth_from_levels(levels_from_depth(depth, known))
    np.testing.assert_array_equal(back_known, known)
    np.testing.assert_allclose(back[known], depth[known], atol=0.5e-4 + 1e-6)
    assert not back[~known].any()


def test_zero_is_the_middle_and_a_level_is_a_tenth_of_a_micrometre():
    np.testing.assert_array_equal(levels_from_depth([[0.0, 1e-4, -1.0]]), [[32768, 32769, 22768]])


def test_out_of_range_is_refused():
    for depth in [3.3, -3.2769, 1e9]:
        with pytest.raises(DataError, match="16 bits"):
            levels_from_depth([[depth]])
        assert levels_from_depth([[depth]], [[False]]) == 0


def test_other_levels_are_refused():
    with pytest.raises(TypeError, match="uint16"):
        depth_from_levels(np.zeros((2, 2), dtype=np.uint8))
