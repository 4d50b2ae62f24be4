"""Dark: what is at the lower end says nothing, but where no light reaches at rest either, or another channel saturates."""

import numpy as np
import pytest

from gelform.confidence.causes import dark, saturated
from made.seen_frames import SHAPE, limits, patch, seen


def test_one_channel_in_the_dark():
    pixels = np.full((*SHAPE, 3), 3, np.uint8)
    assert not dark.sigma(seen(pixels=pixels)).any()
    pixels[20, 30, 1] = 2
    found = dark.sigma(seen(pixels=pixels)) > 0
    assert found[20, 30]
    assert found[20, 33]
    assert not found[20, 34]


def test_not_where_it_is_dark_at_rest():
    pixels = np.zeros((*SHAPE, 3), np.uint8)
    outside = np.ones(SHAPE, dtype=bool)
    assert not dark.sigma(seen(pixels=pixels, of=limits(outside=outside))).any()


def test_a_pixel_is_saturated_or_dark_not_both():
    pixels = np.full((*SHAPE, 3), 100, np.uint8)
    pixels[20, 30] = 0, 100, 255
    frame = seen(pixels=pixels)
    assert saturated.sigma(frame)[20, 30] > 0
    assert dark.sigma(frame)[20, 30] == 0


@pytest.mark.parametrize(("level", "expected"), [(7, True), (16, True), (17, False)])
def test_a_lost_part_is_dark_where_it_was(level, expected):
    came = np.full((*SHAPE, 3), 100, np.uint8)
    came[:, 30:] = level
    lost = patch(np.s_[:, 48:])
    assert np.array_equal(dark.sigma(seen(lost=lost, lost_pixels=came)) > 0, lost & expected)


def test_a_black_marker_is_a_marker():
    pixels = np.full((*SHAPE, 3), 100, np.uint8)
    pixels[patch()] = 1
    assert not dark.sigma(seen(pixels=pixels, markers=patch())).any()
