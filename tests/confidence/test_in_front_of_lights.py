"""Where a hill stands in a light, against the rays of the hill itself."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates, maximum_filter

from gelform.confidence import in_front_of_lights
from gelform.confidence.in_front_of_lights import LOWEST_RAY, REACH, UPPER, InFrontOfLights
from kernel_agreement import assert_kernel_agrees

SHAPE, COARSE = (160, 240), (40, 60)
EVERYWHERE = np.ones(COARSE, bool)
PX = 4.0  # of the image in a coarse pixel
Y, X = (np.mgrid[: COARSE[0], : COARSE[1]] - np.array([19.5, 29.5])[:, None, None]) * PX


def hill(height=28.0, wide=20.0):
    """Height and slopes, px, of a hill in the middle: it rises by 0.85 at the steepest."""
    z = height * np.exp(-(X**2 + Y**2) / (2 * wide**2))
    return z, (-z[..., None] / wide**2 * np.stack([X, Y], axis=-1)).astype(np.float32)


def lights(*degrees):
    angles = np.deg2rad(degrees)
    toward = np.stack([np.cos(angles), np.sin(angles)], axis=-1).astype(np.float32)
    in_front = InFrontOfLights(np.broadcast_to(toward, (*COARSE, len(degrees), 2)), (PX, PX))

    def found(slopes, asked=EVERYWHERE):
        behind = in_front(slopes, asked)
        return np.zeros(COARSE, bool) if behind is None else behind

    return found


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


def test_blocks_in_question_alone():
    slopes, asked = hill()[1], np.random.default_rng(0).uniform(size=COARSE) < 0.4
    np.testing.assert_array_equal(lights(0.0)(slopes, asked), lights(0.0)(slopes) & asked)
    assert InFrontOfLights(np.ones((*COARSE, 1, 2)), (PX, PX))(slopes, ~EVERYWHERE) is None


def test_the_same_on_every_instruction_set():
    rng = np.random.default_rng(1)
    depth, asked = hill()[0].astype(np.float32), rng.uniform(size=COARSE) < 0.7
    toward = rng.normal(0, 0.7, (*COARSE, 3, 2)).astype(np.float32)
    work = np.empty((COARSE[0] + 2 * REACH) * COARSE[1] + COARSE[1] + 2 * REACH, np.float32)

    def in_numpy(depth, asked, toward, *_):
        behind = np.zeros(COARSE, bool)
        for i, j in np.argwhere(asked):
            for light in toward[i, j]:
                steps = np.arange(1, 32)
                x, y = j + steps * light[0], i + steps * light[1]
                inside = np.cumprod((x >= 0) & (y >= 0) & (x < COARSE[1] - 1) & (y < COARSE[0] - 1)).astype(
                    bool
                )
                heights = map_coordinates(depth, [y[inside], x[inside]], order=1)
                behind[i, j] |= (heights > depth[i, j] + LOWEST_RAY * PX * steps[inside]).any()
        above = depth - np.median(depth)
        return behind & (above < UPPER * maximum_filter(above, 2 * REACH + 1, mode="nearest"))

    numbers = LOWEST_RAY * PX, UPPER
    assert_kernel_agrees(
        in_front_of_lights._behind_hills,
        in_numpy,
        depth,
        asked,
        toward,
        np.empty(COARSE, bool),
        work,
        *numbers,
    )
