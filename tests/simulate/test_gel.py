"""The gel under a ball in closed form and on the grid: contact, convergence, volume; and how it is dragged along."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coin,
    Drag,
    Gel,
    Placed,
    Pose,
    Punch,
    Several,
    gel,
    relaxation_from_gel,
    roll_poses,
    simulate_press,
    slide_poses,
    twist_poses,
)
from gelform.simulate.gel import (
    ball_press,
    carried_along,
    depth_of_ball,
    displacement_at,
    membrane_over,
    spread,
    surface_from_indenter,
)
from kernel_agreement import assert_kernel_agrees, usable_isas
from made.sources import DRAGGED, LENGTH, grid


def ball_surface(pitch, gel=None):
    return surface_from_indenter(
        Ball(2.0), *grid(3, pitch), center_mm=(0.13, -0.21), depth_mm=0.7, relaxation_mm=LENGTH, gel=gel
    )


@pytest.mark.parametrize("bulge", [0.0, 0.7])
def test_the_slope_is_continuous_at_the_rim(bulge):
    a = ball_press(2.0, 0.7, LENGTH, Gel(1.5, bulge)).contact_radius_mm
    x = np.array([[a - 1e-7, a + 1e-7]])
    surface = surface_from_indenter(
        Ball(2.0),
        x,
        np.zeros((1, 1)),
        center_mm=(0, 0),
        depth_mm=0.7,
        relaxation_mm=LENGTH,
        gel=Gel(1.5, bulge),
    )
    assert surface.contact.tolist() == [[True, False]]
    np.testing.assert_allclose(surface.gradients[0, 0], surface.gradients[0, 1], atol=1e-5)
    np.testing.assert_allclose(surface.depth_mm[0, 0], surface.depth_mm[0, 1], atol=1e-6)


@pytest.mark.parametrize("bulge", [0.0, 0.7])
def test_truth_slopes_are_those_of_the_truth_depth_to_second_order(bulge):
    errors, gel = [], Gel(1.5, bulge)
    rim = ball_press(2.0, 0.7, LENGTH, gel).contact_radius_mm
    for pitch in (0.08, 0.04, 0.02):
        surface = ball_surface(pitch, gel)
        slope_y, slope_x = np.gradient(surface.depth_mm, pitch, edge_order=2)
        r = np.hypot(surface.x_mm - 0.13, surface.y_mm + 0.21)
        smooth = np.abs(r - rim) > 0.2
        difference = np.stack([slope_x, slope_y], axis=-1) - surface.gradients
        errors.append(np.sqrt(np.mean(difference[smooth] ** 2)))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(order > 1.8), (errors, order)


@given(st.floats(0.01, 1.5), st.floats(1.6, 20), st.floats(0.1, 2), st.floats(0, 0.8))
@settings(max_examples=50, deadline=None)
def test_depth_and_contact_radius_of_a_ball_are_one_relation(depth_mm, radius, length, bulge):
    a = ball_press(radius, depth_mm, length, Gel(2.0, bulge)).contact_radius_mm
    slope = a / np.sqrt(radius**2 - a**2)
    assert 0 < a < radius
    assert depth_of_ball(radius, slope, length, Gel(2.0, bulge)) == pytest.approx(depth_mm, rel=1e-5)


def test_equal_lengths_are_no_pole():
    near, at = (ball_press(3.0, 0.5, 0.5, Gel(h, 0.5)).contact_radius_mm for h in (0.505, 0.5))
    assert near == pytest.approx(at, rel=0.01)


def test_the_kernel_is_the_cap_and_its_table():
    press = ball_press(2.0, 0.6, LENGTH, Gel(2.0, 0.5))
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
        gel._ball_surface, reference, x, y, depth, slope, np.zeros(shape), np.zeros((*shape, 2)),
        np.zeros(shape, bool), press.radius_mm, press.depth_mm, a, step,
    )  # fmt: skip


def test_spreading_keeps_the_sum_and_obeys_its_equation():
    values = np.zeros((60, 80))
    values[20:30, 35:50] = 1.0
    smooth = spread(values, 6.0)
    laplacian = sum(np.roll(smooth, k, axis=a) for k in (1, -1) for a in (0, 1)) - 4 * smooth
    assert smooth.sum() == pytest.approx(values.sum(), rel=1e-9)
    np.testing.assert_allclose((smooth - 36 * laplacian)[2:-2, 2:-2], values[2:-2, 2:-2], atol=1e-9)


def test_what_is_fixed_stays_and_the_rest_falls_off():
    fixed = np.zeros((60, 60), dtype=bool)
    fixed[25:35, 25:35] = True
    carried = carried_along(np.where(fixed, 0.3, 0.0), fixed, 5.0)
    assert np.all(carried[fixed] == 0.3)
    assert 0.3 > carried[30, 40] > carried[30, 50] > 0
    laplacian = sum(np.roll(carried, k, axis=a) for k in (1, -1) for a in (0, 1)) - 4 * carried
    beside = ~fixed
    beside[[0, -1]] = beside[:, [0, -1]] = False
    np.testing.assert_allclose(25 * laplacian[beside], carried[beside], atol=5e-3)


@pytest.mark.slow
def test_a_coarse_guess_that_does_not_settle_stops_nothing():
    """A coin's relief on the grid of half the resolution lets two contacts take turns; the fine grid settles."""
    sensor = LAYOUTS["homemade"]
    press = simulate_press(sensor, Coin(), depth_mm=0.35, rng=np.random.default_rng(7))
    assert press.depth_mm.max() == pytest.approx(0.35, rel=1e-3)


