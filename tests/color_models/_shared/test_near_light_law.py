"""The law of near lights: inverse squares and cosines, and derivatives that finite differences agree with."""

import numpy as np
import pytest

from gelform.color_models._shared.near_light_law import (
    OFF_DIAGONAL,
    Toward,
    light_ratio,
    light_ratio_derivatives,
)

POSITIONS = np.array([[1.4, 0.2, 0.6], [-0.9, 1.2, 0.8], [-0.6, -1.3, 0.7]])
MIXTURE = np.array([[1.0, 0.15, 0.05], [0.1, 1.0, 0.2], [0.02, 0.12, 1.0]])


@pytest.fixture
def pixels():
    rng = np.random.default_rng(0)
    slopes = rng.uniform(-0.8, 0.8, (40, 2))
    slopes[0] = 9, 0  # two lights are behind it
    normals = np.concatenate([-slopes, np.ones((40, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return normals, rng.uniform(-1, 1, 40), rng.uniform(-0.75, 0.75, 40)


def test_a_point_light_falls_with_the_square_of_the_distance(pixels):
    _, x, y = pixels
    light = Toward.of(x, y, POSITIONS, 2.0).light
    way = POSITIONS - np.stack([x, y, 0 * x], axis=-1)[:, None]
    distance = np.linalg.norm(way, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(light, axis=-1), np.sum(POSITIONS**2, axis=1) / distance**2)
    np.testing.assert_allclose(np.cross(light, way), 0, atol=1e-12)


def test_the_untouched_gel_has_the_ratio_one(pixels):
    _, x, y = pixels
    up = np.tile([0.0, 0.0, 1.0], (40, 1))
    np.testing.assert_allclose(light_ratio(up, x, y, POSITIONS, MIXTURE, 2.0), 1)


@pytest.mark.parametrize("falloff", [0.0, 2.0])
def test_derivatives_are_those_of_finite_differences(pixels, falloff):
    ratio, by_position, by_mixture = light_ratio_derivatives(*pixels, POSITIONS, MIXTURE, falloff)
    np.testing.assert_array_equal(ratio, light_ratio(*pixels, POSITIONS, MIXTURE, falloff))
    assert ratio[0].min() < 0.3
    step = 1e-6
    for k in range(9):
        move = step * (np.arange(9) == k).reshape(3, 3)
        up, down = (light_ratio(*pixels, POSITIONS + s * move, MIXTURE, falloff) for s in (1, -1))
        np.testing.assert_allclose(by_position[..., k], (up - down) / (2 * step), atol=1e-7)
    for k, (row, column) in enumerate(np.argwhere(OFF_DIAGONAL)):
        more, less = (MIXTURE + s * step * (np.arange(9).reshape(3, 3) == 3 * row + column) for s in (1, -1))
        up, down = (light_ratio(*pixels, POSITIONS, mixture, falloff) for mixture in (more, less))
        np.testing.assert_allclose(by_mixture[..., k], (up - down) / (2 * step), atol=1e-7)
