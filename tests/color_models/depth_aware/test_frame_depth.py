"""The depth of a frame from its slopes, in pixels, whatever offset slopes and colours have."""

import numpy as np
import pytest

from gelform.color_models import Samples
from gelform.color_models.depth_aware.frame_depth import FrameDepth, untouched_change

SHAPE = (90, 120)


def cap(height_px=4.0, width_px=10.0):
    """Depth (H, W), px, and slopes (H, W, 2) of a Gaussian bump, and a color change that is there where it is."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    dx, dy = x - 70, y - 40
    depth = height_px * np.exp(-(dx**2 + dy**2) / (2 * width_px**2))
    slopes = np.stack([-dx, -dy], axis=-1) * (depth / width_px**2)[..., None]
    change = np.repeat(np.linalg.norm(slopes, axis=-1, keepdims=True), 3, axis=-1)
    return depth, slopes.astype(np.float32), change.astype(np.float32)


@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_depth_is_that_of_the_slopes_and_0_where_the_gel_is_untouched(offset):
    depth, slopes, change = cap()
    found = FrameDepth(SHAPE, 0.01)(change + np.float32(offset), slopes + np.float32(offset))
    assert found.shape == SHAPE
    assert found.min() == 0
    np.testing.assert_allclose(found, depth, atol=0.3)


def test_untouched_is_what_nearly_all_samples_without_a_slope_stay_under():
    change = np.concatenate([np.full((99, 3), 0.01), np.full((1, 3), 0.5), np.full((50, 3), 2.0)])
    slopes = np.concatenate([np.zeros((100, 2)), np.full((50, 2), 0.3)])
    at = np.zeros(150)
    samples = Samples(change, at, at, slopes, np.ones(150), SHAPE)
    assert 0.01 < untouched_change(samples) / np.sqrt(3) < 0.5
