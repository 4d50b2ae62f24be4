"""One press as files."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.exporters import save_simulated_press
from gelform.sensors import read_sensor_toml, sensor_from_settings
from gelform.simulate import LAYOUTS, Coin, Twin, simulate_press

SENSOR = replace(LAYOUTS["three-edges"], shape=(60, 80), mm_per_px=0.2, cast_shadows=True)


def test_a_press_is_written_with_its_truth_and_parameters(tmp_path):
    folder = save_simulated_press(tmp_path / "coin", SENSOR, Coin(), depth_mm=0.3, seed=4)
    press = simulate_press(SENSOR, Coin(), depth_mm=0.3, rng=np.random.default_rng(4))
    np.testing.assert_array_equal(cv2.imread(str(folder / "image.png"))[..., ::-1], press.image)
    with np.load(folder / "truth.npz") as truth:
        np.testing.assert_array_equal(truth["depth_mm"], press.depth_mm.astype(np.float32))
        np.testing.assert_array_equal(truth["shadowed"], press.shadowed)
        assert truth["mm_per_px"] == 0.2
        assert json.loads(str(truth["meta"]))["seed"] == 4
    said = json.loads((folder / "parameters.json").read_text())
    assert sensor_from_settings(said["sensor"]) == SENSOR
    assert read_sensor_toml(folder / "sensor.toml").mm_per_px == 0.2


def test_a_twins_press_looks_like_its_calibration(tmp_path, calibration):
    twin = Twin(calibration)
    folder = save_simulated_press(tmp_path / "twin", twin.sensor, Coin(), depth_mm=0.3, twin=twin)
    np.testing.assert_array_equal(cv2.imread(str(folder / "background.png"))[..., ::-1], twin.background)
    assert json.loads((folder / "parameters.json").read_text())["like"] == calibration.sensor_name


def test_a_full_folder_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(DataError, match="holds something"):
        save_simulated_press(tmp_path, SENSOR, Coin(), depth_mm=0.3)