def dense_membrane(obstacle, relaxation_px):
    """The same problem by projected relaxation on one grid, many times over."""
    u = np.maximum(obstacle, 0)
    spring = relaxation_px**-2
    color = np.add.outer(np.arange(u.shape[0]), np.arange(u.shape[1])) % 2
    for sweep in range(4000):
        padded = np.pad(u, 1, mode="edge")
        total = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        u = np.where(color == sweep % 2, np.maximum(total / (4 + spring), obstacle), u)
    return u


@pytest.mark.parametrize("shape", [(37, 50), (8, 9), (40, 3)])
def test_the_cycles_end_where_relaxation_on_one_grid_does(shape):
    obstacle = np.maximum(np.random.default_rng(4).normal(size=shape) - 0.8, 0)
    found = membrane_over(obstacle, relaxation_px=5.0)[0]
    np.testing.assert_allclose(found, dense_membrane(obstacle, 5.0), atol=1e-4 * obstacle.max())


def test_all_instruction_sets_give_the_same_bits(monkeypatch):
    """Only the kernel is changed: a handle made by one library is not for another."""
    obstacle = np.maximum(np.random.default_rng(4).normal(size=(60, 70)) - 1, 0)
    found = []
    for isa in usable_isas():
        monkeypatch.setattr(gel, "_membrane_cycles", gel._membrane_cycles.on(isa))
        found.append(membrane_over(obstacle, relaxation_px=6.0, bulge=0.5, bulge_px=20.0))
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])


ON_GRID = Several((Placed(Ball(2.0)),))  # a ball that is solved as any other face


@pytest.mark.parametrize("bulge", [0.0, 0.3, 0.8])
def test_the_grid_converges_to_the_closed_form(bulge):
    gel, errors = Gel(thickness_mm=2.0, bulge=bulge), []
    for pitch in (0.16, 0.08, 0.04):
        x, y = grid(8, pitch)
        settings = {"center_mm": (0, 0), "depth_mm": 0.5, "relaxation_mm": LENGTH, "gel": gel}
        exact = surface_from_indenter(Ball(2.0), x, y, **settings)
        solved = surface_from_indenter(ON_GRID, x, y, **settings)
        errors.append(np.abs(solved.depth_mm - exact.depth_mm)[np.hypot(x, y) < 2.5].max())
    assert errors[0] > (4 if bulge == 0 else 2) * errors[2], errors
    assert errors[2] < 1e-3, errors


