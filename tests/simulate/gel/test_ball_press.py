"""The gel under a ball in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.simulate import Ball, Gel
from gelform.simulate.gel import ball_press
from gelform.simulate.gel.ball_press import ball_press as press_of_ball
from gelform.simulate.gel.ball_press import depth_of_ball
from gelform.simulate.gel.gel import surface_from_indenter
from kernel_agreement import assert_kernel_agrees
from made.sensors import LENGTH, grid


def ball_surface(pitch, gel=None):
    return surface_from_indenter(
        Ball(2.0), *grid(3, pitch), center_mm=(0.13, -0.21), depth_mm=0.7, relaxation_mm=LENGTH, gel=gel
    )


def test_the_gel_follows_a_ball_in_the_contact_and_falls_off_beside_it():
    surface = ball_surface(0.02)
    x, y = surface.x_mm - 0.13, surface.y_mm + 0.21
    r = np.hypot(x, y)
    a = press_of_ball(2.0, 0.7, LENGTH).contact_radius_mm
    np.testing.assert_array_equal(surface.contact, r <= a)
    cap = np.sqrt(4 - r[surface.contact] ** 2) - 2 + 0.7
    np.testing.assert_allclose(surface.depth_mm[surface.contact], cap, atol=1e-14)
    assert surface.depth_mm.min() >= 0
    assert np.all(surface.depth_mm[r > a + 5 * LENGTH] < 0.005)


def test_the_slope_is_continuous_at_the_rim():
    a = press_of_ball(2.0, 0.7, LENGTH).contact_radius_mm
    x = np.array([[a - 1e-7, a + 1e-7]])
    surface = surface_from_indenter(
        Ball(2.0), x, np.zeros((1, 1)), center_mm=(0, 0), depth_mm=0.7, relaxation_mm=LENGTH
    )
    assert surface.contact.tolist() == [[True, False]]
    np.testing.assert_allclose(surface.gradients[0, 0], surface.gradients[0, 1], atol=1e-5)
    np.testing.assert_allclose(surface.depth_mm[0, 0], surface.depth_mm[0, 1], atol=1e-6)


@pytest.mark.parametrize("bulge", [0.0, 0.7])
def test_truth_slopes_are_those_of_the_truth_depth_to_second_order(bulge):
    errors, gel = [], Gel(1.5, bulge)
    rim = press_of_ball(2.0, 0.7, LENGTH, thickness_mm=1.5, bulge=bulge).contact_radius_mm
    for pitch in (0.08, 0.04, 0.02):
        surface = ball_surface(pitch, gel)
        slope_y, slope_x = np.gradient(surface.depth_mm, pitch, edge_order=2)
        r = np.hypot(surface.x_mm - 0.13, surface.y_mm + 0.21)
        smooth = np.abs(r - rim) > 0.2
        difference = np.stack([slope_x, slope_y], axis=-1) - surface.gradients
        errors.append(np.sqrt(np.mean(difference[smooth] ** 2)))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(order > 1.8), (errors, order)


@given(
    depth_mm=st.floats(0.01, 1.5),
    radius=st.floats(1.6, 20),
    length=st.floats(0.1, 2),
    bulge=st.floats(0, 0.8),
)
@settings(max_examples=50, deadline=None)
def test_depth_and_contact_radius_of_a_ball_are_one_relation(depth_mm, radius, length, bulge):
    gel = {"thickness_mm": 2.0, "bulge": bulge}
    a = press_of_ball(radius, depth_mm, length, **gel).contact_radius_mm
    slope = a / np.sqrt(radius**2 - a**2)
    assert 0 < a < radius
    assert depth_of_ball(radius, slope, length, **gel) == pytest.approx(depth_mm, rel=1e-5)


def test_equal_lengths_are_no_pole():
    near, at = (
        press_of_ball(3.0, 0.5, 0.5, thickness_mm=h, bulge=0.5).contact_radius_mm for h in (0.505, 0.5)
    )
    assert near == pytest.approx(at, rel=0.01)


def test_the_kernel_is_the_cap_and_its_table():
    press = ball_press.ball_press(2.0, 0.6, LENGTH, thickness_mm=2.0, bulge=0.5)
    a, step = press.contact_radius_mm, 0.002
    depth, slope = press.tail(a + step * np.arange(800))
    x, y = (axis.ravel() for axis in grid(1.8, 0.03))

    def reference(dx, dy, depth, slope, z, gradients, touching, radius, top, contact, step):
        r = np.hypot(dx, dy[:, None])
        inside, known = r <= contact, r < contact + step * (len(depth) - 1)
        tail = [np.where(known, values, 0) for values in press.tail(np.maximum(r, contact))]
        cosine = np.sqrt(np.where(inside, radius**2 - r**2, 1))
        z = np.where(inside, top - radius + cosine, tail[0])
        over_r = np.where(inside, -1 / cosine, tail[1] / np.maximum(r, 1e-9))
        return z, np.stack([over_r * dx, over_r * dy[:, None]], axis=-1), inside

    shape = (y.size, x.size)
    assert_kernel_agrees(
        ball_press._ball_surface, reference, x, y, depth, slope, np.zeros(shape), np.zeros((*shape, 2)),
        np.zeros(shape, bool), press.radius_mm, press.depth_mm, a, step,
    )  # fmt: skip
