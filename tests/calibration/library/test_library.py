"""The shipped calibration: it loads, and agrees with the simulated truth.

The library of calibrations: where it is, its names, several who add at once, damaged files.

Which calibration of the library a camera, a recording or a folder of images takes.
"""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform.calibration import library as module
from gelform.calibration.library import (
    NoCalibration,
    Unit,
    add_calibration,
    choose_calibration,
    entries,
    file_name,
    kept_path,
    library_folder,
    matching,
    ready_calibration,
    remove_calibration,
    unit_of,
    unit_of_all,
    unit_of_camera,
)
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.calibration_file import load_calibration
from gelform.errors import CalibrationError, DataError, SensorError, StaleError
from gelform.image.view import Frame
from gelform.reconstruct import Reconstructor
from gelform.sensors import cameras as plugged_in
from gelform.sensors.cameras import Camera
from gelform.sensors.grabber import Grabber
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.record import attachments_of
from gelform.sensors.simulated import simulated_sensor_named
from gelform.simulate import Ball, simulate_press
from made.small_gel import Touch, calibration, image_of, save


def test_the_one_shipped_is_right():
    sensor = simulated_sensor_named("three-edges")
    calibration = ready_calibration(sensor)
    press = simulate_press(
        sensor, Ball(2.5), depth_mm=0.5, center_mm=(3.0, 2.0), rng=np.random.default_rng(5), oversample=1
    )
    found = Reconstructor(calibration).from_image(press.image)
    assert np.sqrt(np.mean((found.depth_mm - press.depth_mm) ** 2)) < 0.012
    assert found.peak_mm == pytest.approx(press.depth_mm.max(), rel=0.06)
    assert not found.health


def test_another_sensors_is_made_once_and_kept(monkeypatch, tmp_path, sensor, simulated, calibration):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []
    monkeypatch.setattr(module, "simulated_presses", lambda *_, **__: simulated)
    monkeypatch.setattr("gelform.calibration.fit.calibrate", lambda *_, **__: made.append(1) or calibration)
    assert ready_calibration(sensor).digest == calibration.digest
    assert ready_calibration(sensor).digest == calibration.digest
    assert len(made) == 1
    kept_path(sensor).write_bytes(b"damaged")
    assert ready_calibration(sensor).digest == calibration.digest
    assert len(made) == 2
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert kept_path(sensor) is None, "a cache that cannot be written does no harm"


def test_presses_are_what_a_folder_would_give(simulated, presses):
    made = presses_from_simulated(simulated)
    assert [one.digest for one in made.presses] == [one.digest for one in presses.presses]
    assert made.mm_per_px == presses.mm_per_px


OLD = replace(calibration(), serial="S1", gel_id="gel/1", created_utc="2026-01-02T03:04:05+00:00")
NEW = replace(OLD, gel_id="2", created_utc="2026-11-12T13:14:15+00:00")


def test_a_variable_names_another_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path))
    assert library_folder() == tmp_path
    monkeypatch.delenv("GELFORM_CALIBRATIONS")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert library_folder().parts[-2:] == ("gelform", "calibrations")


