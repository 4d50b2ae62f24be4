"""The list of devices, showing one, settings of a camera.

The lists of calibrations and recordings: names are made here, and nothing else can be opened.
"""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform import CalibrationError, DataError, GelformError, SensorError, open_source
from gelform.live import actions
from gelform.live.actions import start
from gelform.live.hub import Hub
from gelform.live.lists import Calibrations, Devices, Recordings
from gelform.live.station import Setup
from gelform.live.web.client import text
from gelform.sensors.cameras import SETTABLE, Camera
from gelform.sensors.films import open_film
from gelform.sensors.simulated import SimulatedSource
from live_waiting import until
from stream.ffmpeg_camera import FfmpegCamera, why_absent

LEFT = Camera("DIGIT", "/dev/video0", "D1", by_path="usb-1")
RIGHT = Camera("DIGIT", "/dev/video2", "D2", by_path="usb-2")


class Adjustable(SimulatedSource):
    """A simulated sensor whose exposure can be set, up to 100, as a camera's."""

    def __init__(self, sensor):
        super().__init__(sensor, rate_hz=30.0)
        self.settings["exposure"] = 50.0

    def set_controls(self, settings):
        if not 0 <= settings.get("exposure", -1) <= 100:
            raise SensorError("expected exposure within 0 to 100")
        self.settings |= settings
        return self.settings


@pytest.fixture
def adjustable(sensor, show):
    hub = Hub()
    show(lambda: Adjustable(sensor), hub)
    return hub


def test_cameras_and_sources_are_listed_with_what_is_known(hub, station):
    devices = Devices(hub.stations, lambda: [LEFT, RIGHT])
    rows = until(lambda: (r := devices.facts()) and r[0]["rate_hz"] and r)
    simulated = f"simulated {station.source.sensor.name}"
    assert [row["name"] for row in rows] == [simulated, "DIGIT", "DIGIT"]
    assert [row["serial"] for row in rows] == [station.source.serial, "D1", "D2"]
    assert [row["state"] for row in rows] == ["running", "not shown", "not shown"]
    assert rows[0]["age_ms"] < 10_000
    assert rows[0]["lost"] == 0 <= rows[0]["skipped"]


@pytest.fixture
def choice(hub, station, show):
    """The hub with two cameras on its list; each is a camera of its own that serves one reader alone."""
    if why_absent() is not None:
        pytest.skip(str(why_absent()))
    with FfmpegCamera() as left, FfmpegCamera() as right:
        urls = {"D1": left.url, "D2": right.url}
        hub.devices = Devices(
            hub.stations, lambda: [LEFT, RIGHT], lambda camera, _: open_source(urls[camera.serial])
        )
        show(lambda: SimulatedSource(station.source.sensor), hub)
        yield hub


def numbers_of(hub):
    return {row["serial"]: row["camera"] for row in hub.devices.facts() if row["camera"] is not None}


def test_a_camera_of_the_list_is_shown_with_its_calibration_and_left_again(choice, station, calibration):
    name = choice.calibrations.add("of D2", replace(calibration, serial="D2"))
    actions.show_camera(choice, station, numbers_of(choice)["D2"])
    until(lambda: not station.facts()["simulated"] and station.facts()["state"] == "running")
    assert station.setup.name == name
    assert station.facts()["opened"]
    assert list(numbers_of(choice)) == ["D1"]  # the other one is not offered twice
    assert choice.notices[-1][2].endswith("shows DIGIT, with its calibration of D2.")
    actions.open_recording(choice, station, "")
    until(lambda: station.facts()["simulated"])
    assert station.setup.name == "mine"
    assert set(numbers_of(choice)) == {"D1", "D2"}
    actions.show_camera(choice, station, numbers_of(choice)["D1"])
    assert station.setup.calibration is None
    assert "none in the list has its serial" in choice.notices[-1][2]


