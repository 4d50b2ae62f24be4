"""Meshes as indenters."""

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Mesh, Punch, simulate_press
from gelform.simulate.indenters import mesh
from kernel_agreement import assert_kernel_agrees
from made.sensors import X, Y, box


def test_a_mesh_of_a_box_is_a_punch():
    mesh = Mesh(*box(3.0, 1.0, 5.0))
    there = np.isfinite(mesh.face_mm(X, Y))
    np.testing.assert_array_equal(there, np.isfinite(Punch(3.0, 1.0).face_mm(X, Y)))
    assert np.abs(mesh.face_mm(X, Y)[there]).max() < 1e-12


def test_a_mesh_can_be_pressed():
    press = simulate_press(LAYOUTS["ring-120"], Mesh(*box(4, 2, 3)), depth_mm=0.4, rng=None, oversample=1)
    assert press.depth_mm.max() == pytest.approx(0.4)
    assert press.contact.sum() * 0.0634**2 == pytest.approx(8, rel=0.05)


def test_the_kernel_is_the_highest_plane_over_each_point():
    rng = np.random.default_rng(2)
    vertices = rng.uniform(-1, 1, (12, 3))
    triangles = rng.integers(0, 12, (9, 3))

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

    start = np.full((50, 60), -2.0)  # not -inf, so that there is a range
    assert_kernel_agrees(mesh._rasterise, reference, vertices, triangles, start, -1.0, -0.9, 0.035, 0.037)


def test_corners_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="do not fit"):
        mesh._rasterise(np.zeros((3, 3)), np.array([[0, 1, 3]]), np.zeros((4, 4)), 0.0, 0.0, 1.0, 1.0)