@pytest.mark.skipif(sys.platform != "linux", reason="a home of Linux")
@pytest.mark.parametrize(
    ("given", "home", "said"),
    [
        ("relative", "/home", "an absolute path in GELFORM_CALIBRATIONS, got relative"),
        ("~/here", "relative", "an absolute path"),
        ("~nobody-of-that-name/here", "relative", "an absolute path"),
        ("", "relative", "a home folder"),
        ("", None, "a home folder .* Name a folder in GELFORM_CALIBRATIONS"),
    ],
)
def test_a_home_or_a_name_that_is_no_absolute_path_is_refused(monkeypatch, given, home, said):
    for name in ("XDG_DATA_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    if home is not None:
        monkeypatch.setenv("HOME", home)
    monkeypatch.setenv("GELFORM_CALIBRATIONS", given)
    monkeypatch.setattr("pwd.getpwuid", lambda _: {}["no entry"])
    with pytest.raises(DataError, match=f"Expected {said}"):
        library_folder()


def test_names_are_readable_and_no_two_alike(library):
    path, new = add_calibration(OLD)
    assert new
    assert path.parent == library
    assert path.name == f"known-gel_S1_gel-1_20260102T0304_{OLD.digest[:10]}.npz"
    assert file_name(replace(OLD, serial=None, gel_id=None)).startswith("known-gel_no-serial_no-gel_")
    assert file_name(replace(OLD, serial="../" * 99)).count("/") == 0
    assert load_calibration(path).digest == OLD.digest


def test_the_newest_comes_first_and_the_same_is_one(library):
    for one in (NEW, OLD):
        add_calibration(one)
    again, new = add_calibration(load_calibration(entries()[1].path))
    assert (again, new) == (entries()[1].path, False)
    assert [entry.gel_id for entry in entries()] == ["2", "gel/1"]
    os.rename(again, library / "mine.npz")  # a name of one's own
    assert add_calibration(OLD) == (library / "mine.npz", False)
    assert len(entries()) == 2
    assert entries()[0].held_out == NEW.held_out


def test_a_damaged_file_is_listed_stays_and_is_in_nobody_s_way(library):
    path, _ = add_calibration(OLD)
    path.write_bytes(path.read_bytes()[:500])
    (library / "text.npz").write_text("no archive")
    (damaged,) = [entry for entry in entries() if entry.path == path]
    assert "truncated or damaged" in damaged.problem
    second, new = add_calibration(OLD)
    assert new
    assert second.name == path.stem + "_2.npz"
    assert path.stat().st_size == 500
    assert [bool(entry.problem) for entry in entries()] == [False, True, True]


def test_entries_are_found_by_serial_gel_name_and_digest(library):
    for one in (OLD, NEW):
        add_calibration(one)
    assert [entry.gel_id for entry in matching("S1")] == ["2", "gel/1"]
    (entry,) = matching("S1", "gel/1")
    assert matching(entry.path.name) == matching(OLD.digest[:6]) == [entry]
    for word, gel in (("S2", None), ("S1", "3"), (OLD.digest[:3], None)):
        with pytest.raises(DataError, match="There: known-gel_S1_2"):
            matching(word, gel)
    remove_calibration(entry)
    assert [one.gel_id for one in entries()] == ["2"]


@pytest.mark.slow
def test_two_processes_add_at_once(library):
    program = (
        "import sys, time\nfrom dataclasses import replace\nfrom made.small_gel import calibration\n"
        "from gelform.calibration.library import add_calibration\n"
        "time.sleep(max(0, float(sys.argv[1]) - time.time()))\n"
        "for k in range(20): add_calibration(replace(calibration(), serial=f'S{k}'))"
    )
    start = str(time.time() + 3)
    paths = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "PYTHONPATH": paths}
    both = [subprocess.Popen([sys.executable, "-c", program, start], env=env) for _ in range(2)]
    assert [one.wait() for one in both] == [0, 0]
    assert sorted(entry.serial for entry in entries()) == sorted(f"S{k}" for k in range(20))
    assert not [path for path in library.iterdir() if path.suffix != ".npz"]


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="Cannot make the folder"):
        add_calibration(OLD, tmp_path / "file" / "library")
    assert entries(tmp_path / "nowhere") == []


OTHER = replace(OLD, serial="S2", created_utc="2026-11-13T13:14:15+00:00")
NAMELESS = replace(OLD, serial=None, sensor_name="DIGIT", created_utc="2026-11-14T13:14:15+00:00")
DIGIT = Camera("DIGIT", "/dev/video0", kind="digit")


@pytest.fixture
def full(library):
    """A library of four calibrations, and a damaged one."""
    for one in (OLD, NEW, OTHER, NAMELESS):
        add_calibration(one)
    (library / "a.npz").write_text("damaged")
    return library


def test_the_newest_of_the_serial_is_taken_and_said(full):
    choice = choose_calibration(Unit("camera X", "S1"))
    assert choice.calibration.digest == NEW.digest
    assert choice.said == f"Calibration of camera X: {choice.path.name} (gel 2, of 2026-11-12 13:14)."
    assert choose_calibration(Unit("camera X", "S1", gel_id="gel/1")).calibration.digest == OLD.digest
    in_use = Unit("a recording", "S1", digest=OLD.digest)
    assert choose_calibration(in_use).calibration.digest == OLD.digest


def test_no_match_says_what_to_do(full):
    for unit, said in (
        (Unit("camera X", "S9"), "none with serial S9: it has calibrations of S1, S2; 1 cannot be read"),
        (Unit("frame.png"), "nothing says which unit"),
        (Unit("camera Y", "", ("Y",)), "none with no serial, of a sensor Y"),
        (Unit("camera", "s1"), "The serial 'S1' differs from 's1' in capitals"),
    ):
        with pytest.raises(CalibrationError, match="gelform calibrations add") as problem:
            choose_calibration(unit)
        assert said in str(problem.value)
    with pytest.raises(DataError, match=r"The serial 'S1' differs from 's1' in capitals"):
        matching("s1")


