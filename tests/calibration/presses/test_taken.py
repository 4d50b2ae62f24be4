"""A press folder that grows: what was taken is there, a miss is not taken."""

import numpy as np
import pytest

from gelform.calibration.presses.folder import read_presses
from gelform.calibration.presses.taken import TakenPresses, toml_of_settings
from gelform.errors import DataError
from gelform.image.view import View
from gelform.sensors.files import SensorSettings, read_sensor_toml

SETTINGS = SensorSettings(
    'A "gel"',
    0.2,
    0.001,
    serial="S1",
    make="digit",
    view=View((48, 64), crop=(2, 2, 60, 44)),
    camera={"exposure": 50, "fourcc": "MJPG"},
)
RNG = np.random.default_rng(0)


def frame(pressed=False):
    image = 100 + RNG.normal(0, 1.5, (48, 64, 3))
    if pressed:
        image[20:28, 30:40] += 25
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.fixture
def taken(tmp_path):
    started = TakenPresses(tmp_path / "p", SETTINGS, 6.35)
    started.take_background([frame() for _ in range(10)])
    return started


def test_calibrate_reads_what_was_taken(taken):
    presses = [frame(pressed=True) for _ in range(3)]
    for image in presses:
        taken.take_press(image)
    found = read_presses(taken.folder)
    assert [press.ball_diameter_mm for press in found.presses] == [6.35] * 3
    np.testing.assert_array_equal(found.presses[1].image, presses[1][2:46, 2:62])
    assert found.camera == SETTINGS.camera
    assert abs(found.background.mean() - 100) < 0.5


def test_a_miss_is_not_taken(taken):
    with pytest.raises(DataError, match="Nothing is pressed"):
        taken.take_press(frame())
    assert taken.count == 0
    assert list((taken.folder / "images").iterdir()) == []


def test_the_last_one_can_be_taken_out(taken):
    assert taken.drop_last() is None
    for _ in range(2):
        taken.take_press(frame(pressed=True))
    assert taken.drop_last() == "images/0001.png"
    assert len(read_presses(taken.folder).presses) == 1
    assert taken.take_press(frame(pressed=True)) == "images/0001.png"


def test_the_background_comes_first_and_a_folder_with_something_in_it_is_kept(tmp_path):
    with pytest.raises(DataError, match="background before"):
        TakenPresses(tmp_path / "p", SETTINGS, 6.0).take_press(frame(pressed=True))
    (tmp_path / "mine").write_text("x")
    with pytest.raises(DataError, match="new or empty"):
        TakenPresses(tmp_path, SETTINGS, 6.0)


def test_settings_survive_their_toml(tmp_path):
    (tmp_path / "sensor.toml").write_text(toml_of_settings(SETTINGS), encoding="utf-8")
    assert read_sensor_toml(tmp_path / "sensor.toml") == SETTINGS
