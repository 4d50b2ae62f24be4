"""Image files of a calibrated sensor: an error names the file."""

import numpy as np
import pytest

from gelform.calibration_file import load_calibration
from gelform.cli.sensor_images import background_in, image_in
from gelform.errors import DataError
from gelform.exchange.plots.canvas import save_picture


@pytest.fixture
def calibration(calibration_file):
    return load_calibration(calibration_file)


def test_images_go_through_the_view(calibration, press_folder):
    path = press_folder / "images" / "0001.png"
    assert image_in(path, calibration).shape == (120, 160, 3)
    assert background_in(None, calibration) is None
    assert background_in(press_folder / "background.png", calibration).shape == (120, 160, 3)


def test_another_size_names_the_file(calibration, tmp_path):
    save_picture(tmp_path / "small.png", np.zeros((60, 80, 3), dtype=np.uint8))
    for read in (image_in, background_in):
        with pytest.raises(DataError, match=r"small\.png, for .*120x160.*60x80"):
            read(tmp_path / "small.png", calibration)
