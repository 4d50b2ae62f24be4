"""Forward responses of older files, which were polynomials: the same colors, and no step."""

import numpy as np
import pytest

from gelform.color_models._shared.least_squares import (
    polynomial_terms,
    position_powers,
    term_count,
    unit_position,
)
from gelform.color_models.forward_response import (
    OLDER_DEPTH_DEGREE,
    STEEPEST_OLDER,
    older_response,
)

OLD_SHAPE, MM_PER_PX = (120, 160), 0.08
DEGREES = (3, 2, 1)
OLD_NOISE = np.array([0.01, 0.02, 0.04])


def coefficients(rng, degrees=DEGREES):
    """Of a polynomial of two values: 0.4 along the first order, less of the higher ones and of their change in place."""
    found = []
    for order, count in ((1, 2), (2, 3), (3, 4)):
        for _ in range(count):
            for i, j in position_powers(degrees[order - 1]):
                found.append(rng.normal(0, 0.4 / 2 ** (order - 1) / 2 ** (i + j), 3))
    return np.array(found)


def depth_coefficients(rng):
    """Of the depth in mm: less of its change in place."""
    return np.array([rng.normal(0, 0.1 / 2 ** (i + j), 3) for i, j in position_powers(OLDER_DEPTH_DEGREE)])


def of_slopes(slopes, x_px, y_px, known):
    """The color change that format 2 said of slopes."""
    return polynomial_terms(slopes, *unit_position(x_px, y_px, OLD_SHAPE), DEGREES) @ known


def of_normals(slopes, depth_mm, x_px, y_px, known, by_depth):
    """The color change that format 2 said of the normal's x and y and the depth."""
    x, y = unit_position(x_px, y_px, OLD_SHAPE)
    normals = slopes / np.sqrt(1 + np.sum(slopes**2, axis=1, keepdims=True))
    place = np.stack([depth_mm * x**i * y**j for i, j in position_powers(OLDER_DEPTH_DEGREE)], axis=1)
    return polynomial_terms(normals, x, y, DEGREES) @ known + place @ by_depth


@pytest.fixture(scope="module")
def seen():
    """Slopes, pixels, and depths up to 1 mm."""
    rng = np.random.default_rng(4)
    steepness, turn = STEEPEST_OLDER * np.sqrt(rng.uniform(size=3000)), rng.uniform(0, 2 * np.pi, 3000)
    slopes = steepness[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    x, y = (rng.integers(0, size, 3000) for size in OLD_SHAPE[::-1])
    return slopes, x, y, rng.uniform(0, 1, 3000)


def assert_same_colors(found, expected):
    """But for what is lost between the nodes, 16 px apart, and in another polynomial."""
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.01 * np.sqrt(np.mean(expected**2))
    assert np.abs(found - expected).max() < 0.03 * np.abs(expected).max()


def settings(**more):
    return {"position_degrees": list(DEGREES), "held_out_noise": None, "shadow_noise": None, **more}


@pytest.mark.parametrize("seed", range(3))
def test_a_polynomial_of_slopes_says_the_same_colors(seen, seed):
    """Up to the steepest slopes that presses of balls show: a polynomial of the normal is nearly one of the slopes there."""
    slopes, x, y, _ = seen
    known = coefficients(np.random.default_rng(seed))
    arrays = {"coefficients": known, "noise": OLD_NOISE}
    response = older_response(arrays, settings(), OLD_SHAPE, MM_PER_PX)
    assert_same_colors(response.color_from_gradients(slopes, x, y), of_slopes(slopes, x, y, known))
    np.testing.assert_allclose(response.color_from_gradients(0 * slopes, x, y), 0, atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_a_polynomial_of_normal_and_depth_says_the_same_colors(seen, seed):
    """Behind that of the slopes, which is not asked any more; depths were in mm, and are in px."""
    slopes, x, y, depth_mm = seen
    rng = np.random.default_rng(seed)
    plain, known = coefficients(rng), coefficients(rng)
    by_depth = depth_coefficients(rng)
    assert len(plain) == term_count(2, DEGREES)
    arrays = {"coefficients": np.concatenate([plain, known, by_depth]), "noise": OLD_NOISE}
    response = older_response(arrays, settings(), OLD_SHAPE, MM_PER_PX)
    for depth in (depth_mm, 0 * depth_mm):
        expected = of_normals(slopes, depth, x, y, known, by_depth)
        assert_same_colors(response.color_from_gradients(slopes, x, y, depth_px=depth / MM_PER_PX), expected)
    level = response.color_from_gradients(0 * slopes, x, y, depth_px=depth_mm / MM_PER_PX)
    expected = of_normals(0 * slopes, depth_mm, x, y, known, by_depth)
    assert np.abs(expected).max() > 0.1
    assert_same_colors(level, expected)


def test_without_a_scale_depths_in_mm_say_nothing(seen):
    """The slopes' own polynomial is left."""
    slopes, x, y, _ = seen
    rng = np.random.default_rng(0)
    plain = coefficients(rng)
    both = np.concatenate([plain, 9 * plain, depth_coefficients(rng)])
    response = older_response({"coefficients": both, "noise": OLD_NOISE}, settings(), OLD_SHAPE, None)
    expected = of_slopes(slopes, x, y, plain)
    assert_same_colors(response.color_from_gradients(slopes, x, y, depth_px=5.0), expected)


def test_noise_is_kept_and_no_step_is_taken():
    arrays = {"coefficients": coefficients(np.random.default_rng(0)), "noise": OLD_NOISE}
    response = older_response(arrays, settings(), OLD_SHAPE, MM_PER_PX)
    assert response.step_sigma is None
    assert response.clipped is None
    assert response.shape == OLD_SHAPE
    np.testing.assert_allclose(response.covariance, np.diag(OLD_NOISE**2))


@pytest.mark.parametrize(("held_out", "times"), [(3.0, 9.0), (0.5, 1.0), (None, 1.0)])
def test_what_held_out_presses_left_is_the_residuals_unit(held_out, times):
    """In squares, over the noise of the presses that trained; at least those."""
    usual = float(np.sqrt(np.mean(OLD_NOISE**2)))
    known = settings(held_out_noise=None if held_out is None else held_out * usual)
    arrays = {"coefficients": coefficients(np.random.default_rng(0)), "noise": OLD_NOISE}
    assert older_response(arrays, known, OLD_SHAPE, MM_PER_PX).residual_scale == pytest.approx(times)
    del known["held_out_noise"]  # the first formats lacked it
    assert older_response(arrays, known, OLD_SHAPE, MM_PER_PX).residual_scale == 1


def test_polynomials_of_lower_degree_and_without_noise_are_read():
    slopes, at = np.array([[0.2, -0.1]]), np.array([30])
    arrays = {"coefficients": np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), "noise": np.zeros(3)}
    response = older_response(arrays, {"position_degrees": [0]}, OLD_SHAPE, MM_PER_PX)
    np.testing.assert_allclose(response.color_from_gradients(slopes, at, at), [[-0.2, -0.1, 0.0]], atol=0.004)
    assert np.linalg.eigvalsh(response.covariance)[0] > 0
