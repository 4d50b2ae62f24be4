"""The buttons of a replay on a running station: the frame that is shown is the one that was asked for."""

import numpy as np
import pytest

import gelform
from gelform.errors import GelformError
from gelform.live import actions
from gelform.live.replay import buttons
from gelform.live.replay.indexed import indexed
from gelform.live.start import Options, start
from live_waiting import until


@pytest.fixture
def replayed(hub, forms, tmp_path):
    """The hub's station on the recorded folder, held at frame 2."""
    hub.folder = tmp_path
    buttons.open_recording(hub, 0, hub.recordings.add(forms["recorded"]))
    station = hub.stations[0]
    until(lambda: station.facts()["replay"])
    buttons.play(hub, 0, False)
    buttons.seek(hub, 0, 2)
    until(lambda: number_shown(station) == 2)
    return hub


def number_shown(station):
    return getattr(station.newest.frame, "number", None)


def test_the_result_is_that_of_the_frame_alone(replayed, forms, calibration):
    """Whatever was shown before: forwards, backwards, twice."""
    station = replayed.stations[0]
    wanted = gelform.Reconstructor(calibration)(indexed(forms["recorded"]).frame(2)).depth_mm
    np.testing.assert_array_equal(station.newest.result.depth_mm, wanted)
    buttons.step(replayed, 0, 1)
    until(lambda: number_shown(station) == 3)
    buttons.step(replayed, 0, -1)
    until(lambda: number_shown(station) == 2)
    np.testing.assert_array_equal(station.newest.result.depth_mm, wanted)
    assert station.facts()["state"] == "running"


def test_two_calibrations_see_the_same_held_frame(replayed):
    station = replayed.stations[0]
    serial = station.newest.serial
    actions.compare_with(replayed, 0, "mine")
    until(lambda: station.newest.other is not None)
    assert station.newest.serial > serial
    assert number_shown(station) == 2
    np.testing.assert_array_equal(station.newest.other.depth_mm, station.newest.result.depth_mm)
    facts = station.newest.header()
    assert facts["other"]["apart"] == 0
    assert facts["replay"][0] == 2


def test_zero_and_background_are_of_the_held_frame(replayed):
    station = replayed.stations[0]
    actions.set_zero(replayed, 0)
    until(lambda: station.newest.zero_mm is not None)
    assert np.abs(station.newest.result.depth_mm).max() < 1e-6
    actions.take_background(replayed, 0)
    np.testing.assert_array_equal(station.setup.background, station.newest.image)


def test_play_speed_loop_and_back_to_the_sensor(replayed):
    station = replayed.stations[0]
    buttons.speed(replayed, 0, 4)
    buttons.loop(replayed, 0, True)
    actions.pause(replayed, 0, False)
    facts = until(lambda: (f := station.facts()["replay"]) and f["playing"] and f)
    assert (facts["speed"], facts["loop"], facts["count"]) == (4, True, 7)
    actions.pause(replayed, 0, True)
    assert not station.facts()["replay"]["playing"]
    buttons.open_recording(replayed, 0, "")
    until(lambda: station.facts()["simulated"])
    with pytest.raises(GelformError, match="Open a recording first"):
        buttons.step(replayed, 0, 1)


def test_a_recording_is_not_recorded_again(replayed):
    with pytest.raises(GelformError, match="recording already"):
        actions.record(replayed, 0, True)


def test_what_is_shared_plays_elsewhere_with_its_calibration(replayed, calibration):
    actions.take_background(replayed, 0)
    background = replayed.stations[0].setup.background
    buttons.share(replayed, 0)
    name = until(
        lambda: next((f["name"] for f in replayed.recordings.facts() if "shared" in f["name"]), None)
    )
    elsewhere = start(Options([str(replayed.recordings.path(name))]))
    try:
        station = elsewhere.stations[0]
        until(lambda: station.newest and station.newest.result)
        assert station.setup.calibration.digest == calibration.digest
        np.testing.assert_array_equal(station.setup.background, background)
    finally:
        elsewhere.close()


def test_what_the_page_recorded_is_on_the_list_and_carries_the_calibration(hub, tmp_path, calibration):
    hub.folder = tmp_path
    actions.record(hub, 0, True)
    until(lambda: hub.recorders[0].stats.frames > 3)
    actions.record(hub, 0, False)
    name = hub.recordings.facts()[0]["name"]
    assert (
        gelform.sensors.recordings.attached_calibration(hub.recordings.path(name)).digest
        == calibration.digest
    )
    buttons.open_recording(hub, 0, name)
    until(lambda: hub.stations[0].facts()["replay"])
    assert hub.stations[0].setup.name == f"{name}: calibration"


@pytest.mark.parametrize("name", ["../secret.mcap", "/etc/passwd", "nothing"])
def test_names_that_are_not_on_the_list_are_refused(hub, name):
    with pytest.raises(GelformError, match="no recording"):
        buttons.open_recording(hub, 0, name)
    assert hub.stations[0].facts()["simulated"]
