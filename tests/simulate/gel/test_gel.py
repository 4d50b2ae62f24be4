"""The gel's surface on the grid: contact, convergence, volume."""

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Ball, Coin, Gel, Punch, Screw, relaxation_from_gel, simulate_press
from gelform.simulate.gel.gel import surface_from_ball, surface_from_indenter
from gelform.simulate.gel.membrane import bulging_membrane_over
from made.sensors import LENGTH, grid


def test_the_membrane_on_the_grid_converges_to_the_closed_form():
    errors = []
    for pitch in (0.08, 0.04, 0.02):
        x, y = grid(5, pitch)
        exact = surface_from_ball(Ball(2.0), x, y, center_mm=(0, 0), depth_mm=0.5, relaxation_mm=LENGTH)
        solved = surface_from_indenter(Ball(2.0), x, y, center_mm=(0, 0), depth_mm=0.5, relaxation_mm=LENGTH)
        errors.append(np.abs(solved.depth_mm - exact.depth_mm)[np.hypot(x, y) < 2.5].max())
    assert errors[2] < 1e-4, errors
    assert errors[0] > 2 * errors[1] > 4 * errors[2], errors


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


def test_in_the_contact_the_surface_is_the_indenter():
    x, y = grid(5, 0.05)
    surface = surface_from_indenter(
        Punch(3.0), x, y, center_mm=(0, 0), depth_mm=0.4, relaxation_mm=LENGTH, gel=Gel(2.0, 0.8)
    )
    assert np.all(surface.depth_mm[surface.contact] == 0.4)
    assert surface.contact.sum() * 0.05**2 == pytest.approx(np.pi * 1.5**2, rel=0.03)


@pytest.mark.parametrize("indenter", [Coin(diameter_mm=6), Screw(major_diameter_mm=5, length_mm=6)])
def test_reliefs_touch_and_stay_at_their_depth(indenter):
    press = simulate_press(LAYOUTS["ring-120"], indenter, depth_mm=0.4, rng=None, oversample=1)
    x, y = LAYOUTS["ring-120"].grid_mm()
    face = 0.4 + indenter.face_mm(x, y)
    np.testing.assert_array_equal(press.depth_mm[press.contact], face[press.contact])
    assert np.all(press.depth_mm >= np.maximum(face, 0))
    assert press.depth_mm.max() == pytest.approx(0.4, abs=0.01)
    assert press.contact.mean() > 0.005


def test_a_stiffer_gel_and_a_slacker_coating_relax_sooner():
    assert relaxation_from_gel(25.0, 100.0, 4.0) == pytest.approx(1.0)
    assert relaxation_from_gel(25.0, 400.0, 4.0) == pytest.approx(0.5)


@pytest.mark.parametrize("settings", [{"thickness_mm": 0}, {"bulge": 1.0}, {"bulge": -0.1}, {"friction": -1}])
def test_bad_gels_are_refused(settings):
    with pytest.raises(ValueError, match=next(iter(settings))):
        Gel(**settings)
