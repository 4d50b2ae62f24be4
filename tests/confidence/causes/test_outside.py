"""Outside: where no light reaches at rest, in regions that are no dust."""

import numpy as np

from gelform.confidence.causes import outside
from made.seen_frames import SHAPE, limits, patch, seen


def test_an_unlit_corner_and_not_a_speck():
    background = np.full((*SHAPE, 3), 60, np.float32)
    corner = patch(np.s_[:12, :9])
    background[corner] = 5
    background[30:33, 30:33] = 2
    found = outside.outside_of_gel(background)
    assert np.array_equal(found, corner)
    frame = seen(of=limits(outside=found))
    assert np.array_equal(outside.sigma(frame) > 0, corner)


def test_one_lit_channel_is_light():
    background = np.zeros((*SHAPE, 3), np.float32)
    background[..., 2] = 30
    assert outside.outside_of_gel(background) is None
    assert not outside.sigma(seen()).any()


def test_unlit_is_up_to_8_levels_over_25_pixels():
    background = np.full((*SHAPE, 3), 9, np.float32)
    background[5:10, 5:10] = 8
    assert np.array_equal(outside.outside_of_gel(background), patch(np.s_[5:10, 5:10]))
    background[5, 5] = 9
    assert outside.outside_of_gel(background) is None
