"""Specular: brighter in common than any gradient makes it."""

import numpy as np
import pytest

from gelform.confidence.causes import shadow, specular
from made.seen_frames import NOISE, patch, seen


def test_what_all_channels_gain_in_common():
    residual = np.zeros((40, 72, 3), np.float32)
    residual[patch()] = 0.18, 0.16, 0.14
    frame = seen(residual=residual)
    found = specular.sigma(frame)
    assert found[patch()] == pytest.approx(
        3 * 1.5 * (np.sqrt((0.18**2 + 0.16**2 + 0.14**2) / 3) - 3.7 * NOISE), rel=1e-5
    )
    assert not found[~patch()].any()
    assert not shadow.sigma(frame).any()
