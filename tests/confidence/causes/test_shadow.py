"""Shadow: darker in common than any gradient makes it."""

import numpy as np
import pytest

from gelform.confidence.causes import inconsistent, shadow, specular
from made.seen_frames import NOISE, patch, seen

LIMIT = 3.7 * NOISE


def with_residual(*channels):
    residual = np.zeros((40, 72, 3), np.float32)
    residual[patch()] = channels
    return seen(residual=residual)


@pytest.mark.parametrize("depth", [0.13, 0.15, 0.18])
def test_what_all_channels_lose_in_common(depth):
    frame = with_residual(-depth, -depth, -depth)
    found = shadow.sigma(frame)
    assert found[patch()] == pytest.approx(3 * 1.5 * (depth - LIMIT), rel=1e-5)
    assert not found[~patch()].any()
    assert not specular.sigma(frame).any()
    assert not inconsistent.sigma(frame).any()


def test_within_the_response_s_noise_there_is_no_shadow():
    assert not shadow.sigma(with_residual(-0.11, -0.11, -0.11)).any()


def test_a_colour_is_no_shadow():
    assert not shadow.sigma(with_residual(-0.4, 0.2, 0.2)).any()


def test_without_a_forward_response_nothing_is_called_a_shadow():
    assert not shadow.sigma(seen(residual=None)).any()


def test_nothing_is_known_in_a_deep_shadow_and_where_its_blur_reaches():
    frame = with_residual(-0.3, -0.3, -0.3)
    found = shadow.sigma(frame)
    assert found[10:20, 30:44].min() >= np.float32(frame.limits.unseen)
    assert found[10:20, 27:47].min() >= np.float32(frame.limits.unseen)
    assert not found[10:20, :27].any()
