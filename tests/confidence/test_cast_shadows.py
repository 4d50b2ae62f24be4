"""Cast shadows: darkness that no slope explains, and the slope that the other lights show there."""

import numpy as np
import pytest

from gelform.confidence.cast_shadows import GIVEN_BACK, CastShadows, size_of
from gelform.confidence.forward_cells import CELL, explained_change

SHAPE = (96, 128)
NOISE = 0.03
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
    return CastShadows(cells_of_three_lights(), SHAPE, NOISE)


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


@pytest.mark.parametrize("light", range(3))
def test_a_hidden_light_is_given_back(shadows, light):
    true = sloping_away(light, 0.1)
    change = explained_change(cells_of_three_lights(), true)
    change[PATCH][..., light] -= 0.4
    read = read_of(change)
    shift = shadows(change, read)
    inner = np.s_[46:58, 54:74]
    before, after = (size_of(one - true)[inner].mean() for one in (read, read + shift))
    assert after == pytest.approx((1 - GIVEN_BACK) * before, abs=0.03)
    assert size_of(shift)[:30].max() == 0  # and nowhere else


def test_the_gel_does_not_turn_to_the_hidden_light(shadows):
    change = explained_change(cells_of_three_lights(), sloping_away(0, 0.0))
    change[PATCH] -= 0.6  # of all lights: no slope at all is read, and none is made
    read = read_of(change)
    shift = shadows(change, read)
    assert shift is None or size_of(shift).max() < 0.01


def test_faint_darkness_counts_around_sure_darkness_alone(shadows):
    dark = np.zeros(shadows.coarse, np.float32)
    dark[2:6, 2:6] = NOISE
    dark[10:16, 10:16], dark[12, 12] = NOISE, 2 * NOISE
    found = shadows.regions(dark)
    assert found[10:16, 10:16].all()
    assert found.sum() == 36


def test_a_bias_and_unseen_pixels(shadows):
    true, bias = sloping_away(1, 0.1), np.array([0.02, -0.01], np.float32)
    change = explained_change(cells_of_three_lights(), true)
    change[PATCH][..., 1] -= 0.4
    read = read_of(change)
    np.testing.assert_allclose(shadows(change, read - bias, bias), shadows(change, read), atol=1e-6)
    hidden = np.zeros(SHAPE, bool)
    hidden[32:72, 40:88] = True
    assert shadows(change, read, unseen=hidden) is None
