"""The gel keeps its volume: closed form under a ball, membrane on the grid."""

import numpy as np
import pytest

from gelform.simulate import Ball, Gel, Punch, relaxation_from_gel
from gelform.simulate.gel.ball_press import contact_radius_of_ball, depth_of_ball
from gelform.simulate.gel.gel import surface_from_ball, surface_from_indenter
from gelform.simulate.gel.membrane import bulging_membrane_over, carried_along, spread

LENGTH = 0.5


def grid(half_mm, pitch):
    n = 2 * round(half_mm / pitch) + 1
    axis = (np.arange(n) - n // 2) * pitch
    return axis[None, :], axis[:, None]


@pytest.mark.parametrize("bulge", [0.4, 0.9])
def test_the_volume_that_is_left_is_what_the_model_promises(bulge):
    x, y = grid(14, 0.1)
    settings = {"center_mm": (0, 0), "depth_mm": 0.5, "relaxation_mm": LENGTH}
    gel = Gel(thickness_mm=1.5, bulge=bulge)
    by_formula = surface_from_ball(Ball(2), x, y, gel=gel, **settings)
    by_grid = surface_from_indenter(Ball(2), x, y, gel=gel, **settings)
    membrane, risen = bulging_membrane_over(
        0.5 + np.sqrt(np.maximum(4 - x**2 - y**2, 0)) - 2,
        relaxation_px=LENGTH / 0.1,
        bulge=bulge,
        bulge_px=15,
    )
    assert risen.sum() == pytest.approx(bulge * membrane.sum(), rel=1e-4)
    assert by_grid.depth_mm.sum() == pytest.approx((1 - bulge) * membrane.sum(), rel=1e-3)
    assert by_formula.depth_mm.sum() == pytest.approx((1 - bulge) * membrane.sum(), rel=0.01)
    assert by_formula.depth_mm.min() < -0.005


@pytest.mark.parametrize("bulge", [0.3, 0.8])
def test_the_grid_converges_to_the_closed_form(bulge):
    gel, errors = Gel(thickness_mm=2.0, bulge=bulge), []
    for pitch in (0.16, 0.08, 0.04):
        x, y = grid(8, pitch)
        settings = {"center_mm": (0, 0), "depth_mm": 0.5, "relaxation_mm": LENGTH, "gel": gel}
        exact = surface_from_ball(Ball(2.0), x, y, **settings)
        solved = surface_from_indenter(Ball(2.0), x, y, **settings)
        errors.append(np.abs(solved.depth_mm - exact.depth_mm)[np.hypot(x, y) < 2.5].max())
    assert errors[0] > 2 * errors[2], errors
    assert errors[2] < 1e-3, errors


def test_slopes_of_the_closed_form_are_those_of_its_depth():
    x, y = grid(5, 0.01)
    surface = surface_from_ball(
        Ball(2.0), x, y[498:503], center_mm=(0.1, 0), depth_mm=0.5, relaxation_mm=LENGTH, gel=Gel(1.5, 0.7)
    )
    slope = np.gradient(surface.depth_mm[2], 0.01)
    rim = contact_radius_of_ball(2.0, 0.5, LENGTH, thickness_mm=1.5, bulge=0.7)
    smooth = np.abs(np.abs(x[0] - 0.1) - rim) > 0.03
    np.testing.assert_allclose(surface.gradients[2, :, 0][smooth][1:-1], slope[smooth][1:-1], atol=3e-4)


def test_a_gel_that_bulges_touches_more_of_the_ball():
    radii = [contact_radius_of_ball(3.0, 0.5, LENGTH, thickness_mm=2, bulge=b) for b in (0, 0.4, 0.8)]
    assert radii[0] < radii[1] < radii[2]


def test_depth_and_rim_slope_are_one_relation_with_a_bulge():
    depth = depth_of_ball(3.0, 0.6, LENGTH, thickness_mm=2.0, bulge=0.7)
    a = contact_radius_of_ball(3.0, depth, LENGTH, thickness_mm=2.0, bulge=0.7)
    assert a / np.sqrt(9 - a**2) == pytest.approx(0.6, rel=1e-6)


def test_equal_lengths_are_no_pole():
    near, at = (contact_radius_of_ball(3.0, 0.5, 0.5, thickness_mm=h, bulge=0.5) for h in (0.505, 0.5))
    assert near == pytest.approx(at, rel=0.01)


def test_in_the_contact_the_surface_is_the_indenter():
    x, y = grid(5, 0.05)
    surface = surface_from_indenter(
        Punch(3.0), x, y, center_mm=(0, 0), depth_mm=0.4, relaxation_mm=LENGTH, gel=Gel(2.0, 0.8)
    )
    assert np.all(surface.depth_mm[surface.contact] == 0.4)
    assert surface.contact.sum() * 0.05**2 == pytest.approx(np.pi * 1.5**2, rel=0.03)


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


def test_a_stiffer_gel_and_a_slacker_coating_relax_sooner():
    assert relaxation_from_gel(25.0, 100.0, 4.0) == pytest.approx(1.0)
    assert relaxation_from_gel(25.0, 400.0, 4.0) == pytest.approx(0.5)


@pytest.mark.parametrize("settings", [{"thickness_mm": 0}, {"bulge": 1.0}, {"bulge": -0.1}, {"friction": -1}])
def test_bad_gels_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        Gel(**settings)
