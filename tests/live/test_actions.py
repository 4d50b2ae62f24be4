"""The effect of the buttons on a running simulated sensor, on a recording, and in a guided calibration.

The hub: facts for the page, notices, long work and its end, frames on request.
"""

from __future__ import annotations

import json
import re
import threading
import time
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform import DataError, Frame, GelformError, SensorError, SourceLostError
from gelform.live import actions
from gelform.live.actions import start
from gelform.live.hub import GRACE_S, Hub, Pages, page_named, sentence_for_page
from gelform.live.station import Setup
from gelform.live.web.client import MessageError, done
from gelform.sensors.films import open_film
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.record import attached_calibration
from gelform.simulate import Ball, simulate_background, simulate_press
from live_waiting import until
from made.files import FPS, KEY
from made.sources import ImageSource, recorded


def test_a_data_set_is_a_recording(lerobot, tmp_path):
    root, frames = lerobot
    with pytest.raises(DataError, match="Give one with --dataset"):
        start([str(root)], folder=tmp_path)
    with closing(start([str(root)], folder=tmp_path, dataset=KEY)) as hub:
        (station,) = hub.stations
        until(lambda: station.player is not None)
        station.player.seek(4)
        until(lambda: station.player.facts()["number"] == 4 and station.newest is not None)
        assert station.player.facts()["count"] == len(frames)
        actions.open_recording(hub, station, hub.recordings.facts()[0]["name"])
        assert station.player.facts()["duration_s"] == pytest.approx((len(frames) - 1) / FPS)


def test_the_background_is_the_sensors(hub, station, sensor):
    actions.take_background(hub, station)
    taken = station.setup.background
    noise = np.abs(taken - simulate_background(sensor, None)).mean()
    assert noise < 0.6  # of 2 levels, averaged over 15
    assert "Background taken: the average of 15 frames" in hub.notices[-1][2]
    actions.take_background(hub, station)
    assert station.facts()["can_undo"]
    actions.undo_background(hub, station)
    assert station.setup.background is taken
    actions.undo_background(hub, station)
    assert station.setup.background is None
    assert not station.facts()["can_undo"]
    with pytest.raises(GelformError, match="no background to undo"):
        actions.undo_background(hub, station)


def test_a_simulated_sensor_rests_while_the_background_is_taken(hub, station):
    source, resting = station.source, []
    for before in (False, True):
        source.rest(before)
        rest, source.rest = source.rest, lambda on=True, rest=source.rest: (resting.append(on), rest(on))
        actions.take_background(hub, station)
        source.rest = rest
        assert source.resting is before
    assert resting == [True, False, True, True]


def test_zero_is_set_and_taken_back(hub, station):
    station.source.press_at(88, 66, 0.4, held_s=600)
    until(lambda: station.newest.numbers.peak > 0.3)
    actions.set_zero(hub, station)
    until(lambda: station.newest.numbers.peak < 0.1)
    actions.set_zero(hub, station)
    until(lambda: station.newest.numbers.peak > 0.3)


def test_the_motion_is_followed_while_it_is_asked_for_and_seen(hub, station, monkeypatch):
    station.source.press_at(88, 66, 0.7, held_s=600)
    until(lambda: station.newest.numbers.peak > 0.5)
    assert station.newest.header()["motion"] is None
    actions.follow_motion(hub, station, True)
    until(lambda: station.newest.motion and station.newest.motion["path"])
    assert station.newest.header()["motion"]["path"]
    assert station.facts()["motion"]
    monkeypatch.setattr(station, "_watched", lambda: False)
    until(lambda: station.newest.motion is None)
    monkeypatch.undo()
    until(lambda: station.newest.motion)
    actions.follow_motion(hub, station, False)
    until(lambda: station.newest.motion is None)
    assert not station.facts()["motion"]


def test_a_press_is_where_it_was_asked_for(hub, station):
    actions.press(hub, station, 120.0, 40.0)
    deep = until(lambda: station.newest if station.newest.numbers.peak > 0.35 else None).numbers
    assert (deep.x_px, deep.y_px) == pytest.approx((120, 40), abs=4)


def test_another_calibration_is_used(hub, station, calibration):
    actions.use_calibration(hub, station, hub.calibrations.add("again", calibration))
    assert station.setup.name == "again"


