"""Faces against their geometry; meshes; indenters turned, tilted, several at once, and in the gel of every sensor."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.profiles import SENSORS
from gelform.simulate import (
    LAYOUTS,
    Ball,
    BoxEdge,
    Coating,
    Coin,
    Cone,
    Cylinder,
    HeightMap,
    Mesh,
    Optics,
    Placed,
    Posed,
    Punch,
    Pyramid,
    Screw,
    Several,
    Torus,
    indenters,
    simulate_background,
    simulate_press,
    text_relief,
)
from gelform.simulate.indenters import rotation
from kernel_agreement import assert_kernel_agrees
from made.sources import AXIS, DRAGGED, X, Y, box, grid


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


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_every_face_is_highest_at_its_foremost_point(shape):
    face = shape.face_mm(X, Y)
    assert face.shape == (161, 161)
    assert face.max() <= 0
    assert face.max() > -0.02
    assert np.isneginf(face[0, 0])


@pytest.mark.parametrize("name", [*LAYOUTS, *SENSORS])
def test_every_indenter_is_where_it_touches_the_gel_of_every_sensor(name):
    sensor = LAYOUTS[name] if name in LAYOUTS else SENSORS[name].simulated()
    sensor = replace(sensor, shape=(81, 111), optics=Optics())  # straight from above
    rest = simulate_background(sensor, None)
    for indenter in (*SHAPES, Mesh(*box(2, 1, 3)), Posed(Cylinder(2, 3), 30, (5, 0))):
        press = simulate_press(sensor, indenter, depth_mm=0.3, rng=None, oversample=1)
        face = 0.3 + indenter.face_mm(*sensor.grid_mm())
        np.testing.assert_allclose(press.depth_mm[press.contact], face[press.contact], atol=1e-12)
        assert (press.depth_mm - face).min() > -1e-5
        assert press.depth_mm.max() == pytest.approx(0.3, abs=0.02)
        assert press.contact.mean() > 0.002
        assert np.abs(press.image.astype(int) - rest).max() > 15


# mm from the middle of a coin to a point of its star, and to a notch
STAR, INNER = 0.58 * 4.0, 0.45 * 0.58 * 4.0
NOTCH = np.deg2rad(36 - 90)
# On an edge half of the relief is left. The star's points are at the top, the beads from the right on.
ON_COIN = [
    ((0.0, 0.0), 0.0),
    ((0.0, -STAR), -0.05),
    ((INNER * np.cos(NOTCH), INNER * np.sin(NOTCH)), -0.05),
    ((0.5 * INNER * np.cos(NOTCH), 0.5 * INNER * np.sin(NOTCH)), 0.0),
    ((0.0, STAR), -0.1),
    ((-0.74 * 4.0, 0.0), 0.0),
    ((-0.74 * 4.0, 0.05 * 4.0), -0.05),
    ((0.0, 0.86 * 4.0), -0.05),
    ((0.0, 3.9), 0.0),
    ((0.0, 4.1), -np.inf),
]


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
        *((Coin(8.0, 0.1), at, height) for at, height in ON_COIN),
    ],
)
def test_faces_are_what_their_geometry_says(shape, at, height):
    assert shape.face_mm(np.array([[at[0]]]), np.array([[at[1]]]))[0, 0] == pytest.approx(height)


def test_a_mesh_of_a_box_is_a_punch():
    mesh = Mesh(*box(3.0, 1.0, 5.0))
    there = np.isfinite(mesh.face_mm(X, Y))
    np.testing.assert_array_equal(there, np.isfinite(Punch(3.0, 1.0).face_mm(X, Y)))
    assert np.abs(mesh.face_mm(X, Y)[there]).max() < 1e-12


def test_the_kernel_is_the_highest_plane_over_each_point():
    def reference(vertices, triangles, height, x0, y0, hx, hy):
        y, x = np.mgrid[: height.shape[0], : height.shape[1]]
        x, y = x0 + x * hx, y0 + y * hy
        for a, b, c in vertices[triangles]:
            sides = np.array([b[:2] - a[:2], c[:2] - a[:2]]).T
            if np.linalg.det(sides) == 0:
                continue
            u, v = np.linalg.solve(sides, np.stack([x - a[0], y - a[1]]).reshape(2, -1)).reshape(2, *x.shape)
            z = a[2] + u * (b[2] - a[2]) + v * (c[2] - a[2])
            height = np.where((u >= 0) & (v >= 0) & (u + v <= 1), np.maximum(height, z), height)
        return height

    assert_kernel_agrees(indenters._rasterise, reference)


def test_corners_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="do not fit"):
        indenters._rasterise(np.zeros((3, 3)), np.array([[0, 1, 3]]), np.zeros((4, 4)), 0.0, 0.0, 1.0, 1.0)


def test_a_pose_turns_the_indenter():
    settings = {"depth_mm": 0.3, "rng": None, "oversample": 1, "quantise": False}
    sensor = replace(DRAGGED, coating=Coating(), shape=(61, 61))
    lying = simulate_press(sensor, Cylinder(1.5, 3), **settings).depth_mm
    standing = simulate_press(sensor, Cylinder(1.5, 3), spin_deg=90, **settings).depth_mm
    np.testing.assert_allclose(standing, lying.T, atol=1e-4)
    tilted = simulate_press(sensor, Punch(3.0, 3.0), tilt_deg=(0, 5), **settings)
    assert np.median(tilted.gradients[tilted.contact][:, 0]) == pytest.approx(np.tan(np.deg2rad(5)), rel=1e-3)


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
