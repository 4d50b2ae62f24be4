"""Indenters turned, tilted, several at once."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Coating, Cylinder, Mesh, Placed, Posed, Punch, Several, simulate_press
from gelform.simulate.indenters.pose import rotation
from made.sensors import AXIS, DRAGGED, X, Y, box


def test_a_pose_turns_the_indenter():
    settings = {"depth_mm": 0.3, "rng": None, "oversample": 1, "quantise": False}
    sensor = replace(DRAGGED, coating=Coating(), shape=(61, 61))
    lying = simulate_press(sensor, Cylinder(1.5, 3), **settings).depth_mm
    standing = simulate_press(sensor, Cylinder(1.5, 3), spin_deg=90, **settings).depth_mm
    np.testing.assert_allclose(standing, lying.T, atol=1e-4)


def test_a_spin_turns_from_right_to_down():
    face = Posed(Cylinder(1.01, 6.01), spin_deg=90).face_mm(X, Y)
    np.testing.assert_allclose(face, Cylinder(1.01, 6.01).face_mm(Y, X), atol=1e-9)
    quarter = Posed(Several((Placed(Ball(1), (2, 0)),)), spin_deg=90).face_mm(X, Y)
    row, column = np.unravel_index(np.argmax(quarter), quarter.shape)
    assert (AXIS[column], AXIS[row]) == pytest.approx((0, 2))


def test_a_tilted_punch_is_a_plane_with_the_slope_of_its_tilt():
    face = Posed(Punch(4, 4), tilt_deg=(0, 10)).face_mm(X, Y)
    inner = (AXIS > -1.5) & (AXIS < 1.5)
    slope = np.gradient(face[80][inner], AXIS[inner])
    np.testing.assert_allclose(slope, np.tan(np.deg2rad(10)), rtol=1e-6)
    about_x = Posed(Punch(4, 4), tilt_deg=(10, 0)).face_mm(X, Y)
    rise = np.gradient(about_x[:, 80][inner], AXIS[inner])
    np.testing.assert_allclose(rise, np.tan(np.deg2rad(10)), rtol=1e-6)


def test_a_ball_looks_the_same_from_all_sides():
    np.testing.assert_array_equal(Posed(Ball(2), 40, (20, -30)).face_mm(X, Y), Ball(2).face_mm(X, Y))


def test_rotation_keeps_lengths_and_spins_after_it_tilts():
    r = rotation(30, (20, -10))
    np.testing.assert_allclose(r @ r.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(r, rotation(30, (0, 0)) @ rotation(0, (20, -10)), atol=1e-12)
    assert (rotation(0, (0, 10)) @ [1, 0, 0])[2] > 0
    assert (rotation(0, (10, 0)) @ [0, 1, 0])[2] > 0


def test_a_tilted_mesh_is_the_tilted_shape():
    tilted = Posed(Mesh(*box(3.0, 3.0, 2.0)), spin_deg=25, tilt_deg=(6, 4)).face_mm(X, Y)
    shape = Posed(Punch(3.0, 3.0), spin_deg=25, tilt_deg=(6, 4)).face_mm(X, Y)
    both = np.isfinite(tilted) & np.isfinite(shape) & (tilted > -0.3)
    assert both.sum() > 1000
    assert np.quantile(np.abs(tilted[both] - shape[both]), 0.95) < 2e-3


def test_several_stand_as_far_back_as_told():
    pair = Several((Placed(Ball(2), (-2, 0)), Placed(Ball(2), (2, 0), back_mm=0.3)))
    face = pair.face_mm(X, Y)
    assert face[80, 40] == pytest.approx(0)
    assert face[80, 120] == pytest.approx(-0.3)
