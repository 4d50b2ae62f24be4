"""The dark surround of a gel: where it is, and the largest rectangle without it."""

import numpy as np
import pytest

from gelform.image.background.surround import crop_inside, surround_of


def lit(shape=(120, 160), level=120.0):
    image = np.full((*shape, 3), level, dtype=np.float32)
    return image + np.random.default_rng(0).normal(0, 2, image.shape).astype(np.float32)


def test_dark_pixels_count_where_they_reach_the_border():
    assert surround_of(lit()) is None
    image = lit()
    image[:, :30] = 12
    outside = surround_of(image)
    np.testing.assert_array_equal(outside, np.arange(160)[None] < np.full((120, 1), 30))
    dust = lit()
    dust[50:90, 60:110] = 2
    assert surround_of(dust) is None, "a dark part inside the gel"
    one_channel = lit()
    one_channel[:, :30, 0] = 0
    assert surround_of(one_channel) is None, "lit from the other sides"


@pytest.mark.parametrize("size", [(120, 160), (243, 325)])
def test_the_crop_is_the_largest_one(size):
    outside = np.zeros(size, dtype=bool)
    height, width = size
    outside[: height // 4] = outside[:, : width // 2] = True
    left, top, wide, high = crop_inside(outside)
    assert not outside[top : top + high, left : left + wide].any()
    assert wide * high > 0.8 * (width / 2) * (3 * height / 4)
    notch = np.zeros(size, dtype=bool)
    notch[: height // 2, : width // 3] = True
    left, top, wide, high = crop_inside(notch)
    assert (left > width // 3, top, wide * high > 0.9 * width * height * 2 / 3) == (True, 0, True)
    assert crop_inside(np.ones(size, dtype=bool))[2:] == (0, 0)