def test_what_is_not_listed_or_known_is_refused(hub, station):
    before = station.setup
    for act, name, said in (
        (actions.use_calibration, "../secret.npz", "There is no calibration"),
        (actions.open_recording, "../secret.mcap", "There is no recording"),
    ):
        with pytest.raises((GelformError, ValueError), match=said):
            act(hub, station, name)
    assert station.setup is before
    assert station.facts()["simulated"]
    station.setup = Setup()
    for act in (actions.take_background, actions.set_zero):
        with pytest.raises(GelformError, match="no calibration yet"):
            act(hub, station)


@pytest.fixture
def replayed(hub, station, forms, tmp_path):
    """The hub's station on the recording, held at frame 2."""
    hub.folder = tmp_path
    open_held(hub, forms["mcap"], 7, 2)
    return hub


def open_held(hub, path, count, number):
    """Show a recording of so many frames, held at one of them."""
    (station,) = hub.stations
    actions.open_recording(hub, station, hub.recordings.add(path))
    until(lambda: (replay := station.facts()["replay"]) and replay["count"] == count)
    station.player.play(False)
    station.player.seek(number)
    until(lambda: number_shown(station) == number)


def number_shown(station):
    return getattr(station.newest.frame, "number", None)


def test_the_result_is_that_of_the_frame_alone(replayed, station, forms, calibration):
    """Whatever was shown before: forward, backward, twice."""
    wanted = gelform.Reconstructor(calibration)(open_film(forms["mcap"])[2]).depth_mm
    np.testing.assert_array_equal(station.newest.result.depth_mm, wanted)
    station.player.step(1)
    until(lambda: number_shown(station) == 3)
    station.player.step(-1)
    until(lambda: number_shown(station) == 2)
    np.testing.assert_array_equal(station.newest.result.depth_mm, wanted)
    assert station.facts()["state"] == "running"


def test_zero_is_of_the_held_frame_and_a_pressed_background_is_taken_and_said(replayed, station):
    actions.set_zero(replayed, station)
    until(lambda: station.newest.result.zero == "set")
    assert np.abs(station.newest.result.depth_mm).max() < 1e-6
    np.testing.assert_array_equal(station.newest.result.gradients, 0)
    before = station.setup.background
    actions.take_background(replayed, station)
    assert re.search("Something seems to touch the gel.* Undo goes back", replayed.notices[-1][2])
    assert station.setup.background is not before
    actions.undo_background(replayed, station)
    assert station.setup.background is before


def test_a_background_from_a_held_frame_is_said_to_be_of_one(replayed, station, sensor, tmp_path):
    rest = recorded(tmp_path / "rest.mcap", frames_of([simulate_background(sensor, None)] * 3))
    open_held(replayed, rest, 3, 1)  # the other recording was held at frame 2
    actions.take_background(replayed, station)
    assert "Background taken from one frame" in replayed.notices[-1][2]
    assert station.setup.background is not None
    assert actions.attached_setup(replayed, station.setup, rest).background is None, "it is of that sensor"
    actions.open_recording(replayed, station, "")
    until(lambda: station.facts()["simulated"])  # not the recording before this one


def frames_of(images):
    """Frames at 25 per second."""
    return [Frame(np.asarray(one), k / 25, 10**18 + k, k) for k, one in enumerate(images)]


def test_play_speed_loop_and_back_to_the_sensor(replayed, station):
    for asked in (
        {"do": "speed", "speed": 4},
        {"do": "loop", "loop": True},
        {"do": "pause", "paused": False},
    ):
        done(replayed, {"station": 0, **asked})
    facts = until(lambda: (f := station.facts()["replay"]) and f["playing"] and f)
    assert (facts["speed"], facts["loop"], facts["count"]) == (4, True, 7)
    actions.pause(replayed, station, True)
    assert not station.facts()["replay"]["playing"]
    with pytest.raises(GelformError, match="already a recording"):
        actions.record(replayed, station, True)
    actions.open_recording(replayed, station, "")
    until(lambda: station.facts()["simulated"])
    with pytest.raises(GelformError, match="Open a recording first"):
        done(replayed, {"do": "step", "station": 0, "by": 1})


