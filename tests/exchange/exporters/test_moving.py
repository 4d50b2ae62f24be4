"""A press that moves is the same frames in each form, and its table has the true poses."""

import csv
import sys

import cv2
import numpy as np
import pytest

import gelform
from gelform.batch.inputs.containers import hdf5_sequences, hdf5_values
from gelform.batch.inputs.lerobot import lerobot_sequences, stored_images
from gelform.errors import DataError
from gelform.exchange.exporters.moving import check_forms, save_moving_press
from gelform.simulate import Coin, Twin

DEPTH_MM = 0.4
MODULES = {"mcap": ("mcap", "rosbags"), "hdf5": ("h5py",), "lerobot": ("pyarrow",)}


def made(tmp_path, look, form):
    """The folder with a coin in this form; skips the test without the form's extra."""
    for module in MODULES.get(form, ()):
        pytest.importorskip(module, reason="an extra is not installed")
    save_moving_press(tmp_path / form, look, Coin(), [form], DEPTH_MM, seed=3)
    return tmp_path / form


def frames_of(path):
    with gelform.open_source(str(path)) as source:
        return list(source)


@pytest.fixture
def video(tmp_path, sensor):
    return made(tmp_path, sensor, "video")


def test_the_table_has_the_pose_of_each_frame(video, sensor):
    frames = frames_of(video / "moving.avi")
    with (video / "motion.csv").open(newline="") as file:
        rows = [{name: float(value) for name, value in row.items()} for row in csv.DictReader(file)]
    assert [row["index"] for row in rows] == list(range(len(frames))) == list(range(36))
    assert np.diff([frame.time_s for frame in frames]) == pytest.approx(1 / sensor.timing.frame_rate_hz)
    assert [row["depth_mm"] for row in rows] == [0.0] * 6 + [DEPTH_MM] * 25 + [0.0] * 5
    assert rows[18] == pytest.approx(dict(rows[18], x_mm=0.45, y_mm=0.2, turn_deg=2))
    assert rows[30] == pytest.approx(dict(rows[30], x_mm=0.9, y_mm=0.4, turn_deg=4))
    change = [np.abs(frame.image.astype(float) - frames[0].image).mean() for frame in frames]
    assert min(change[6:31]) > 2 * max(change[:6] + change[31:])


def test_a_recording_has_the_pixels_of_the_video(video, sensor, tmp_path):
    images = [frame.image for frame in frames_of(video / "moving.avi")]
    again = made(tmp_path / "again", sensor, "video")
    assert (again / "moving.avi").read_bytes() == (video / "moving.avi").read_bytes()
    recorded = frames_of(made(tmp_path, sensor, "mcap") / "moving.mcap")
    assert np.array_equal([frame.image for frame in recorded], images)
    assert recorded[25].wall_time_ns - recorded[0].wall_time_ns == 10**9


def test_hdf5_has_the_pixels_of_the_video(video, sensor, tmp_path):
    images = [frame.image for frame in frames_of(video / "moving.avi")]
    (sequence,) = hdf5_sequences(made(tmp_path, sensor, "hdf5") / "moving.h5", "moving", "data/*/obs/gel")
    assert np.array_equal(list(hdf5_values(sequence.path, sequence.dataset, 0, sequence.count)), images)


def test_lerobot_has_the_pixels_of_the_video(video, sensor, tmp_path):
    images = [frame.image for frame in frames_of(video / "moving.avi")]
    (one,) = lerobot_sequences(made(tmp_path, sensor, "lerobot") / "lerobot", "*")
    stored = list(stored_images(one.path, one.dataset, 0, 0, one.count))
    assert one.rate_hz == 25
    assert [time_s for time_s, _ in stored] == pytest.approx(np.arange(len(images)) / 25)
    pictures = [cv2.imdecode(content, cv2.IMREAD_COLOR)[..., ::-1] for _, content in stored]
    assert np.array_equal(pictures, images)


def test_a_twin_presses_too(calibration, tmp_path):
    frames = frames_of(made(tmp_path, Twin(calibration), "video") / "moving.avi")
    assert frames[0].image.mean() == pytest.approx(calibration.background.mean(), abs=0.5)
    assert np.abs(frames[6].image.astype(float) - frames[0].image).max() > 20


@pytest.mark.parametrize(("form", "extra"), [("mcap", "mcap"), ("hdf5", "data"), ("lerobot", "data")])
def test_a_missing_extra_is_named(form, extra, monkeypatch):
    for module in MODULES[form]:
        monkeypatch.setitem(sys.modules, module, None)
        for name in ("writer", "parquet"):  # what is imported may be there already
            monkeypatch.setitem(sys.modules, f"{module}.{name}", None)
    with pytest.raises(DataError, match=rf"--as {form} needs the extra {extra}: pip install"):
        check_forms(["video", form])