def test_of_two_pages_that_want_one_camera_the_first_gets_it(choice):
    number, begin = numbers_of(choice)["D1"], threading.Barrier(2)

    def ask(station):
        begin.wait()
        try:
            actions.show_camera(choice, station, number)
        except GelformError as problem:
            return str(problem)
        return ""

    with ThreadPoolExecutor() as pages:
        shown, refused = sorted(pages.map(ask, choice.stations))
    assert shown == ""
    assert "already shows DIGIT" in refused


def test_a_camera_that_is_not_on_the_list_is_not_opened(hub, station):
    with pytest.raises(GelformError, match="no longer plugged in"):
        actions.show_camera(hub, station, 9)
    assert station.facts()["simulated"]


def test_a_setting_is_read_back_and_told_to_everybody_and_one_that_is_not_taken_is_not_remembered(adjustable):
    (station,) = adjustable.stations
    with pytest.raises(SensorError, match="within"):
        actions.set_camera(adjustable, station, "exposure", 1e5)
    with pytest.raises(GelformError, match="exposure, gain"):
        actions.set_camera(adjustable, station, "fps", 10.0)
    assert station.opening.wanted == {}
    actions.set_camera(adjustable, station, "exposure", 80.0)
    assert adjustable.notices[-1][2].endswith("80, read back.")
    assert station.facts()["settable"] == station.opening.wanted == {"exposure": 80.0}


def test_a_source_without_settings_says_so(hub, station):
    for name in SETTABLE:
        with pytest.raises(GelformError, match="Only a USB camera"):
            actions.set_camera(hub, station, name, 1.0)
    assert station.facts()["settable"] == {}


def test_a_camera_set_otherwise_than_calibrated_is_a_finding_of_its_results(adjustable, calibration):
    (station,) = adjustable.stations
    settings = {**calibration.settings} | {"camera": {"exposure": 50.0}}
    station.setup = Setup(replace(calibration, settings=settings), "mine")

    def said():
        result = station.newest.result
        return result and [one.message for one in result.health if one.name == "settings_mismatch"]

    until(lambda: said() == [])
    actions.set_camera(adjustable, station, "exposure", 60.0)
    (message,) = until(said)
    assert "exposure 60.0 instead of 50.0" in message


def test_a_folders_calibrations_are_offered_and_files_called_alike_keep_apart(tmp_path, calibration):
    """What cannot be read, and what is not listed, is refused."""
    mine, deep, other = (tmp_path / name for name in ("mine.npz", "deep/mine.npz", "other.npz"))
    deep.parent.mkdir()
    for path in (mine, deep):
        calibration.save(path)
    other.write_bytes(b"no calibration")
    known = Calibrations(folder=tmp_path)
    assert known.names == ["mine.npz"]
    assert known["mine.npz"].digest == calibration.digest
    assert Calibrations([mine, deep], tmp_path).names == ["mine.npz", "deep/mine.npz"]
    for name in ("", "../mine.npz", "deep/mine.npz", "/etc/passwd", "mine.npz\0"):
        with pytest.raises(GelformError, match="Choose one in the list"):
            known[name]
    with pytest.raises(CalibrationError):
        Calibrations([other])["other.npz"]


def test_what_was_made_here_gets_a_free_name(calibration):
    known, another = Calibrations(), replace(calibration, serial="S9")
    assert known.add("mine", calibration) == "mine"
    assert known.add("mine", another) == "mine (2)"
    assert known["mine (2)"] is another
    assert known.add("mine", calibration) == "mine"
    assert len(known.names) == 2
    known.put("mine", another)
    assert known["mine"] is another


def test_given_and_found_ones_are_listed_once(forms, tmp_path):
    listed = Recordings([forms["mcap"], forms["images"]], forms["mcap"].parent)
    names = [one["name"] for one in listed.facts()]
    assert names == ["a.mcap", "d", "c.avi"]
    assert listed.path("a.mcap") == forms["mcap"]
    assert [one["bytes"] for one in listed.facts()[:2]] == [forms["mcap"].stat().st_size, None]
    copy = tmp_path / "a.mcap"
    copy.write_bytes(b"")
    assert Recordings([forms["mcap"], copy]).path("a.mcap (2)") == copy


