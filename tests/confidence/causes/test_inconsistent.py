"""Inconsistent: colours that no slope gives, and parts of a frame that were lost though not clipped."""

import numpy as np
import pytest

from gelform.confidence.causes import inconsistent, specular
from made.seen_frames import NOISE, SHAPE, patch, seen


def test_what_the_channels_do_not_have_in_common():
    residual = np.zeros((40, 72, 3), np.float32)
    residual[patch()] = 0.2, -0.1, -0.1
    frame = seen(residual=residual)
    found = inconsistent.sigma(frame)
    size = np.sqrt((0.2**2 + 2 * 0.1**2) / 3)
    assert found[patch()] == pytest.approx(3 * 1.5 * (size - 3.7 * NOISE), rel=1e-5)
    assert not found[~patch()].any()
    assert not specular.sigma(frame).any()
    for light in (0.2, -0.2):
        assert not inconsistent.sigma(seen(residual=np.full((40, 72, 3), light, np.float32))).any()


def test_torn_parts_say_nothing():
    came = np.full((*SHAPE, 3), 128, np.uint8)
    frame = seen(lost=patch(np.s_[24:, :]), lost_pixels=came, residual=None)
    assert np.array_equal(inconsistent.sigma(frame) > 0, frame.lost)


def test_parts_lost_to_light_are_not_inconsistent():
    came = np.full((*SHAPE, 3), 255, np.uint8)
    assert not inconsistent.sigma(seen(lost=np.ones(SHAPE, bool), lost_pixels=came)).any()
