"""The motion on the page: what is known of it, and nothing else.

A station on a source that fails, is late, disappears and returns: it continues, and reports its state.
"""

import re
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from gelform.errors import CalibrationError, SensorError, SourceLostError
from gelform.live.hub import Hub
from gelform.live.station import MovedSince, Setup, Station
from gelform.motion.between import FOUND, LOST, UNSURE, pose_of_step
from gelform.sensors.record import Recorder
from gelform.sensors.streams.memory import LOOK_S
from gelform.simulate import simulate_background
from live_waiting import until
from made.rigid_contacts import MM_PER_PX, SHAPE, ball, contact_of, cylinder, pose, texture
from made.sources import ImageSource

STEPS = [(0.3 * k - 1.5, -0.1 * k, 1.5 * k) for k in range(4)]  # mm, mm, degrees
FRAMES = [contact_of(texture(), pose(x, y, yaw=yaw), seed=k) for k, (x, y, yaw) in enumerate(STEPS)]
NOTHING = contact_of(texture(), radius_mm=0.2)


def followed(frames):
    follow = MovedSince()
    return [follow(frame, 0.004) for frame in frames]


def test_the_path_and_the_turn_are_those_of_the_object():
    found = followed([NOTHING, *FRAMES])
    assert [one["state"] for one in found] == [LOST, FOUND, FOUND, FOUND, FOUND]
    assert (found[0]["why"], found[0]["path"]) == ("nothing touches", [])
    last, (x, y, yaw) = found[-1], np.subtract(STEPS[-1], STEPS[0])
    np.testing.assert_allclose(last["shift_mm"], (x, y), atol=0.03)
    assert last["turn_deg"] == pytest.approx(yaw, abs=0.3)
    assert 0 < max(last["shift_sigma_mm"]) < 0.1
    assert 0 < last["turn_sigma_deg"] < 1
    turn = np.radians(yaw)
    np.testing.assert_allclose(last["axes"][0], (np.cos(turn), np.sin(turn)), atol=0.01)
    middle = (np.array(SHAPE[::-1]) - 1) / 2
    wanted = middle + np.array(STEPS)[:, :2] / MM_PER_PX
    np.testing.assert_allclose(last["path"], wanted, atol=1)


def test_the_shift_is_that_of_the_contacts_middle():
    """A turn about a point 2 mm beside it shifts it across."""
    x, y, yaw = 0.3, -0.2, 4.0
    turn, beside = np.radians(yaw), np.array([2.0, 0])
    about = pose_of_step(np.array([x, y, 0, 0, 0, turn]), np.array([*beside, 0]))
    last = followed([contact_of(texture(), seed=1), contact_of(texture(), about, seed=2)])[-1]
    wanted = (x + 2 * (1 - np.cos(turn)), y - 2 * np.sin(turn))
    np.testing.assert_allclose(last["shift_mm"], wanted, atol=0.01)


def test_a_turn_that_nothing_shows_is_not_given():
    last = followed(contact_of(ball, pose(0.28 * k), seed=k) for k in range(4))[-1]
    assert last["state"] == FOUND
    assert len(last["blind"]) == 1
    assert "ball's center" in last["blind"][0]
    assert last["turn_deg"] is last["axes"] is None
    np.testing.assert_allclose(last["shift_mm"], (0.84, 0), atol=0.05)


def test_a_shift_that_nothing_shows_has_no_path():
    """A cylinder that moved across its axis may have moved along it too."""
    first, *_, last = followed(contact_of(cylinder, pose(0, 0.28 * k), seed=k) for k in range(3))
    assert last["state"] == FOUND
    assert any("along x" in words for words in last["blind"])
    assert last["shift_mm"] is None
    assert last["path"] == first["path"]


def test_the_path_has_a_gap_where_the_object_was_lost():
    far = contact_of(texture(), pose(2.5, 0, yaw=20), seed=5)
    found = followed([*FRAMES[:2], far, far, *FRAMES[2:]])
    assert [one["state"] for one in found] == [FOUND, FOUND, LOST, LOST, FOUND, FOUND]
    assert found[2]["why"]
    assert found[2]["shift_mm"] is found[2]["turn_deg"] is None
    assert [place is None for place in found[-1]["path"]] == [False, False, True, False, False]


