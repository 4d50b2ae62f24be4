"""The gel's surface on the grid: contact, convergence, volume; and how it is dragged along."""

import numpy as np
import pytest

from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coin,
    Drag,
    Gel,
    Placed,
    Pose,
    Punch,
    Screw,
    Several,
    relaxation_from_gel,
    roll_poses,
    simulate_press,
    slide_poses,
    twist_poses,
)
from gelform.simulate.gel.gel import displacement_at, surface_from_indenter
from gelform.simulate.gel.membrane import membrane_over
from made.sensors import DRAGGED, LENGTH, grid

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
    settings = {"center_mm": (0, 0), "depth_mm": 0.5, "relaxation_mm": LENGTH}
    gel = Gel(thickness_mm=1.5, bulge=bulge)
    by_formula = surface_from_indenter(Ball(2), x, y, gel=gel, **settings)
    by_grid = surface_from_indenter(ON_GRID, x, y, gel=gel, **settings)
    membrane, risen = membrane_over(
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


def test_a_long_slide_slips_at_the_friction_limit():
    moved = dragged(slide_poses(0.5, (-1, 0), (1, 0), 20), points=((1.0, 0.0),))
    assert moved[0, 0] == pytest.approx(0.5 * 0.5, rel=0.05)
    assert abs(moved[0, 1]) < 1e-3


def test_without_friction_nothing_is_dragged():
    gel = Gel(2.0, 0.0, friction=0.0)
    np.testing.assert_allclose(dragged(slide_poses(0.5, (-1, 0), (1, 0), 5), gel), 0, atol=1e-12)


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
