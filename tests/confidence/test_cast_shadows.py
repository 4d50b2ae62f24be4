"""Cast shadows: darkness that no slope explains, and the slope that the other lights show there."""

import numpy as np
import pytest

from gelform.confidence.cast_shadows import DOUBTED, GIVEN_BACK, CastShadows, size_of
from gelform.confidence.forward_cells import CELL, explained_change

SHAPE = (96, 128)
NOISE, CLEAN = 0.03, 0.02
TOWARD = np.deg2rad([-30.0, 210.0, 90.0])  # of the three lights
PATCH = np.s_[40:64, 48:80]


def cells_of_three_lights():
    """Each channel changes by 1.5 of the slope towards its light, and by a little of that slope's square."""
    cells = np.zeros((-(-SHAPE[0] // CELL[0]), -(-SHAPE[1] // CELL[1]), 9, 3), np.float32)
    cells[..., 0, :], cells[..., 1, :] = 1.5 * np.cos(TOWARD), 1.5 * np.sin(TOWARD)
    cells[..., 2, :] = cells[..., 4, :] = -0.2
    return cells


@pytest.fixture(scope="module")
def shadows():
    return CastShadows(cells_of_three_lights(), SHAPE, NOISE, CLEAN)


def read_of(change):
    """Slopes (H, W, 2) of a color change by the same lights, to first order: what a color model reads."""
    along = 1.5 * np.stack([np.cos(TOWARD), np.sin(TOWARD)], axis=-1)
    return (change @ np.linalg.pinv(along).T).astype(np.float32)


def sloping_away(light, slope):
    away = -slope * np.array([np.cos(TOWARD[light]), np.sin(TOWARD[light])])
    return np.broadcast_to(away, (*SHAPE, 2)).astype(np.float32)


def test_no_slope_is_dark(shadows):
    rng = np.random.default_rng(0)
    slopes = np.repeat(np.repeat(rng.uniform(-0.5, 0.5, (24, 32, 2)), 4, 0), 4, 1).astype(np.float32)
    change = explained_change(cells_of_three_lights(), slopes)
    np.testing.assert_allclose(shadows.darkness(change, slopes), 0, atol=1e-5)
    assert shadows(change, slopes) is None


def hill():
    """Slopes (H, W, 2) of a hill 8 px high in the middle, 0.55 at the steepest."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = x - SHAPE[1] / 2, y - SHAPE[0] / 2
    height = 8 * np.exp(-(u**2 + v**2) / (2 * 9**2))
    return (-height / 9**2)[..., None] * np.stack([u, v], axis=-1)


def lee(light, of):
    """Pixels 18 to 30 px from the middle, within 30 degrees of away from a light; or towards it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = x - SHAPE[1] / 2, y - SHAPE[0] / 2
    along = of * (u * np.cos(TOWARD[light]) + v * np.sin(TOWARD[light]))
    away = np.hypot(u, v)
    return (away > 18) & (away < 30) & (along > 0.87 * away)


def read_in_shadow(light, patch, lost=0.4):
    """True slopes of the hill, the color change with less of a light in a patch, and the slopes read from it."""
    true = hill().astype(np.float32)
    change = explained_change(cells_of_three_lights(), true)
    change[..., light] -= np.float32(lost) * patch
    return true, change, read_of(change)


@pytest.mark.parametrize("light", range(3))
def test_a_hidden_light_is_given_back_behind_the_hill(shadows, light):
    # The channel brightens with the slope in the direction TOWARD: that of a surface that rises away from the light.
    patch = lee(light, 1)
    true, change, read = read_in_shadow(light, patch)
    shift, sigma = shadows(change, read)
    before, after = (size_of(one - true)[patch].mean() for one in (read, read + shift))
    assert after < (1 - 0.5 * GIVEN_BACK) * before, "the patch's rim is shared with blocks around it"
    assert np.median(sigma[patch]) >= DOUBTED * CLEAN
    assert sigma[hill_top()].max() == 0, "a hill casts no shadow on its own top"


def hill_top():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return np.hypot(x - SHAPE[1] / 2, y - SHAPE[0] / 2) < 6


@pytest.mark.parametrize("light", range(3))
def test_what_faces_the_light_is_in_no_shadow(shadows, light):
    _, change, read = read_in_shadow(light, lee(light, -1), lost=0.1)
    found = shadows(change, read)
    assert found is None or found[1][lee(light, -1)].mean() < 0.2 * DOUBTED * CLEAN


def test_the_gel_does_not_turn_to_the_hidden_light(shadows):
    change = explained_change(cells_of_three_lights(), sloping_away(0, 0.0))
    change[PATCH] -= 0.6  # of all lights: no slope at all is read, and none is made
    assert shadows(change, read_of(change)) is None


def test_faint_darkness_counts_around_sure_darkness_alone(shadows):
    dark = np.zeros(shadows.coarse, np.float32)
    dark[2:6, 2:6] = NOISE
    dark[10:16, 10:16], dark[12, 12] = NOISE, 2 * NOISE
    found = shadows.regions(dark)
    assert found[10:16, 10:16].all()
    assert found.sum() == 36


def test_a_bias_and_unseen_pixels(shadows):
    bias = np.array([0.02, -0.01], np.float32)
    _, change, read = read_in_shadow(1, lee(1, 1))
    for one, other in zip(shadows(change, read - bias, bias), shadows(change, read)):
        np.testing.assert_allclose(one, other, atol=1e-5)
    assert shadows(change, read, unseen=np.ones(SHAPE, bool)) is None