def test_what_has_hardly_moved_has_no_numbers():
    still = followed([FRAMES[0], contact_of(texture(), pose(-1.45), seed=8)])[-1]
    assert (still["state"], still["shift_mm"], still["axes"]) == (UNSURE, None, None)
    assert len(still["path"]) == 1


def test_a_new_touch_and_another_calibration_begin_anew():
    other = [replace(frame, calibration_digest="b") for frame in FRAMES]
    for frames in ([*FRAMES[:3], NOTHING, FRAMES[3]], [*FRAMES[:3], other[3]]):
        last = followed(frames)[-1]
        assert (last["state"], last["shift_mm"], len(last["path"])) == (FOUND, [0.0, 0.0], 1)


def test_without_a_scale_there_is_no_motion():
    found = followed([replace(FRAMES[0], mm_per_px=None)])[0]
    assert (found["state"], found["path"]) == (LOST, [])
    assert "scale" in found["why"]


GRAY = [np.full((132, 176, 3), 90, np.uint8)]


def test_a_frame_of_another_size_shows_with_the_reason(show, calibration):
    shown = show(lambda: ImageSource([GRAY[0][:100, :100]]), setup=Setup(calibration, "mine")).newest
    assert shown.result is None
    assert "100" in shown.problem
    assert "132" in shown.problem


def test_a_camera_that_is_not_there_is_waited_for(show, monkeypatch):
    monkeypatch.setattr("gelform.live.station.RETRY_S", 0.05)
    tries = []

    def opener():
        tries.append(1)
        if len(tries) < 4:
            raise SensorError("Expected a camera, found none. Plug it in.")
        return ImageSource(GRAY)

    station = show(opener, waits=False)
    until(lambda: station.facts()["reason"])
    assert station.facts()["state"] == "missing"
    assert "Plug it in" in station.facts()["reason"]
    shown = until(lambda: station.newest)
    assert (shown.result, shown.image.shape) == (None, (132, 176, 3)), "without a calibration its image"
    until(lambda: station.facts()["rate_hz"] > 0)
    assert station.facts()["state"] == "running"


def test_a_camera_that_goes_away_comes_back(show):
    failing = {}
    station = show(lambda: ImageSource(GRAY, **failing))
    failing |= {"count": 0, "fails": SourceLostError("The camera was unplugged.")}
    vars(station.source).update(failing)
    until(lambda: station.facts()["state"] == "reconnecting")
    before = station.newest.serial
    failing.clear()
    until(lambda: station.newest.serial > before and station.facts()["state"] == "running")
    assert station.facts()["reopened"] >= 1


@pytest.mark.parametrize("fails", ["tap", "listener", "reconstruction"])
def test_what_fails_in_a_sensors_thread_does_not_end_it(show, monkeypatch, tmp_path, fails):
    monkeypatch.setattr("gelform.live.station.RETRY_S", 0.02)
    station, calls, reconstructed = show(lambda: ImageSource(GRAY)), [], Station.reconstructed
    recorder = Recorder(station.grabber, tmp_path)
    recorder.start()

    def failing(*given):
        calls.append(given)
        if len(calls) == 1:
            raise ValueError("not thought of")
        return reconstructed(*given) if fails == "reconstruction" else None

    if fails == "tap":
        station.taps.append(failing)
    elif fails == "listener":
        station._on_shown = failing
    else:
        monkeypatch.setattr(Station, "reconstructed", failing)
    until(lambda: calls)
    before = station._serial
    until(lambda: station.newest.serial > before + 3)
    recorder.close()
    if fails == "tap":
        assert (len(calls), station.taps, recorder.problem) == (1, [], ""), (
            "it gets no more, and nothing else ends"
        )


def test_while_nobody_looks_few_frames_are_reconstructed_and_recorders_get_all(show, tmp_path):
    looking, hub, times_s = threading.Event(), Hub(), []
    hub.listen(lambda: times_s.append(hub.stations[0].newest.frame.time_s))
    # At 100 Hz, with which a busy machine keeps up.
    station = show(lambda: ImageSource(GRAY), hub, watched=looking.is_set)
    until(lambda: len(times_s) > 8)
    # A frame is a little older than its reconstruction.
    assert np.median(np.diff(times_s)) >= 0.9 * LOOK_S
    recorder = Recorder(station.grabber, tmp_path)
    recorder.start()
    until(lambda: recorder.stats.frames > 40)
    recorder.close()
    assert recorder.stats.missing == 0
    assert recorder.stats.duration_s / recorder.stats.frames < LOOK_S / 2
    looking.set()
    until(lambda: np.diff(times_s[-20:]).min() < LOOK_S / 2)
    looking.clear()
    until(lambda: np.median(np.diff(times_s[-6:])) >= 0.9 * LOOK_S)
    station.taps.append(lambda shown: None)  # a guide, or frames that are averaged
    until(lambda: np.diff(times_s[-4:]).max() < LOOK_S / 2)


