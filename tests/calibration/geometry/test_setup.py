"""Images of a gauge are seen as the presses are."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.geometry.setup import read_setup
from gelform.errors import DataError
from gelform.view import View, image_from_frame


def test_a_folder_and_its_settings_say_the_same(folder, presses):
    for place in (folder, folder / "sensor.toml"):
        setup = read_setup(place)
        np.testing.assert_array_equal(setup.background, presses.background)
        np.testing.assert_array_equal(setup.image(folder / presses.presses[0].name), presses.presses[0].image)


def test_a_folder_with_a_view(folder, tmp_path):
    view = View((132, 176), (10, 12, 100, 80), flip="x")
    (tmp_path / "background.png").write_bytes((folder / "background.png").read_bytes())
    (tmp_path / "sensor.toml").write_text(
        'name = "x"\nmm_per_px = 1\n[view]\nframe_shape = [132, 176]\ncrop = [10, 12, 100, 80]\nflip = "x"\n'
    )
    setup = read_setup(tmp_path)
    frame = gelform.read_image(tmp_path / "background.png")
    np.testing.assert_array_equal(setup.background, image_from_frame(frame, view))
    np.testing.assert_array_equal(setup.image(tmp_path / "background.png"), image_from_frame(frame, view))


def test_a_profile_gives_the_view_of_a_bare_folder(tmp_path):
    frame = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "background.png"), frame)
    assert read_setup(tmp_path, sensor="gelsight-mini").background.shape == (240, 320, 3)
    assert read_setup(tmp_path).background.shape == (480, 640, 3)


def test_a_calibration_has_both(calibration, folder, tmp_path):
    replace(calibration, report=None).save(tmp_path / "cal.npz")
    setup = read_setup(tmp_path / "cal.npz")
    np.testing.assert_array_equal(setup.background, calibration.background)
    today = read_setup(tmp_path / "cal.npz", background=folder / "background.png")
    assert today.background.shape == calibration.background.shape


def test_what_is_missing_is_said(tmp_path):
    with pytest.raises(DataError, match="which is not there"):
        read_setup(tmp_path / "nowhere")
    with pytest.raises(DataError, match="No background"):
        read_setup(tmp_path)
