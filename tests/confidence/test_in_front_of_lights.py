"""Where a hill stands in a light, against the rays of the hill itself."""

import numpy as np
import pytest

from gelform.confidence.in_front_of_lights import LOWEST_RAY, UPPER, InFrontOfLights

SHAPE, COARSE = (160, 240), (40, 60)
PX = 4.0  # of the image in a coarse pixel
Y, X = (np.mgrid[: COARSE[0], : COARSE[1]] - np.array([19.5, 29.5])[:, None, None]) * PX


def hill(height=28.0, wide=20.0):
    """Height and slopes, px, of a hill in the middle: it rises by 0.85 at the steepest."""
    z = height * np.exp(-(X**2 + Y**2) / (2 * wide**2))
    return z, (-z[..., None] / wide**2 * np.stack([X, Y], axis=-1)).astype(np.float32)


def lights(*degrees):
    angles = np.deg2rad(degrees)
    toward = np.stack([np.cos(angles), np.sin(angles)], axis=-1).astype(np.float32)
    return InFrontOfLights(np.broadcast_to(toward, (*COARSE, len(degrees), 2)), SHAPE)


@pytest.mark.parametrize("degrees", [0.0, 90.0, 215.0])
def test_what_the_lowest_rays_do_not_reach(degrees):
    z, slopes = hill()
    found = lights(degrees)(slopes)
    ux, uy = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    wanted = np.zeros(COARSE, bool)
    for away in np.arange(1.0, 110.0):
        beyond = 28.0 * np.exp(-((X + away * ux) ** 2 + (Y + away * uy) ** 2) / 800)
        wanted |= beyond - z > LOWEST_RAY * away
    wanted &= z < UPPER * 28.0
    assert wanted.sum() > 100
    assert np.mean(found == wanted) > 0.97
    assert not found[X * ux + Y * uy > 8].any(), "the side that faces the light"
    assert not found[z > 0.75 * z.max()].any(), "a hill casts no shadow on itself"


def test_gentle_hills_and_planes_stand_in_no_light():
    everywhere = lights(0.0, 120.0, 240.0)
    assert not everywhere(hill(height=6.0)[1]).any()
    assert not everywhere(np.full((*COARSE, 2), 0.1, np.float32)).any()


def test_several_lights_are_each_looked_at():
    slopes = hill()[1]
    both = lights(0.0, 90.0)(slopes)
    np.testing.assert_array_equal(both, lights(0.0)(slopes) | lights(90.0)(slopes))