def test_what_is_shared_plays_elsewhere_with_its_calibration(replayed, calibration):
    background = np.rint(0.99 * calibration.background).astype(np.float32)
    replayed.stations[0].setup = replace(replayed.stations[0].setup, background=background)
    actions.share(replayed, replayed.stations[0])
    name = until(
        lambda: next((f["name"] for f in replayed.recordings.facts() if "shared" in f["name"]), None)
    )
    with closing(start([str(replayed.recordings.path(name))])) as elsewhere:
        station = elsewhere.stations[0]
        until(lambda: station.newest and station.newest.result)
        assert station.setup.calibration.digest == calibration.digest
        np.testing.assert_array_equal(station.setup.background, background)


def test_what_the_page_recorded_is_kept_as_it_came_with_the_calibration(hub, station, tmp_path, calibration):
    hub.folder = tmp_path
    actions.record(hub, station, True)
    recorder = hub.recorders[0]
    until(lambda: recorder.stats.frames >= 8)
    assert hub.facts()["recordings"][0]["frames"] >= 8
    actions.record(hub, station, True)  # does no harm
    assert hub.recorders[0] is recorder
    actions.record(hub, station, False)
    actions.record(hub, station, False)
    assert not hub.recorders
    assert recorder.path.name in hub.notices[-1][2]
    assert list(tmp_path.iterdir()) == [recorder.path]
    frames = list(gelform.open_source(recorder.path))
    assert len(frames) == recorder.stats.frames
    assert [frame.index for frame in frames] == sorted({frame.index for frame in frames})
    assert frames[0].image.shape == station.newest.frame.image.shape
    assert np.diff([frame.time_s for frame in frames]).min() > 0
    name = hub.recordings.facts()[0]["name"]
    assert attached_calibration(hub.recordings.path(name)).digest == calibration.digest
    actions.open_recording(hub, station, name)
    until(lambda: station.facts()["replay"])
    assert station.setup.name == f"{name}: calibration"