def test_folders_are_not_fetched_and_what_is_gone_is_said(forms, tmp_path):
    gone = tmp_path / "gone.mcap"
    gone.write_bytes(b"x")
    listed = Recordings([forms["images"], gone])
    gone.unlink()
    for number in (0, 1, 2, -1):
        with pytest.raises(GelformError, match="Share"):
            listed.file(number)
    assert listed.facts()[1]["bytes"] is None


def test_arrays_that_are_no_frames_are_not_listed_and_say_why_if_they_are_opened(tmp_path):
    np.save(tmp_path / "frames.npy", np.zeros((2, 4, 5, 3), np.uint8))
    np.save(tmp_path / "image.npy", np.zeros((4, 5, 3), np.uint8))
    np.save(tmp_path / "forces.npy", np.zeros((100, 6)))
    np.save(tmp_path / "objects.npy", np.array([{}]), allow_pickle=True)
    (tmp_path / "torn.npy").write_bytes(b"no array")
    hub = start([], folder=tmp_path)
    assert [one["name"] for one in hub.recordings.facts()] == ["frames.npy"]
    with pytest.raises(DataError, match=r"RGB frames in .*forces.npy"):
        open_film(tmp_path / "forces.npy")


@pytest.fixture
def odd_folder(forms, tmp_path, calibration):
    """Names that are no text or steer; links to itself, out of the folder and inside it; a pipe; a folder."""
    folder = tmp_path / "folder"
    (folder / "inner.mcap").mkdir(parents=True)
    recording = forms["mcap"].read_bytes()
    odd = (b"a\nb", b"no\xfftext", b"\xe2\x80\xaeb", b"x" * 240, b"plain")
    for name in odd:
        Path(os.fsdecode(os.fsencode(folder) + b"/" + name + b".mcap")).write_bytes(recording)
    (tmp_path / "secret.mcap").write_bytes(recording)
    calibration.save(tmp_path / "secret.npz")
    calibration.save(folder / "own.npz")
    targets = {
        "out.mcap": tmp_path / "secret.mcap",
        "out.npz": tmp_path / "secret.npz",
        "self.mcap": folder / "self.mcap",
        "self.npz": folder / "self.npz",
        "gone.mcap": folder / "none.mcap",
        "device.mcap": Path("/dev/zero"),
    }
    for name, target in targets.items():
        (folder / name).symlink_to(target)
    os.mkfifo(folder / "pipe.mcap")
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes, pipes and links")
def test_only_a_folders_own_files_are_listed_by_names_that_can_be_shown(odd_folder):
    names = [one["name"] for one in Recordings((), odd_folder).facts()]
    assert "plain.mcap" in names
    assert {r"a\nb.mcap", r"no\udcfftext.mcap", r"\u202eb.mcap"} < set(names)
    assert len(names) == 5
    for name in names:
        assert text(name) == name
        assert name.encode()
    assert Calibrations(folder=odd_folder).names == ["own.npz"]


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes, pipes and links")
def test_a_file_that_became_a_link_out_of_the_folder_is_not_opened(odd_folder, tmp_path):
    listed = Recordings((), odd_folder)
    number = [one["name"] for one in listed.facts()].index("plain.mcap")
    assert listed.path("plain.mcap") == listed.file(number) == odd_folder / "plain.mcap"
    (odd_folder / "plain.mcap").unlink()
    (odd_folder / "plain.mcap").symlink_to(tmp_path / "secret.mcap")
    with pytest.raises(GelformError, match="no recording"):
        listed.path("plain.mcap")
    with pytest.raises(GelformError, match="no such file"):
        listed.file(number)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.text(max_size=30) | st.sampled_from(["../a.mcap", "/etc/passwd", "a.mcap/..", "b/frames.csv"]))
def test_no_other_name_opens_anything(forms, name):
    listed = Recordings([forms["mcap"]])
    if name != "a.mcap":
        with pytest.raises(GelformError, match="no recording"):
            listed.path(name)
