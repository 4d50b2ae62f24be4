"""Images from the values of data sets and from arrays of numpy."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.sensors.values import image_from_values, npy_values

IMAGE = np.random.default_rng(0).integers(0, 256, (6, 8, 3), dtype=np.uint8)


def test_kinds_of_frames_and_what_is_refused():
    png = cv2.imencode(".png", IMAGE[..., ::-1])[1].reshape(-1)
    for values in (
        IMAGE,
        IMAGE.astype(np.float32),
        np.concatenate([png, np.zeros(9, np.uint8)]),
        np.moveaxis(IMAGE, 2, 0),
        *((IMAGE / 255).astype(dtype) for dtype in (np.float16, np.float32, np.float64)),
        np.moveaxis(IMAGE / 255, 2, 0),
    ):
        np.testing.assert_array_equal(image_from_values(values), IMAGE)
    for values, said in (
        (IMAGE / 300, r"Expected whole numbers from 0 to 255, or .* float64 \(6, 8, 3\)"),
        (IMAGE.astype(np.float32) * 2, "Expected whole numbers from 0 to 255"),
        (np.full((6, 8, 3), np.nan), "Expected whole numbers"),
        (IMAGE[..., :2], r"got \(6, 8, 2\)"),
        (IMAGE / 255 - 0.5, "Expected whole numbers"),
        (np.zeros(0, np.uint8), "bytes that are no image"),
        (np.arange(90, dtype=np.uint8), "bytes that are no image"),
        (DataError("chunk 3 is damaged"), "chunk 3 is damaged"),
    ):
        with pytest.raises(DataError, match=said):
            image_from_values(values)


def test_arrays_of_numpy_are_images(tmp_path):
    path = tmp_path / "one.npy"
    for values in (IMAGE, IMAGE.astype(np.float64), IMAGE / 255):
        np.save(path, values)
        np.testing.assert_array_equal(gelform.read_image(path), IMAGE)
    for values, said in (
        (
            IMAGE[..., 0],
            r"array \(N, H, W, 3\) or one image \(H, W, 3\) of at most 200 megapixels, got \(6, 8\)",
        ),
        (np.moveaxis(IMAGE, 2, 0), "Move the axis of the colors last"),
        (np.zeros((0, 6, 8, 3), np.uint8), r"got \(0, 6, 8, 3\)"),
        (IMAGE.astype(np.int32) * 300, "one.npy: Expected whole numbers from 0 to 255"),
        (np.array([{"image": IMAGE}]), "no array file"),
    ):
        np.save(path, values)
        with pytest.raises(DataError, match=said):
            gelform.read_image(path)
    path.write_bytes(path.read_bytes()[:90])
    with pytest.raises(DataError, match="no array file"):
        npy_values(path)
    with pytest.raises(DataError, match="No file"):
        npy_values(tmp_path / "none.npy")
    np.save(path, np.broadcast_to(np.uint8(7), (40, 50, 3)))
    with pytest.raises(DataError, match=r"at most 0.0019 megapixels, got \(40, 50, 3\)"):
        gelform.read_image(path, most_pixels=1900)
