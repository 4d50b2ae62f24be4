"""Imported look-up tables: they answer as they say, with their own gain and blur; other files are refused."""

import cv2
import numpy as np
import pytest

import gelform
from gelform.color_models.lookup import LookupModel
from gelform.importers.tables import read_lut
from made.color_samples import SHAPE

FLAT = np.full((*SHAPE, 3), 100, dtype=np.float32)


def lut_file(path, bins=90):
    """A table as its package writes it: linear in the differences, at the bins' centres, indexed b, g, r."""
    at = (np.arange(bins) + 0.5) * 180 / bins - 90
    blue, green, red = np.meshgrid(at, at, at, indexing="ij")
    table = np.stack([0.004 * red - 0.002 * blue + 0.1, 0.003 * green + 0.001 * blue - 0.2], axis=-1)
    np.save(path, table)
    return path


def test_an_imported_table_answers_with_its_own_gain(tmp_path):
    rng = np.random.default_rng(0)
    background = rng.uniform(60, 160, (*SHAPE, 3)).astype(np.float32)
    image = np.clip(background + rng.uniform(-20, 20, background.shape), 0, 255).astype(np.float32)
    path = lut_file(tmp_path / "table_smooth.npy", bins=30)
    model = read_lut(path, background)
    found, sigma = model.prepare(background, SHAPE).gradients_from_color(
        (image - background) / np.float32(255)
    )
    gain = 1 + 2 * ((background + 1).mean() / (background + 1) - 1)
    red, green, blue = np.moveaxis((image - background) * gain, -1, 0)
    wanted = np.stack([0.004 * red - 0.002 * blue, 0.003 * green + 0.001 * blue], axis=-1)
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert sigma is None
    flipped = read_lut(path, background, depth_sign=-1)
    turned = flipped.prepare(background, SHAPE).gradients_from_color((image - background) / np.float32(255))[
        0
    ]
    np.testing.assert_allclose(turned, -found, atol=1e-5)
    rows, columns = np.array([3, 20]), np.array([50, 1])
    change = ((image - background) / 255)[rows, columns]
    np.testing.assert_allclose(model.gradients_at(change, columns, rows), found[rows, columns], atol=1e-5)
    again = LookupModel.from_arrays(*model.to_arrays())
    change = ((image - background) / np.float32(255)).astype(np.float32)
    np.testing.assert_array_equal(again.prepare(background, SHAPE).gradients_from_color(change)[0], found)


def test_the_blur_of_imported_tables_is_as_wide_as_theirs(tmp_path):
    calibration = gelform.import_calibration(
        lut_file(tmp_path / "table.npy", bins=8), "lut", background=np.full((*SHAPE, 3), 100, np.uint8)
    )
    spot = np.zeros(SHAPE, dtype=np.float32)
    spot[20, 30] = 1
    theirs = cv2.GaussianBlur(spot, (3, 3), 0)
    ours = cv2.GaussianBlur(spot, (0, 0), calibration.change.blur_px)
    x = np.arange(SHAPE[1]) - 30.0
    assert np.sum(ours * x**2) == pytest.approx(np.sum(theirs * x**2), rel=0.06)


def test_other_tables_are_refused(tmp_path):
    path = tmp_path / "table.npy"
    with pytest.raises(gelform.DataError, match="No file"):
        read_lut(path, FLAT)
    for array, why in (
        (np.zeros((5, 5, 5, 3)), "shape"),
        (np.zeros((5, 5, 6, 2)), "shape"),
        (np.full((5, 5, 5, 2), np.nan), "finite"),
        (np.array([object()]), "no array file"),
    ):
        np.save(path, array)
        with pytest.raises(gelform.DataError, match=why):
            read_lut(path, FLAT)
    with pytest.raises(ValueError, match="depth_sign"):
        read_lut(path, FLAT, depth_sign=2)