def test_it_ends_with_the_page_that_began_it(hub, station, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.live.hub.GRACE_S", 0.05)
    hub.folder = tmp_path
    hub.pages.came("page-one")
    actions.record(hub, station, True, "page-one")
    recorder = hub.recorders[0]
    until(lambda: recorder.stats.frames >= 3)
    hub.pages.left("page-one")
    until(lambda: not hub.recorders)
    until(lambda: hub.notices)
    assert "the page that began it was closed" in hub.notices[-1][2]
    assert hub.notices[-1][1] == "warning"
    assert [one["name"] for one in hub.recordings.facts()] == [recorder.path.name]
    assert len(list(gelform.open_source(recorder.path))) == recorder.stats.frames


def test_a_guide_refuses_an_impossible_ball_and_knows_the_simulated_sensors_scale(hub, station, sensor):
    for diameter in (0.0, -3.0, 1e4):
        with pytest.raises(GelformError, match="ball"):
            actions.guide_start(hub, station, diameter, "", 0.0)
    for act in (actions.guide_fit, actions.guide_use):
        with pytest.raises(GelformError, match="Press Start first"):
            act(hub, station)
    for diameter in (5.0, 6.0):
        actions.guide_start(hub, station, diameter, "", 0.0)
        guide = hub.guides[0].guide
        assert (guide.ball_diameter_mm, guide.settings.mm_per_px) == (diameter, sensor.mm_per_px)
        assert len(station.taps) == 1


def test_a_camera_that_comes_back_with_another_size_ends_nothing(hub, station, monkeypatch, tmp_path):
    """The guide says it, and goes on once the size is back; the recording goes on too."""
    monkeypatch.setattr("gelform.calibration.guide.LOOK_EVERY_S", 0.0)
    hub.folder = tmp_path
    actions.guide_start(hub, station, 5.0, "", 0.0)
    guide, usual = hub.guides[0].guide, station.source.image_at
    actions.record(hub, station, True)
    for step in ("background", "press"):
        until(lambda step=step: guide.step == step and guide.facts()["untouched"][0])
        station.source.image_at = lambda index: usual(index).repeat(2, 0).repeat(2, 1)
        until(lambda: "Expected images of 176x132 px, as before, got 352x264 px." in guide.hint)
        station.source.image_at = usual
        until(lambda: "Expected" not in guide.hint)
    assert hub.recorders


def test_a_guide_that_fails_says_so_and_the_sensor_goes_on(hub, station, monkeypatch):
    actions.guide_start(hub, station, 5.0, "", 0.0)
    monkeypatch.setattr(hub.guides[0].guide, "look_at", lambda frame: 1 / 0)
    until(lambda: any("ZeroDivisionError" in text for *_, text in hub.notices))
    before = station.newest.serial
    until(lambda: station.newest.serial > before + 3)
    assert not station.taps


PLACES_MM = np.array([(-5.0, -3.0), (5.0, 3.0), (0.0, 0.0), (-5.0, 3.5), (5.0, -3.5), (0.0, 4.0)])
HELD, LIFTED, UNTOUCHED = 14, 8, 40  # frames at 25 a second


@pytest.fixture
def filmed(sensor, tmp_path):
    """A recording of six presses of a ball, each held for half a second, after the untouched gel."""
    rng, rest = np.random.default_rng(7), simulate_background(sensor, None)
    images = [rest] * UNTOUCHED
    for place in PLACES_MM:
        press = simulate_press(sensor, Ball(2.5), depth_mm=0.45, center_mm=place, rng=None, oversample=1)
        images += [press.image] * HELD + [rest] * LIFTED
    noisy = [one + rng.normal(0, sensor.noise_sd, one.shape) for one in images]
    filmed = frames_of([np.clip(one, 0, 255).astype(np.uint8) for one in noisy])
    return recorded(tmp_path / "filmed.mcap", filmed, RecordingFacts("ring", None, {}, 25.0))


@pytest.mark.slow
def test_a_recording_is_calibrated_from_start_to_end(hub, station, filmed, sensor, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.calibration.guide.LOOK_EVERY_S", 0.0)
    hub.folder = tmp_path
    actions.open_recording(hub, station, hub.recordings.add(filmed))
    until(lambda: station.facts()["replay"])
    actions.guide_start(hub, station, 5.0, "", sensor.mm_per_px)
    guide = hub.guides[0].guide
    until(lambda: station.newest and number_shown(station) is not None)
    # Frame by frame: a busy machine, which plays only the newest that is due, would pass over presses.
    station.player.play(False)
    for number in range(station.source.facts()["count"]):
        station.player.seek(number)
        until(lambda number=number: number_shown(station) == number)
    assert guide.count >= 5, guide.facts()["rejected"]
    mm = np.array([(x - 87.5, y - 65.5) for x, y, _ in guide.facts()["accepted"]]) * sensor.mm_per_px
    assert all(np.hypot(*(PLACES_MM - one).T).min() < 0.4 for one in mm)
    said = []
    guide.fit(tmp_path, lambda done, total, what: said.append(what))
    assert guide.step == "report"
    assert said
    actions.guide_use(hub, station)
    assert station.setup.name.startswith("ring_no-serial_")
    station.player.seek(UNTOUCHED + HELD // 2)
    deep = until(lambda: (numbers := station.newest.numbers) and numbers.peak > 0.3 and numbers)
    assert deep.peak == pytest.approx(0.45, abs=0.12)


def test_facts_can_be_sent_as_json_and_a_notice_is_one_line(hub):
    facts = json.loads(json.dumps(hub.facts(), allow_nan=False))
    assert facts["stations"][0]["state"] == "running"
    assert facts["calibrations"] == ["mine"]
    hub.notice("first\nline")
    assert hub.facts()["notices"] == [[1, "info", "first line"]]
    assert hub.facts(notices_after=1)["notices"] == []


def test_pages_and_sinks_want_every_result():
    hub = Hub()
    assert not hub.watched()
    hub.pages.came("page-one")
    assert hub.watched()
    hub.pages.left("page-one")
    assert not hub.watched()
    hub.sinks = 1
    assert hub.watched()


def test_work_shows_its_progress_and_its_failure(hub, station):
    go_on = threading.Event()

    def work(progress):
        progress(1, 4, "pressing")
        go_on.wait(5)
        raise DataError("The disk is full.")

    hub.start(work, station, "starting")
    until(lambda: hub.facts()["work"].get(0) == ["pressing", 1, 4])
    with pytest.raises(GelformError, match="busy"):
        hub.start(work, station, "again")
    go_on.set()
    until(lambda: not hub.facts()["work"])
    assert hub.notices[-1][1:] == ("error", "The disk is full.")


def test_an_error_that_nobody_expected_is_logged_and_one_about_a_file_names_it(
    hub, station, tmp_path, caplog
):
    with pytest.raises(OSError) as problem:
        (tmp_path / "none").read_text()
    assert sentence_for_page(problem.value) == f"No such file or directory: {tmp_path / 'none'}."
    assert not caplog.records
    hub.start(lambda _: {}["there is none"], station, "starting")
    until(lambda: not hub.facts()["work"])
    assert hub.notices[-1][1] == "error"
    assert "mistake in gelform, not yours: KeyError: 'there is none'" in hub.notices[-1][2]
    assert caplog.records[-1].exc_info[0] is KeyError


def test_frames_that_do_not_come_are_an_error(station):
    began_s = time.monotonic()
    with pytest.raises(GelformError, match=r"Expected 5000 frames within 0\.2 s"):
        station.next_frames(5000, timeout_s=0.2)
    station.pause(True)
    with pytest.raises(GelformError, match=r"picture is held\. Press Continue first"):
        station.next_frames(1)
    station.pause(False)
    until(lambda: not station.silence)
    station.close()
    with pytest.raises(GelformError, match="server is stopping"):
        station.next_frames(1)
    assert not station.taps
    assert time.monotonic() - began_s < 15


def test_a_sensor_that_was_unplugged_is_named_at_once(show):
    """Also while its frames are awaited."""
    gone = threading.Event()

    def opened():
        if gone.is_set():
            raise SensorError("No camera.")
        image = np.full((48, 64, 3), 90, np.uint8)
        return ImageSource([image], count=20, fails=SourceLostError("It was unplugged."))

    station = show(opened)
    gone.set()
    for _ in range(2):
        with pytest.raises(GelformError, match=r"gives no frames: (It was unplugged|No camera)"):
            station.next_frames(5000)


def test_one_action_at_a_time_changes_a_sensor_that_is_there(hub):
    for number, said in ((0, "This sensor is busy"), (1, "no sensor 1"), (-1, "no sensor -1")):
        with hub.turn(0), pytest.raises(GelformError, match=said), hub.turn(number):
            pass


def test_a_page_is_open_until_it_has_been_away_for_a_while():
    now_s = 100.0
    pages = Pages(lambda: now_s)
    assert not pages.is_open("page-one")
    pages.came("page-one")
    pages.came("page-one")  # loaded anew: the new connection may come before the old one's end is heard of
    now_s += 1000
    assert pages.is_open("page-one")
    pages.left("page-one")
    now_s += 1000
    assert pages.is_open("page-one")
    assert pages.any_connected
    pages.left("page-one")
    assert not pages.any_connected
    now_s += 1
    pages.came("page-one")  # back in time
    now_s += 1000
    assert pages.is_open("page-one")
    pages.left("page-one")
    now_s += GRACE_S - 0.1
    assert pages.is_open("page-one")
    now_s += 0.2
    assert not pages.is_open("page-one")


def test_what_is_no_name_is_nobodys():
    assert page_named("0123456789abcdef") == "0123456789abcdef"
    for given in ("", "short", "A" * 20, "../../../etc", "a" * 65):
        assert page_named(given) == ""


def test_a_line_is_measured_as_by_the_command(hub, station):
    until(lambda: station.newest is not None and station.newest.result is not None)
    actions.pause(hub, station, True)
    ends = [20.0, 20.0, 60.0, 40.0]
    answer = done(hub, {"do": "measure", "station": 0, "ends_px": ends})
    wanted = gelform.measure(station.current.result, lines=[ends]).quantities
    assert answer["ends_px"] == ends
    assert answer["text"].startswith(", ".join(map(str, wanted)) + ".")
    for wrong in ([1.0, 2.0, 3.0], [1.0, 2.0, 3.0, "x"], "1,2,3,4"):
        with pytest.raises(MessageError):
            done(hub, {"do": "measure", "station": 0, "ends_px": wrong})
    with pytest.raises(ValueError, match="pixels of the image"):
        done(hub, {"do": "measure", "station": 0, "ends_px": [0.0, 0.0, 9999.0, 1.0]})