class Counted(ImageSource):
    """Its own count has a gap after every second frame; the reconstruction of each takes as long as four frames."""

    def __iter__(self):
        for frame in super().__iter__():
            yield replace(frame, index=frame.index + frame.index // 2)


def test_frames_that_never_came_are_lost_and_those_passed_over_are_skipped(show, monkeypatch):
    reconstructed, hub, indices = Station.reconstructed, Hub(), []
    monkeypatch.setattr(Station, "reconstructed", lambda *given: time.sleep(0.008) or reconstructed(*given))
    hub.listen(lambda: indices.append(hub.stations[0].newest.frame.index) or time.sleep(0.001))
    station = show(lambda: Counted(GRAY, rate_hz=500.0), hub)
    until(lambda: len(indices) > 30)
    station.pause(True)
    seen, counted = station.grabber.stats, station.facts()
    assert seen.drops / 3 <= counted["lost"] / 2 < seen.frames / 3
    passed_over = indices[-1] - indices[0] + 1 - len(indices)
    assert counted["skipped"] + counted["lost"] == pytest.approx(passed_over, abs=12)
    assert counted["skipped"] > counted["lost"]
    until(lambda: station.grabber.stats.frames > seen.frames + 100)  # what is not wanted is not skipped
    station.pause(False)
    until(lambda: len(indices) > 40)
    more = indices[-1] - indices[0] + 1 - len(indices)
    assert station.skipped + counted["lost"] < more - 50


def test_numbers_are_those_of_every_result(station):
    until(lambda: len(station.numbers_since(0)) > 5)
    serials = [row[0] for row in station.numbers_since(0)]
    assert serials == list(range(serials[0], serials[0] + len(serials)))
    assert station.numbers_since(serials[-3])[0][0] == serials[-2]


def test_paused_it_holds_the_picture(station):
    station.paused = True
    time.sleep(0.4)
    held = station.newest.serial
    time.sleep(0.1)
    assert station.newest.serial == held
    station.paused = False
    until(lambda: station.newest.serial > held)


def test_a_background_is_used_and_given_back_and_another_sensors_is_refused(calibration, sensor):
    today = simulate_background(sensor, np.random.default_rng(8)).astype(np.float32)
    setup = Setup(calibration, "mine", background=today)
    with pytest.raises(CalibrationError):
        replace(setup, background=calibration.background[..., ::-1].copy())
    assert not setup.memory.reconstruct.own_background
    assert replace(setup, name="other").background is today
    assert replace(setup, background=None).memory.reconstruct.own_background
    for _ in range(9):
        setup = setup.taking(calibration, "mine", today)
    assert len(setup.earlier) == 8


def test_a_setup_for_another_sequence_has_forgotten_what_the_last_one_taught(calibration):
    setup = Setup(calibration, "mine")
    setup.memory.reconstruct = setup.memory.reconstruct.with_background(calibration.background + 3)
    setup.memory.zero = setup.memory.reconstruct.from_image(calibration.background)
    fresh = replace(setup)
    np.testing.assert_array_equal(fresh.memory.reconstruct.background, calibration.background)
    assert (fresh.memory.zero, fresh.name) == (None, "mine")
    assert replace(Setup()) == Setup()


def test_a_recording_with_gaps_ends_with_a_warning(show, tmp_path):
    hub = Hub()
    station = show(lambda: Counted(GRAY, rate_hz=100.0), hub)
    recorder = hub.recorders[station.number] = Recorder(station.grabber, tmp_path)
    recorder.start()
    until(lambda: recorder.stats.frames > 8)
    recorder.close()
    hub.recorded(station, recorder)
    _, level, text = hub.facts()["notices"][-1]
    assert level == "warning"
    assert re.search(r"^Recorded \d+ frames: .*\. \d+ of \d+ frames \(\d+ %\) are missing: \d+ lost", text)
