"""Which calibration of the library a camera, a recording or a folder of images takes."""

from dataclasses import replace

import pytest

import gelform
from gelform.calibration.library import choose
from gelform.calibration.library.choose import (
    NoCalibration,
    Unit,
    choose_calibration,
    unit_of,
    unit_of_all,
    unit_of_camera,
)
from gelform.calibration.library.library import add_calibration, matching
from gelform.calibration.library.simulated import ready_calibration
from gelform.errors import CalibrationError, DataError, SensorError, StaleError
from gelform.image.frame import Frame
from gelform.sensors.cameras import camera as plugged_in
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.grabber import Grabber
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.sensors.recordings.record import attachments_of
from made.small_gel import Touch, calibration, image_of, save
from made.sources import ImageSource

OLD = replace(calibration(), serial="S1", gel_id="1", created_utc="2026-01-02T03:04:05+00:00")
NEW = replace(OLD, gel_id="2", created_utc="2026-11-12T13:14:15+00:00")
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
    assert choose_calibration(Unit("camera X", "S1", gel_id="1")).calibration.digest == OLD.digest
    in_use = Unit("a recording", "S1", digest=OLD.digest)
    assert choose_calibration(in_use).calibration.digest == OLD.digest


def test_no_match_says_what_to_do(full):
    for unit, said in (
        (Unit("camera X", "S9"), "none with serial S9: it has calibrations of S1, S2; 1 cannot be read"),
        (Unit("frame.png"), "nothing says which unit"),
        (Unit("camera Y", "", ("Y",)), "none with no serial, of a sensor Y"),
    ):
        with pytest.raises(CalibrationError, match="gelform calibrations add") as problem:
            choose_calibration(unit)
        assert said in str(problem.value)


def test_a_serial_that_only_looks_alike_is_named(full):
    with pytest.raises(CalibrationError, match=r"The serial 'S1' differs from 's1' in capitals"):
        choose_calibration(Unit("camera", "s1"))
    with pytest.raises(DataError, match=r"The serial 'S1' differs from 's1' in capitals"):
        matching("s1")


def test_a_camera_without_a_serial_is_known_by_its_name_where_it_is_alone(full):
    add_calibration(
        replace(NAMELESS, serial="D9", created_utc="2026-12-01T00:00:00+00:00")
    )  # of another unit
    alone = unit_of_camera(DIGIT, [DIGIT, Camera("Webcam", "/dev/video2")])
    assert choose_calibration(alone).calibration.digest == NAMELESS.digest
    two = unit_of_camera(DIGIT, [DIGIT, Camera("DIGIT", "/dev/video4", "D9", kind="digit")])
    with pytest.raises(CalibrationError, match="one of 2 of that name"):
        choose_calibration(two)
    assert unit_of_camera(replace(DIGIT, serial="S1"), []).serial == "S1"


def test_cameras_are_asked_without_being_opened(full, monkeypatch):
    for module in (plugged_in, choose):
        monkeypatch.setattr(module, "cameras_there", lambda: [replace(DIGIT, serial="S1")])
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
    assert "its own, gel 1, of 2026-11-13 13:14" in choice.said


def test_images_are_of_the_sensor_that_their_folder_names(full, tmp_path):
    for number in (1, 2):
        save(tmp_path / f"{number}/images/a.png", image_of(Touch()))
        (tmp_path / f"{number}/sensor.toml").write_text(
            f'name = "known gel"\nmm_per_px = 0.1\nserial = "S{number}"\ngel_id = "1"\n'
        )
    first, second = (tmp_path / f"{number}/images/a.png" for number in (1, 2))
    assert choose_calibration(unit_of_all([first])).calibration.digest == OLD.digest
    assert unit_of_all([first, tmp_path / "1"]).serial == "S1"
    with pytest.raises(DataError, match=r"S1, gel 1.* and .*S2, gel 1"):
        unit_of_all([first, second])
    save(tmp_path / "3/lone/a.png", image_of(Touch()))
    assert unit_of_all([tmp_path / "3/lone/a.png"]).serial == ""


def test_a_stream_takes_it_where_none_is_given(full):
    source = ImageSource([image_of(Touch())] * 3)
    source.serial = "S1"
    with gelform.stream(source) as stream:
        assert stream.calibration.digest == NEW.digest
        assert next(iter(stream)).calibration_digest == NEW.digest
    source.serial = "S9"
    with pytest.raises(CalibrationError, match="serial S9"):
        gelform.stream(source)


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
