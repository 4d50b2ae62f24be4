"""From cells back to pixels."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth_sigma.blocks import sigma_of_pixels


@pytest.mark.parametrize("anchor", [0.0, 0.05])
def test_an_anchored_pixel_follows_its_neighbours_by_its_ties(anchor):
    weights, hold = np.ones((3, 3), dtype=np.float32), np.zeros((3, 3), dtype=np.float32)
    weights[1, 1], hold[1, 1] = 0.01, anchor
    sigma, out = np.full((3, 3, 2), 0.1, dtype=np.float32), np.empty((3, 3), dtype=np.float32)
    within = np.array([0.3, 0.2], dtype=np.float32)
    variance = np.full((3, 3), 0.04, dtype=np.float32)
    sigma_of_pixels(variance, sigma, within, weights, np.float32(1e-3), hold, out)
    free = np.sqrt(0.04 + 0.5 * 0.1**2)
    ties = 4 * 2 * 0.01 / 1.01
    assert out[1, 1] == pytest.approx(free * ties / (ties + anchor), rel=1e-5)
    assert out[0, 0] == pytest.approx(free, rel=1e-5)
