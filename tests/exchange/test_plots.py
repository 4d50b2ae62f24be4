"""Common parts of pictures: their files, the extra that they need, the deepest point."""

import sys

import numpy as np
import pytest

from gelform import DataError, GelformError, read_image
from gelform.exchange.plots import canvas, deepest_px, draw_map, pixels_of, save_picture


def test_pictures_are_saved_as_they_are(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (30, 40, 3), dtype=np.uint8)
    save_picture(tmp_path / "x.png", pixels)
    assert np.array_equal(read_image(tmp_path / "x.png"), pixels)
    with pytest.raises(DataError, match="already there"):
        save_picture(tmp_path / "x.png", pixels)
    save_picture(tmp_path / "x.png", pixels, overwrite=True)


def test_without_matplotlib_the_extra_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(GelformError, match=r'pip install "gelform\[plots\]"'):
        canvas(2, 2)


def test_a_map_is_drawn_pixel_by_pixel():
    pytest.importorskip("matplotlib", reason="pictures need the extra 'plots'")
    figure = canvas(2, 2, layout=None)
    drawn_map = draw_map(figure.add_axes((0, 0, 1, 1)), [[0, 1], [1, 0]], "", cmap="gray")
    drawn = pixels_of(figure)
    assert drawn_map.get_array().shape == (2, 2)
    assert drawn.shape == (220, 220, 3)
    corners = drawn[[5, 5, -5, -5], [5, -5, 5, -5], 0]
    assert corners.tolist() == [0, 255, 255, 0]


def test_one_noisy_pixel_is_not_the_deepest_point():
    depth = np.zeros((30, 40), dtype=np.float32)
    depth[18:23, 8:13] = 1
    depth[3, 30] = 3
    assert deepest_px(depth) == (20, 10)
    depth[:, 25:] = np.nan
    assert deepest_px(depth) == (20, 10)
