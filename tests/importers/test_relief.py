"""Meshes and height images from files."""

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.importers.relief import read_height_image, read_mesh
from gelform.simulate import Ball

trimesh = pytest.importorskip("trimesh")
AXIS = np.linspace(-1, 1, 41)
X, Y = AXIS[None, :], AXIS[:, None]


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_a_mesh_of_a_ball_is_nearly_a_ball(tmp_path, suffix):
    path = tmp_path / f"ball.{suffix}"
    trimesh.creation.icosphere(subdivisions=5, radius=0.002).export(path)
    face = read_mesh(path, mm_per_unit=1000).face_mm(X, Y)
    np.testing.assert_allclose(face, Ball(2.0).face_mm(X, Y), atol=2e-3)


def test_open_empty_damaged_and_mistaken_meshes_are_refused(tmp_path):
    box = trimesh.creation.box((4, 3, 2))
    trimesh.Trimesh(box.vertices, box.faces[1:], process=False).export(tmp_path / "open.stl")
    (tmp_path / "empty.obj").write_text("v 0 0 0\n")
    (tmp_path / "damaged.ply").write_bytes(b"ply\nformat binary\x00\x01")
    box.export(tmp_path / "meters.stl")
    for name, scale, message in (
        ("open.stl", 1, "border only one triangle"),
        ("empty.obj", 1, "empty"),
        ("damaged.ply", 1, "damaged"),
        ("meters.stl", 1000, "another unit"),
        ("none.stl", 1, "No file"),
        ("box.step", 1, "Expected a mesh as .stl"),
    ):
        with pytest.raises(DataError, match=message):
            read_mesh(tmp_path / name, mm_per_unit=scale)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_a_height_image_is_scaled_to_its_height(tmp_path, dtype):
    ramp = np.linspace(0, np.iinfo(dtype).max, 21).astype(dtype)
    cv2.imwrite(str(tmp_path / "ramp.png"), np.repeat(ramp[None], 11, axis=0))
    face = read_height_image(tmp_path / "ramp.png", mm_per_px=0.1, height_mm=0.5).face_mm(X * 0.4, Y * 0.4)
    slope = np.gradient(face[20], X[0] * 0.4)
    np.testing.assert_allclose(slope, 0.25, atol=0.02)


def test_images_that_hold_no_heights_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "color.png"), np.zeros((4, 4, 3), dtype=np.uint8))
    (tmp_path / "text.png").write_text("no image")
    for name, message in (("color.png", "gray image"), ("text.png", "no image"), ("none.png", "No file")):
        with pytest.raises(DataError, match=message):
            read_height_image(tmp_path / name, mm_per_px=0.1, height_mm=0.5)
