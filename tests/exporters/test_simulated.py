"""Simulated presses as files, one and sets: the same bytes whatever the number of workers, read like real ones."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.calibration.presses.folder import read_presses
from gelform.errors import DataError
from gelform.exporters import save_simulated_press
from gelform.exporters.simulated import SetOfPresses, save_simulated_set
from gelform.sensors import read_sensor_toml, sensor_from_settings
from gelform.simulate import LAYOUTS, Coating, Coin, Twin, simulate_ball_presses, simulate_press

SENSOR = replace(
    LAYOUTS["three-edges"],
    shape=(60, 80),
    mm_per_px=0.2,
    coating=Coating(marker_pitch_mm=3.0, dust=2),
    cast_shadows=True,
)
SET = SetOfPresses(SENSOR, (6.0, 9.0), count=5, seed=11)


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


def content(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.mark.slow
def test_one_worker_and_two_write_the_same_bytes(tmp_path):
    one = content(save_simulated_set(tmp_path / "one", SET))
    two = content(save_simulated_set(tmp_path / "two", SET, workers=2))
    assert len(one) == 4 + 2 * 5
    assert one == two
    other = content(save_simulated_set(tmp_path / "other", replace(SET, seed=12)))
    assert other["images/0000.png"] != one["images/0000.png"]


def test_a_set_is_what_simulate_ball_presses_makes_and_is_read_like_a_real_one(tmp_path):
    presses = read_presses(save_simulated_set(tmp_path / "set", SET))
    made = simulate_ball_presses(SENSOR, ball_diameters_mm=[6.0, 9.0], count=5, rng=np.random.default_rng(11))
    assert len(presses.presses) == 5
    for read, press in zip(presses.presses, made.presses):
        np.testing.assert_array_equal(read.image, press.image)
        assert read.label == pytest.approx((*press.center_px, press.contact_radius_px), abs=1e-3)


def test_the_parameters_make_the_set_again(tmp_path):
    folder = save_simulated_set(tmp_path / "set", SET)
    said = json.loads((folder / "parameters.json").read_text())
    again = SetOfPresses(
        sensor_from_settings(said["sensor"]), tuple(said["ball_diameters_mm"]), said["count"], said["seed"]
    )
    assert again == SET
    with np.load(folder / "truth/0003.npz") as truth:
        press = again.press(3)
        np.testing.assert_array_equal(truth["contact"], press.contact)
        np.testing.assert_array_equal(truth["markers_px"], press.markers_px)
        for name in ("albedo", "shadowed", "saturated", "markers_shift_mm"):
            np.testing.assert_array_equal(truth[name], getattr(press, name))
        meta = json.loads(str(truth["meta"]))
    assert meta["depth_mm"] == press.press_depth_mm
    assert (meta["number"], meta["seed"]) == (3, 11)
    assert meta["tilt_deg"] == [0, 0]


def test_progress_is_reported(tmp_path):
    calls = []
    save_simulated_set(tmp_path / "set", replace(SET, count=2), progress=lambda *call: calls.append(call))
    assert calls == [(1, 2, "simulating"), (2, 2, "simulating")]


def test_a_folder_with_content_is_refused_and_a_failure_leaves_nothing(tmp_path):
    (tmp_path / "full").mkdir()
    (tmp_path / "full/mine.txt").write_text("mine")
    with pytest.raises(DataError, match="holds something"):
        save_simulated_set(tmp_path / "full", SET)
    with pytest.raises(DataError, match="holds something"):
        save_simulated_press(tmp_path / "full", SENSOR, Coin(), depth_mm=0.3)
    deep = replace(SET, ball_diameters_mm=(60.0,))
    with pytest.raises(ValueError, match="gel's thickness"):
        save_simulated_set(tmp_path / "deep", deep)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["full"]


def test_bad_sets_are_refused():
    for change, message in (
        ({"count": 0}, "count >= 1"),
        ({"ball_diameters_mm": ()}, "a ball"),
        ({"seed": -1}, "seed >= 0"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(SET, **change)
