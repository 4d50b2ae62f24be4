"""A ball's slopes, its center found from slopes, and the sphere through its depth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelform.result.metrics import ball
from gelform.result.metrics.ball import (
    ball_center,
    ball_gradients,
    center_jacobian,
    fit_sphere,
    followed_radius,
)
from kernel_agreement import assert_kernel_agrees

pytestmark = pytest.mark.linear_algebra

MM_PER_PX = 0.06
BALL_MM = 3.0
SHAPE = (120, 160)
CENTER = (80.3, 59.6)


def cap(contact_px=30.0):
    """Depth of a ball's cap on a flat gel, its slopes and where it touches."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    radius = BALL_MM / MM_PER_PX
    square = (x - CENTER[0]) ** 2 + (y - CENTER[1]) ** 2
    inside = square < contact_px**2
    height = np.sqrt(np.where(inside, radius**2 - square, 1)) - np.sqrt(radius**2 - contact_px**2)
    return np.where(inside, height * MM_PER_PX, 0), ball_gradients(x, y, CENTER, radius), inside


def test_ball_slopes_are_those_of_its_depth():
    depth, gradients, inside = cap()
    numeric = np.stack(np.gradient(depth, MM_PER_PX)[::-1], axis=-1)
    core = np.hypot(*(np.mgrid[: SHAPE[0], : SHAPE[1]][::-1] - np.array([80.3, 59.6])[:, None, None])) < 25
    np.testing.assert_allclose(gradients[core], numeric[core], atol=5e-4)
    assert inside.sum() > core.sum()


@given(st.floats(-30, 30), st.floats(-30, 30), st.floats(40, 90))
def test_slopes_are_odd_and_bounded(u, v, radius):
    """Opposite pixels have opposite slopes, and beyond the rim the slope is held instead of growing without bound."""
    one, other = ball_gradients([u, -u], [v, -v], (0.0, 0.0), radius)
    np.testing.assert_allclose(one, -other, atol=1e-12)
    assert np.hypot(*one) <= np.hypot(u, v) / radius / np.sqrt(1 - 0.97**2) + 1e-12


def test_center_is_found_despite_a_bad_third():
    y, x = (axis.ravel() for axis in np.mgrid[40:80, 60:100])
    gradients = ball_gradients(x, y, (80.3, 59.6), 50.0)
    gradients[x > 90] += 0.4
    robust, plain = (
        np.hypot(*np.subtract(ball_center(gradients, x, y, (77.0, 62.0), 50.0, scale=s), (80.3, 59.6)))
        for s in (0.05, 100.0)
    )
    assert robust < 0.8
    assert robust < 0.25 * plain
    exact = ball_center(ball_gradients(x, y, (80.3, 59.6), 50.0), x, y, (77.0, 62.0), 50.0)
    np.testing.assert_allclose(exact, (80.3, 59.6), atol=1e-3)


def test_sphere_fit_recovers_the_ball():
    depth, _, inside = cap()
    fit = fit_sphere(depth, inside, mm_per_px=MM_PER_PX, radius_mm=2.0)
    assert fit.radius_mm == pytest.approx(BALL_MM, rel=1e-3)
    np.testing.assert_allclose(fit.center_mm[:2], (80.3 * MM_PER_PX, 59.6 * MM_PER_PX), atol=1e-3)


def test_the_gel_follows_the_visible_circle_unless_that_is_as_wide_as_the_ball():
    assert followed_radius(60.0, 100.0) == 60
    assert followed_radius(96.0, 100.0) == 96
    assert followed_radius(97.0, 100.0) == followed_radius(150.0, 100.0) == 75
    steepest = np.linalg.norm(ball_gradients(0.8 * 75, 0.0, (0, 0), 100.0))
    assert steepest == pytest.approx(0.75)


def center_by_numpy(gradients, x, y, center, radius, scale, rounds):
    """Gauss-Newton with the derivatives of the slopes by the center, each step on all pixels."""
    found = center.copy()
    for _ in range(rounds):
        slopes = ball_gradients(x, y, tuple(found), radius)
        residual = gradients - slopes
        weight = np.repeat(1 / np.sqrt(1 + np.sum(residual**2, axis=-1) / scale**2), 2)
        jacobian = center_jacobian(slopes, radius).reshape(-1, 2)
        weighted = jacobian * weight[:, None]
        move = np.linalg.solve(weighted.T @ jacobian + 1e-12 * np.eye(2), weighted.T @ residual.ravel())
        found += np.clip(move, -0.2 * radius, 0.2 * radius)
        if np.hypot(*move) < 1e-3:
            break
    return found


@pytest.mark.parametrize("start", [(77.0, 62.0), (40.0, 20.0), (130.0, 59.0)])
@pytest.mark.parametrize("rounds", [1, 3, 30])
def test_the_kernel_finds_the_center_as_numpy_does(start, rounds):
    """From far off too, where slopes are held and steps are cut."""
    y, x = (v.ravel().astype(float) for v in np.mgrid[20:100:3, 30:130:3])
    noise = np.random.default_rng(0).normal(0, 0.1, (x.size, 2))
    gradients = ball_gradients(x, y, (80.3, 59.6), 50.0) + noise
    arguments = gradients, x, y, np.array(start), 50.0, 0.05, rounds
    assert_kernel_agrees(ball._ball_center, center_by_numpy, *arguments, tolerance=1e-10)
