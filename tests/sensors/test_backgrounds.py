"""The untouched image from files: a folder of frames stands wherever background.png does."""

import shutil

import numpy as np
import pytest

import gelform
from gelform.errors import DataError
from gelform.plots.canvas import save_picture
from gelform.sensors.backgrounds import averaged_background, read_background
from gelform.simulate import simulate_background


@pytest.fixture
def rests(sensor, tmp_path):
    """Five untouched frames in a folder."""
    rng = np.random.default_rng(8)
    images = [simulate_background(sensor, rng) for _ in range(5)]
    (tmp_path / "background").mkdir()
    for k, image in enumerate(images):
        save_picture(tmp_path / "background" / f"{k}.png", image)
    return tmp_path / "background"


def test_one_image_is_itself(rests):
    image = read_background(rests / "0.png")
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, gelform.read_image(rests / "0.png"))


def test_a_folder_is_averaged(rests):
    images = [gelform.read_image(path) for path in sorted(rests.iterdir())]
    found = averaged_background(rests)
    np.testing.assert_array_equal(read_background(rests), found.background)
    np.testing.assert_array_equal(read_background(sorted(rests.iterdir())), found.background)
    one = np.std(images[0].astype(float) - np.mean(images[1:], axis=0))
    assert found.noise.mean() == pytest.approx(one / np.sqrt(1 + 1 / 4), rel=0.1)


def test_a_press_folder_may_hold_a_folder_of_backgrounds(folder, rests, tmp_path):
    again = tmp_path / "presses"
    shutil.copytree(folder, again)
    (again / "background.png").unlink()
    shutil.copytree(rests, again / "background")
    presses = gelform.read_presses(again)
    np.testing.assert_array_equal(presses.background, read_background(rests))
    assert len(presses.presses) == len(gelform.read_presses(folder).presses)
    named = gelform.read_presses(folder, background=rests)
    np.testing.assert_array_equal(named.background, presses.background)


def test_what_is_no_background_is_refused(rests, tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="empty, got none"):
        read_background(tmp_path / "empty")
    save_picture(rests / "9.png", np.zeros((20, 30, 3), dtype=np.uint8))
    with pytest.raises(DataError, match=r"untouched gel in .*20x30"):
        read_background(rests)
