"""Saturated: what is at the upper end in one channel says nothing, and what it blooms into neither."""

import numpy as np
import pytest

from gelform.confidence.causes import saturated
from made.seen_frames import SHAPE, patch, seen


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_one_channel_and_the_pixels_that_it_blooms_into(channel):
    pixels = np.full((*SHAPE, 3), 253, np.uint8)
    pixels[20, 30, channel] = 254
    frame = seen(pixels=pixels)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    found = saturated.sigma(frame)
    assert found.max() == np.float32(frame.limits.unseen)
    away = np.hypot(y - 20, x - 30)
    assert (found[away <= 2.5] > 0).all()
    assert not found[away > 3.7].any()


@pytest.mark.parametrize(("level", "expected"), [(252, True), (240, True), (239, False)])
def test_a_lost_part_is_saturated_where_it_was_bright(level, expected):
    came = np.full((*SHAPE, 3), 100, np.uint8)
    came[:, 40:] = level
    lost = patch(np.s_[:, 48:])
    assert np.array_equal(saturated.sigma(seen(lost=lost, lost_pixels=came)) > 0, lost & expected)
