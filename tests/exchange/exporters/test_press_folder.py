"""Folders of presses are complete or absent, have the same bytes for any number of workers, and read back like real ones.

A press that moves is the same frames in each form, and its table has the true poses.
"""

import csv
import json
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import tomlkit

import gelform
from gelform import DataError, read_presses
from gelform.batch.inputs import frames_of_part, listing_of, plan_of
from gelform.exchange.exporters.press_folder import (
    SetOfPresses,
    check_forms,
    save_moving_press,
    save_press_folder,
    save_simulated_press,
    save_simulated_presses,
    save_simulated_set,
    toml_of_settings,
    write_csv,
    write_png,
    written_whole,
)
from gelform.image.view import View
from gelform.sensors import read_sensor_toml, sensor_from_settings
from gelform.sensors.files import SensorSettings
from gelform.simulate import LAYOUTS, Coating, Coin, Twin, simulate_ball_presses, simulate_press
from made.sources import SMALL


def test_a_folder_that_holds_something_or_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for folder, said in ((tmp_path, "new or empty folder"), (tmp_path / "mine.txt" / "out", "Cannot write")):
        with pytest.raises(DataError, match=said), written_whole(folder):
            pass
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]


def test_names_like_formulas_come_back_from_the_table(tmp_path):
    names = ["=1+1.png", "-3.png", "'=x.png", "plain.png"]
    write_csv(tmp_path / "presses.csv", [{"image": name, "ball_diameter_mm": "4"} for name in names])
    text = (tmp_path / "presses.csv").read_text()
    assert text.splitlines()[1:4] == ["'=1+1.png,4", "'-3.png,4", "''=x.png,4"]
    for name in ("background.png", *names):
        write_png(tmp_path / name, np.full((30, 40, 3), 90 + len(name), np.uint8))
    (tmp_path / "sensor.toml").write_text(toml_of_settings(SensorSettings("s", 0.1)))
    assert [press.name for press in read_presses(tmp_path).presses] == names


def test_a_failure_leaves_nothing_and_success_the_whole(tmp_path):
    def fail_halfway():
        with written_whole(tmp_path / "out") as partial:
            (partial / "first").write_text("1")
            raise RuntimeError("halfway")

    with pytest.raises(RuntimeError, match="halfway"):
        fail_halfway()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "out").mkdir()  # an empty one may be there
    with written_whole(tmp_path / "out") as partial:
        (partial / "first").write_text("1")
        assert not (tmp_path / "out/first").exists()
    assert [p.name for p in tmp_path.iterdir()] == ["out"]
    assert (tmp_path / "out/first").read_text() == "1"


def test_images_are_rgb_and_rounded_tables_have_a_header_and_names_are_any(tmp_path):
    image = np.zeros((3, 4, 3))
    image[..., 0] = 200.6
    write_png(tmp_path / "a.png", image)
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.png"))[..., ::-1], np.rint(image))
    with pytest.raises(ValueError, match=r"a\.png"):
        write_png(tmp_path / "a.png", image, (4, 4))
    write_csv(tmp_path / "t.csv", [{"a": "1", "b": "2"}, {"a": "3", "b": "4"}])
    assert (tmp_path / "t.csv").read_text() == "a,b\n1,2\n3,4\n"
    name = 'a "quoted" \\ name\nin two lines'
    for serial in ({}, {"serial": "D\\20"}):
        said = tomlkit.loads(toml_of_settings(SensorSettings(name, 0.3, **serial)))
        assert said == {"name": name, "mm_per_px": 0.3, **serial}
    unit = {"mm_per_px_sigma": 0.01, "make": "digit", "serial": "D20", "gel_id": "g"}
    whole = SensorSettings("G", 0.3, **unit, view=View((30, 40), flip="x"), camera={"exposure": 50.0})
    (tmp_path / "sensor.toml").write_text(toml_of_settings(whole))
    assert read_sensor_toml(tmp_path / "sensor.toml") == whole


QUOTED = replace(SMALL, name='a "quoted" name')
ARGUMENTS = {
    "background": np.zeros((8, 9, 3), np.uint8),
    "images": [np.zeros((8, 9, 3), np.uint8)],
    "ball_diameters_mm": [4.0],
    "mm_per_px": 0.1,
    "name": "x",
}


@pytest.fixture(scope="module")
def quoted():
    how = {"count": 3, "rng": np.random.default_rng(0), "oversample": 1}
    return simulate_ball_presses(QUOTED, ball_diameters_mm=[6.31], **how)


def test_what_is_written_is_what_was_simulated(tmp_path, quoted):
    folder = save_simulated_presses(tmp_path / "deep" / "presses", quoted)
    there = {path.name for path in folder.iterdir()}
    assert there == {"background.png", "images", "presses.csv", "sensor.toml", "truth"}
    rows = list(csv.DictReader((folder / "presses.csv").open()))
    assert len(rows) == 3
    for row, press in zip(rows, quoted.presses):
        np.testing.assert_array_equal(gelform.read_image(folder / row["image"]), press.image)
        assert float(row["ball_diameter_mm"]) == 6.31
        circle = [float(row[name]) for name in ("center_x_px", "center_y_px", "contact_radius_px")]
        assert circle == pytest.approx([*press.center_px, press.contact_radius_px], abs=1e-4)
    truth = np.load(folder / "truth" / "0002.npz")
    np.testing.assert_array_equal(truth["depth_mm"], quoted.presses[2].depth_mm.astype(np.float32))
    np.testing.assert_array_equal(truth["contact"], quoted.presses[2].contact)
    assert tomlkit.loads((folder / "sensor.toml").read_text()) == {"name": QUOTED.name, "mm_per_px": 0.3}
    np.testing.assert_array_equal(gelform.read_image(folder / "background.png"), quoted.background)