def test_a_camera_without_a_serial_is_known_by_its_name_where_it_is_alone(full):
    of_another_unit = replace(NAMELESS, serial="D9", created_utc="2026-12-01T00:00:00+00:00")
    add_calibration(of_another_unit)
    alone = unit_of_camera(DIGIT, [DIGIT, Camera("Webcam", "/dev/video2")])
    assert choose_calibration(alone).calibration.digest == NAMELESS.digest
    two = unit_of_camera(DIGIT, [DIGIT, Camera("DIGIT", "/dev/video4", "D9", kind="digit")])
    with pytest.raises(CalibrationError, match="one of 2 of that name"):
        choose_calibration(two)
    assert unit_of_camera(replace(DIGIT, serial="S1"), []).serial == "S1"


def test_cameras_are_asked_without_being_opened(full, monkeypatch):
    for one in (plugged_in, module):
        monkeypatch.setattr(one, "cameras_there", lambda: [replace(DIGIT, serial="S1")])
    assert unit_of("digit").serial == unit_of("S1").serial == unit_of("").serial == "S1"
    for nowhere in ("S7", "S" * 5000, "/dev/" + "S" * 5000):
        with pytest.raises(SensorError, match=f"No camera '{nowhere[:6]}"):
            unit_of(nowhere)


def test_simulated_sensors_and_open_sources_say_their_serial():
    assert unit_of("simulated").serial == unit_of("simulated:three-edges").serial == "simulated-three-edges"
    source = gelform.open_source("simulated")
    with source:
        assert unit_of(source).serial == "simulated-three-edges"
    with Grabber("simulated") as grabber:
        assert unit_of(grabber).serial == "simulated-three-edges"
    assert unit_of(lambda: gelform.open_source("simulated")).serial == "simulated-three-edges"
    assert unit_of("http://127.0.0.1:9/a").serial == ""
    with pytest.raises(DataError, match="three-edges"):
        unit_of("simulated:three-edge")


def test_recordings_say_their_camera_and_the_calibration_in_use(full, tmp_path):
    def recorded(name, facts, attached):
        recording = McapRecording(tmp_path / name, facts, attached)
        recording.write(Frame(image_of(Touch()), 0.0, 10**18, 0))
        recording.close()
        return tmp_path / name

    simulated = recorded("s.mcap", RecordingFacts("sim", "simulated-three-edges", {}, 50.0, ""), None)
    assert unit_of(simulated).simulated.name == "three-edges"
    assert choose_calibration(unit_of(simulated)).calibration.sensor_name == "three-edges"
    for serial in ("simulated-none", "simulated", "S1"):
        other = recorded(f"{serial}.mcap", RecordingFacts("sim", serial, {}, 50.0, ""), None)
        assert unit_of(other).simulated is None
    path = recorded("1.mcap", RecordingFacts("ring", "S1", {}, 50.0, OLD.digest), None)
    assert choose_calibration(unit_of(path)).calibration.digest == OLD.digest
    path = recorded("2.mcap", RecordingFacts("ring"), attachments_of(OTHER))
    choice = choose_calibration(unit_of(path))
    assert choice.calibration.digest == OTHER.digest
    assert "its own, gel gel/1, of 2026-11-13 13:14" in choice.said


def test_images_are_of_the_sensor_that_their_folder_names(full, tmp_path):
    for number in (1, 2):
        save(tmp_path / f"{number}/images/a.png", image_of(Touch()))
        (tmp_path / f"{number}/sensor.toml").write_text(
            f'name = "known gel"\nmm_per_px = 0.1\nserial = "S{number}"\ngel_id = "gel/1"\n'
        )
    first, second = (tmp_path / f"{number}/images/a.png" for number in (1, 2))
    assert choose_calibration(unit_of_all([first])).calibration.digest == OLD.digest
    assert unit_of_all([first, tmp_path / "1"]).serial == "S1"
    with pytest.raises(DataError, match=r"S1, gel gel/1.* and .*S2, gel gel/1"):
        unit_of_all([first, second])
    save(tmp_path / "3/lone/a.png", image_of(Touch()))
    assert unit_of_all([tmp_path / "3/lone/a.png"]).serial == ""


def test_the_simulated_sensor_has_its_own_unless_the_library_has_one_or_a_starter_is_wanted(full):
    own = ready_calibration(gelform.open_source("simulated").sensor)
    with gelform.stream("simulated") as stream:
        assert stream.calibration.digest == own.digest
    with gelform.stream("simulated", sensor="simulated-three-edges") as stream, pytest.raises(StaleError):
        assert stream.calibration, "a starter waits for the gel at rest"
    unit = unit_of("simulated")
    with pytest.raises(NoCalibration, match="serial simulated-three-edges"):
        choose_calibration(unit, ready=False)
    add_calibration(replace(OLD, serial=unit.serial))
    assert choose_calibration(unit).calibration.digest == OLD.digest
