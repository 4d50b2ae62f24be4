"""Faces: shapes, meshes, and indenters put together."""

import re

import numpy as np
import pytest

from gelform.simulate import (
    LAYOUTS,
    Ball,
    BoxEdge,
    Coin,
    Cone,
    Cylinder,
    HeightMap,
    Mesh,
    Placed,
    Posed,
    Punch,
    Pyramid,
    Screw,
    Several,
    Torus,
    simulate_press,
    text_relief,
)
from gelform.simulate.indenters.scene import rotation

AXIS = np.linspace(-4, 4, 161)
X, Y = AXIS[None, :], AXIS[:, None]
SHAPES = [
    Ball(3),
    BoxEdge(5),
    Coin(6),
    Cone(4),
    Cylinder(2, 5),
    Punch(4),
    Punch(4, 2),
    Pyramid(3),
    Screw(5),
    Torus(2, 0.6),
    text_relief("Gel 7", height_mm=1.5),
]


def box(width, height, depth):
    corners = np.array([(x, y, z) for x in (0, width) for y in (0, height) for z in (0, depth)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def turned(x, y, degrees):
    """Points before they were turned: so that face(turned) is the face turned by `degrees`."""
    a = np.deg2rad(degrees)
    return np.cos(a) * x + np.sin(a) * y, np.cos(a) * y - np.sin(a) * x


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_every_face_is_highest_at_its_foremost_point(shape):
    face = shape.face_mm(X, Y)
    assert face.shape == (161, 161)
    assert face.max() <= 0
    assert face.max() > -0.02
    assert np.isneginf(face[0, 0])


@pytest.mark.parametrize(
    ("shape", "at", "height"),
    [
        (Cylinder(2, 5), (2.0, 1.2), 1.6 - 2),
        (BoxEdge(6, 90), (1.0, -0.7), -0.7),
        (BoxEdge(6, 120), (1.0, 0.7), -0.7 / np.tan(np.pi / 3)),
        (Pyramid(4, 90), (0.3, -1.1), -1.1),
        (Cone(4, 90), (0.6, 0.8), -1.0),
        (Torus(2, 0.5), (1.2, 1.2), np.sqrt(0.25 - (1.2 * np.sqrt(2) - 2) ** 2) - 0.5),
        (Punch(3, 1), (1.4, 0.4), 0.0),
        (Punch(3, 1), (0.4, 1.4), -np.inf),
    ],
)
def test_faces_are_what_their_geometry_says(shape, at, height):
    assert shape.face_mm(np.array([[at[0]]]), np.array([[at[1]]]))[0, 0] == pytest.approx(height)


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


def test_a_mesh_of_a_box_is_a_punch():
    mesh = Mesh(*box(3.0, 1.0, 5.0))
    there = np.isfinite(mesh.face_mm(X, Y))
    np.testing.assert_array_equal(there, np.isfinite(Punch(3.0, 1.0).face_mm(X, Y)))
    assert np.abs(mesh.face_mm(X, Y)[there]).max() < 1e-12


def test_a_tilted_mesh_is_the_tilted_shape():
    tilted = Posed(Mesh(*box(3.0, 3.0, 2.0)), spin_deg=25, tilt_deg=(6, 4)).face_mm(X, Y)
    shape = Posed(Punch(3.0, 3.0), spin_deg=25, tilt_deg=(6, 4)).face_mm(X, Y)
    both = np.isfinite(tilted) & np.isfinite(shape) & (tilted > -0.3)
    assert both.sum() > 1000
    assert np.quantile(np.abs(tilted[both] - shape[both]), 0.95) < 2e-3


def test_a_mesh_can_be_pressed():
    press = simulate_press(LAYOUTS["ring-120"], Mesh(*box(4, 2, 3)), depth_mm=0.4, rng=None, oversample=1)
    assert press.depth_mm.max() == pytest.approx(0.4)
    assert press.contact.sum() * 0.0634**2 == pytest.approx(8, rel=0.05)


def test_several_stand_as_far_back_as_told():
    pair = Several((Placed(Ball(2), (-2, 0)), Placed(Ball(2), (2, 0), back_mm=0.3)))
    face = pair.face_mm(X, Y)
    assert face[80, 40] == pytest.approx(0)
    assert face[80, 120] == pytest.approx(-0.3)


OPEN = box(1, 1, 1)[0], box(1, 1, 1)[1][:-1]
REFUSED = [
    (lambda: Mesh(*OPEN), "3 edges that border only one triangle"),
    (lambda: Mesh(np.zeros((4, 3)), np.zeros((0, 3), dtype=int)), "an empty one"),
    (lambda: Mesh(box(1, 1, 1)[0] * 1e5, box(1, 1, 1)[1]), "another unit"),
    (lambda: Mesh(box(1, 1, 1)[0] * 1e-3, box(1, 1, 1)[1]), "metres x 1000"),
    (lambda: Mesh(box(1, 1, 1)[0], box(1, 1, 1)[1] + 5), "indices in 0-7"),
    (lambda: Mesh(box(1, 1, 1)[0] * np.nan, box(1, 1, 1)[1]), "finite vertices_mm"),
    (lambda: Cone(4, 180), "angle_deg in 0-180"),
    (lambda: Cylinder(6000, 1), "another unit"),
    (lambda: text_relief("  ", height_mm=2), "printable ASCII"),
    (lambda: text_relief("gél", height_mm=2), "printable ASCII"),
    (lambda: Posed(Coin(), tilt_deg=(80, 0)), "within +-75"),
    (lambda: Several(()), "at least one part"),
    (lambda: Several((Placed(Ball(1), back_mm=-1),)), "back_mm >= 0"),
    (lambda: HeightMap(np.zeros(4), 0.1), "height_mm"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_shapes_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