def test_bad_lists_are_refused_and_nothing_is_left(tmp_path):
    two = [*ARGUMENTS["images"], np.zeros((3, 3, 3), np.uint8)]
    for change, error, message in [
        ({"images": []}, ValueError, "at least one image"),
        ({"ball_diameters_mm": [4.0, 5.0]}, ValueError, "1 ball_diameters_mm"),
        ({"ball_diameters_mm": [0.0]}, ValueError, "ball_diameter_mm > 0"),
        ({"mm_per_px": 0}, ValueError, "mm_per_px > 0"),
        ({"truths": []}, ValueError, "1 truths"),
        ({"centers_px": [3]}, TypeError, "each of centers_px as a list, got int"),
        ({"images": two, "ball_diameters_mm": [4.0, 4.0]}, ValueError, r"0001\.png"),  # halfway
    ]:
        with pytest.raises(error, match=message):
            save_press_folder(tmp_path / "out", **ARGUMENTS | change)
        assert list(tmp_path.iterdir()) == []


COATING = Coating(marker_pitch_mm=3.0, dust=2)
SENSOR = replace(LAYOUTS["three-edges"], shape=(60, 80), mm_per_px=0.2, coating=COATING, cast_shadows=True)
SET = SetOfPresses(SENSOR, (6.0, 9.0), count=5, seed=11)


def test_a_press_is_written_with_its_truth_and_parameters(tmp_path):
    folder = save_simulated_press(tmp_path / "coin", SENSOR, Coin(), depth_mm=0.3, seed=4)
    press = simulate_press(SENSOR, Coin(), depth_mm=0.3, rng=np.random.default_rng(4))
    np.testing.assert_array_equal(gelform.read_image(folder / "image.png"), press.image)
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
    np.testing.assert_array_equal(gelform.read_image(folder / "background.png"), twin.background)
    assert json.loads((folder / "parameters.json").read_text())["like"] == calibration.sensor_name


def content(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


@pytest.mark.slow
def test_one_worker_and_two_write_the_same_bytes(tmp_path):
    one = content(save_simulated_set(tmp_path / "one", SET))
    two = content(save_simulated_set(tmp_path / "two", SET, workers=2))
    assert len(one) == 4 + 2 * 5
    assert one == two
    other = content(save_simulated_set(tmp_path / "other", replace(SET, seed=12)))
    assert other["images/0000.png"] != one["images/0000.png"]


def test_a_set_is_what_simulate_ball_presses_makes_and_is_read_like_a_real_one(tmp_path):
    calls = []
    presses = read_presses(save_simulated_set(tmp_path / "set", SET, progress=lambda *one: calls.append(one)))
    assert calls == [(k, 5, "simulating") for k in range(1, 6)]
    made = simulate_ball_presses(SENSOR, ball_diameters_mm=[6.0, 9.0], count=5, rng=np.random.default_rng(11))
    assert len(presses.presses) == 5
    for read, press in zip(presses.presses, made.presses):
        np.testing.assert_array_equal(read.image, press.image)
        assert read.label == pytest.approx((*press.center_px, press.contact_radius_px), abs=1e-3)


def test_sets_that_cannot_be_are_refused_and_an_interrupted_one_leaves_nothing(tmp_path):
    for change, message in (
        ({"count": 0}, "count >= 1"),
        ({"ball_diameters_mm": ()}, "a ball"),
        ({"seed": -1}, "seed >= 0"),
        ({"ball_diameters_mm": (60.0,)}, r"to 18\.5 mm, got 60"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(SET, **change)

    def interrupted(done, total, what):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_simulated_set(tmp_path / "half", SET, progress=interrupted)
    assert list(tmp_path.iterdir()) == []


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


@pytest.mark.parametrize(
    ("form", "name", "dataset"),
    [
        ("video", "moving.avi", ""),
        ("mcap", "moving.mcap", ""),
        ("hdf5", "moving.h5", "data/*/obs/gel"),
        ("lerobot", "lerobot", "*"),
    ],
)
def test_each_form_has_the_pixels_of_the_video(video, sensor, tmp_path, form, name, dataset):
    images = [frame.image for frame in frames_of(video / "moving.avi")]
    (part,) = plan_of(listing_of(made(tmp_path / "again", sensor, form) / name, dataset=dataset), 99)
    found = [frame for _, frame in frames_of_part(part)]
    assert np.array_equal([frame.image for frame in found], images)
    if form != "hdf5":  # which has no times
        assert [frame.time_s for frame in found] == pytest.approx(np.arange(len(images)) / 25)
    if form == "mcap":
        assert found[25].wall_time_ns - found[0].wall_time_ns == 10**9
    assert part.film.rate_hz == (25 if form == "lerobot" else 0)


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
