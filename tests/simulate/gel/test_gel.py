"""The gel's surface: contact, relaxation, truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.simulate import LAYOUTS, Ball, Coin, HeightMap, Screw, simulate_press
from gelform.simulate.gel.ball_press import contact_radius_of_ball, depth_of_ball
from gelform.simulate.gel.gel import surface_from_ball, surface_from_indenter
from gelform.simulate.gel.membrane import membrane_over

LENGTH = 0.5


def grid(half_mm, pitch):
    n = 2 * round(half_mm / pitch) + 1
    axis = (np.arange(n) - n // 2) * pitch
    return axis[None, :], axis[:, None]


def ball_surface(pitch, depth_mm=0.7, center=(0.13, -0.21), radius=2.0):
    return surface_from_ball(
        Ball(radius), *grid(3, pitch), center_mm=center, depth_mm=depth_mm, relaxation_mm=LENGTH
    )


def test_the_gel_follows_a_ball_in_the_contact_and_falls_off_beside_it():
    surface = ball_surface(0.02)
    x, y = surface.x_mm - 0.13, surface.y_mm + 0.21
    r = np.hypot(x, y)
    a = contact_radius_of_ball(2.0, 0.7, LENGTH)
    np.testing.assert_array_equal(surface.contact, r <= a)
    cap = np.sqrt(4 - r[surface.contact] ** 2) - 2 + 0.7
    np.testing.assert_allclose(surface.depth_mm[surface.contact], cap, atol=1e-14)
    assert surface.depth_mm.min() >= 0
    assert np.all(surface.depth_mm[r > a + 5 * LENGTH] < 0.005)


def test_beside_the_contact_the_surface_obeys_its_equation():
    surface = ball_surface(0.01)
    u = surface.depth_mm
    laplacian = (u[1:-1, 2:] + u[1:-1, :-2] + u[2:, 1:-1] + u[:-2, 1:-1] - 4 * u[1:-1, 1:-1]) / 0.01**2
    r = np.hypot(surface.x_mm - 0.13, surface.y_mm + 0.21)[1:-1, 1:-1]
    free = r > contact_radius_of_ball(2.0, 0.7, LENGTH) + 0.03
    np.testing.assert_allclose(LENGTH**2 * laplacian[free], u[1:-1, 1:-1][free], atol=2e-4)


def test_the_slope_is_continuous_at_the_rim():
    a = contact_radius_of_ball(2.0, 0.7, LENGTH)
    x = np.array([[a - 1e-7, a + 1e-7]])
    surface = surface_from_ball(
        Ball(2.0), x, np.zeros((1, 1)), center_mm=(0, 0), depth_mm=0.7, relaxation_mm=LENGTH
    )
    assert surface.contact.tolist() == [[True, False]]
    np.testing.assert_allclose(surface.gradients[0, 0], surface.gradients[0, 1], atol=1e-5)
    np.testing.assert_allclose(surface.depth_mm[0, 0], surface.depth_mm[0, 1], atol=1e-6)


def test_truth_slopes_are_those_of_the_truth_depth_to_second_order():
    errors = []
    for pitch in (0.08, 0.04, 0.02):
        surface = ball_surface(pitch)
        slope_y, slope_x = np.gradient(surface.depth_mm, pitch, edge_order=2)
        r = np.hypot(surface.x_mm - 0.13, surface.y_mm + 0.21)
        smooth = np.abs(r - contact_radius_of_ball(2.0, 0.7, LENGTH)) > 0.2
        difference = np.stack([slope_x, slope_y], axis=-1) - surface.gradients
        errors.append(np.sqrt(np.mean(difference[smooth] ** 2)))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(order > 1.8), (errors, order)


def test_the_membrane_on_the_grid_converges_to_the_closed_form():
    errors = []
    for pitch in (0.08, 0.04, 0.02):
        x, y = grid(5, pitch)
        exact = surface_from_ball(Ball(2.0), x, y, center_mm=(0, 0), depth_mm=0.5, relaxation_mm=LENGTH)
        solved = surface_from_indenter(Ball(2.0), x, y, center_mm=(0, 0), depth_mm=0.5, relaxation_mm=LENGTH)
        errors.append(np.abs(solved.depth_mm - exact.depth_mm)[np.hypot(x, y) < 2.5].max())
    assert errors[2] < 1e-4, errors
    assert errors[0] > 2 * errors[1] > 4 * errors[2], errors


@given(depth_mm=st.floats(0.01, 1.5), radius=st.floats(1.6, 20), length=st.floats(0.1, 2))
@settings(max_examples=50, deadline=None)
def test_depth_and_contact_radius_of_a_ball_are_one_relation(depth_mm, radius, length):
    a = contact_radius_of_ball(radius, depth_mm, length)
    slope = a / np.sqrt(radius**2 - a**2)
    assert 0 < a < radius
    assert depth_of_ball(radius, slope, length) == pytest.approx(depth_mm, rel=1e-6)


def test_the_membrane_never_enters_the_obstacle_and_is_level_free_beside_it():
    rng = np.random.default_rng(3)
    obstacle = np.maximum(rng.normal(size=(40, 50)) - 1, 0)
    u = membrane_over(obstacle, relaxation_px=4.0)
    padded = np.pad(u, 1, mode="edge")
    force = 4 * u - padded[:-2, 1:-1] - padded[2:, 1:-1] - padded[1:-1, :-2] - padded[1:-1, 2:] + u / 16
    assert np.all(u >= obstacle)
    free = u > obstacle
    assert np.abs(force[free]).max() < 1e-3
    assert force[~free].min() > -1e-3
    assert 0.05 < free.mean() < 1


def test_turning_the_obstacle_turns_the_membrane():
    obstacle = np.zeros((30, 41))
    obstacle[5:12, 20:33] = 0.4
    u = membrane_over(obstacle, relaxation_px=3.0)
    np.testing.assert_allclose(membrane_over(obstacle[::-1].T, relaxation_px=3.0), u[::-1].T, atol=2e-5)


@pytest.mark.parametrize("indenter", [Coin(diameter_mm=6), Screw(major_diameter_mm=5, length_mm=6)])
def test_reliefs_touch_and_stay_at_their_depth(indenter):
    press = simulate_press(LAYOUTS["ring-120"], indenter, depth_mm=0.4, rng=None, oversample=1)
    x, y = LAYOUTS["ring-120"].grid_mm()
    face = 0.4 + indenter.face_mm(x, y)
    np.testing.assert_array_equal(press.depth_mm[press.contact], face[press.contact])
    assert np.all(press.depth_mm >= np.maximum(face, 0))
    assert press.depth_mm.max() == pytest.approx(0.4, abs=0.01)
    assert press.contact.mean() > 0.005


def test_a_height_map_of_a_ball_is_a_ball():
    pitch = 0.02
    x, y = grid(1.2, pitch)
    heights = np.sqrt(4 - x**2 - y**2)
    sensor = LAYOUTS["ring-120"]
    by_map = simulate_press(
        sensor, HeightMap(heights, pitch), depth_mm=0.3, center_mm=(1, 2), rng=None, oversample=1
    )
    by_ball = simulate_press(sensor, Ball(2), depth_mm=0.3, center_mm=(1, 2), rng=None, oversample=1)
    both = by_map.contact & by_ball.contact
    assert both.sum() > 0.9 * by_ball.contact.sum()
    np.testing.assert_allclose(by_map.depth_mm[both], by_ball.depth_mm[both], atol=1e-6)
    np.testing.assert_allclose(by_map.depth_mm, by_ball.depth_mm, atol=5e-3)
    inside = by_ball.depth_mm > 0.2
    np.testing.assert_allclose(by_map.gradients[inside], by_ball.gradients[inside], atol=5e-3)


def test_a_coarse_guess_that_does_not_settle_stops_nothing():
    """A coin's relief on the grid of half the resolution lets two contacts take turns; the fine grid settles."""
    sensor = LAYOUTS["homemade"]
    press = simulate_press(sensor, Coin(), depth_mm=0.35, rng=np.random.default_rng(7))
    assert press.depth_mm.max() == pytest.approx(0.35, rel=1e-3)