@pytest.mark.parametrize("bulge", [0.4, 0.9])
def test_the_volume_that_is_left_is_what_the_model_promises(bulge):
    x, y = grid(14, 0.1)
    settings = {"center_mm": (0, 0), "depth_mm": 0.5, "relaxation_mm": LENGTH, "gel": Gel(1.5, bulge)}
    by_formula = surface_from_indenter(Ball(2), x, y, **settings)
    by_grid = surface_from_indenter(ON_GRID, x, y, **settings)
    face = 0.5 + np.sqrt(np.maximum(4 - x**2 - y**2, 0)) - 2
    membrane, risen = membrane_over(face, relaxation_px=LENGTH / 0.1, bulge=bulge, bulge_px=15)
    assert risen.sum() == pytest.approx(bulge * membrane.sum(), rel=1e-4)
    assert by_grid.depth_mm.sum() == pytest.approx((1 - bulge) * membrane.sum(), rel=1e-3)
    assert by_formula.depth_mm.sum() == pytest.approx((1 - bulge) * membrane.sum(), rel=0.01)
    assert by_formula.depth_mm.min() < -0.005


def test_in_the_contact_the_surface_is_the_indenter():
    x, y = grid(5, 0.05)
    surface = surface_from_indenter(
        Punch(3.0), x, y, center_mm=(0, 0), depth_mm=0.4, relaxation_mm=LENGTH, gel=Gel(2.0, 0.8)
    )
    assert np.all(surface.depth_mm[surface.contact] == 0.4)
    assert surface.contact.sum() * 0.05**2 == pytest.approx(np.pi * 1.5**2, rel=0.03)


def test_a_stiffer_gel_and_a_slacker_coating_relax_sooner():
    assert relaxation_from_gel(25.0, 100.0, 4.0) == pytest.approx(1.0)
    assert relaxation_from_gel(25.0, 400.0, 4.0) == pytest.approx(0.5)


def dragged(poses, gel=DRAGGED.gel, points=((0.0, 0.0),)):
    drag, grid = Drag(gel), DRAGGED.grid_mm()
    for pose in poses:
        surface = surface_from_indenter(
            Ball(3), *grid, center_mm=pose.center_mm, depth_mm=pose.depth_mm, relaxation_mm=0.5, gel=gel
        )
        field = drag(surface, pose)
    return displacement_at(field, surface, np.asarray(points))


def test_a_short_slide_carries_the_contact_with_it():
    still = dragged([Pose(0.5)])
    carried = dragged(slide_poses(0.5, (0, 0), (0.1, 0.05), 5))
    np.testing.assert_allclose(carried - still, [[0.1, 0.05]], atol=0.01)


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.5])
def test_a_long_slide_slips_at_the_friction_limit(friction):
    gel = replace(DRAGGED.gel, friction=friction)
    moved = dragged(slide_poses(0.5, (-1, 0), (1, 0), 20), gel, points=((1.0, 0.0),))
    assert moved[0, 0] == pytest.approx(0.5 * friction, rel=0.05, abs=5e-3)
    assert abs(moved[0, 1]) < 1e-3


def test_rolling_leaves_the_touched_surface_where_it_is():
    rolled = dragged(roll_poses(0.5, (-0.5, 0), (0.5, 0), 9), points=((0.5, 0.0),))
    np.testing.assert_allclose(rolled, 0, atol=5e-3)


def test_a_twist_turns_the_surface_about_the_contact():
    still, turned = (
        dragged(twist_poses(0.5, angle, 5), points=((0.5, 0.0), (0.0, 0.5))) for angle in (0, 10)
    )
    expected = 0.5 * np.deg2rad(10)
    np.testing.assert_allclose((turned - still)[0], [0, expected], atol=0.01)
    np.testing.assert_allclose((turned - still)[1], [-expected, 0], atol=0.01)


def test_pressing_pushes_the_gel_outwards():
    moved = dragged([Pose(0.6)], points=((1.5, 0.0), (-1.5, 0.0), (0.0, 1.5)))
    assert moved[0, 0] > 0.01
    assert moved[1, 0] == pytest.approx(-moved[0, 0], abs=1e-3)
    assert moved[2, 1] == pytest.approx(moved[0, 0], rel=0.1)
