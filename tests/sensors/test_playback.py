"""Recordings by number: every frame is the recorded one, in any order, in torn MCAP files too; the player."""

from __future__ import annotations

import threading
import time
from copy import copy

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import DataError, GelformError
from gelform.sensors.films import open_film
from gelform.sensors.playback import Every, Player, RecordingFacts
from live_waiting import until
from made.sources import recorded


def test_on_average_once_a_period_whatever_the_times_between():
    due, times_s = Every(0.125), np.arange(0, 8, 1 / 60)
    assert sum(map(due, times_s)) == 64
    assert due(0.0), "the times have begun again"
    assert [due(time_s) for time_s in (0.1, 5.0, 5.1, 5.13)] == [False, True, False, True]
    assert all(map(Every(), (0.0, 0.0, 1.0)))


@pytest.mark.parametrize(("form", "rate_hz"), [("mcap", 20), ("video", 20), ("images", 25)])
def test_any_frame_in_any_order_has_the_number_and_time_of_open_source(form, rate_hz, forms, frames):
    recording = open_film(forms[form])
    with gelform.open_source(forms[form]) as source:
        played = list(source)
    np.testing.assert_allclose(recording.times_s, np.arange(len(frames)) / rate_hz, atol=1e-3)
    assert len(played) == len(frames)
    for number in (0, 4, 3, 6, 1, 1, 5, 2):
        found = recording[number]
        np.testing.assert_array_equal(found.image, frames[number].image)
        np.testing.assert_array_equal(found.image, played[number].image)
        assert found.time_s == pytest.approx(recording.times_s[number])
    if form == "mcap":
        facts = recording.camera
        assert (facts.name, facts.serial, dict(facts.settings)) == ("ring", "S7", {"exposure": 50.0})


@pytest.fixture
def many_chunks(frames, tmp_path, monkeypatch):
    """A chunk for each frame."""
    monkeypatch.setattr("gelform.sensors.mcap.FLUSH_S", 0.0)
    return recorded(tmp_path / "many.mcap", frames, RecordingFacts("ring"))


def test_frames_are_found_across_chunks_also_those_of_a_killed_recorder(many_chunks, frames, tmp_path):
    index = open_film(many_chunks)
    for number in (6, 0, 5, 1, 4):
        found = index[number]
        np.testing.assert_array_equal(found.image, frames[number].image)
        assert found.index == number
    whole = many_chunks.read_bytes()
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole[: int(0.6 * len(whole))])
    index = open_film(torn)
    assert 2 <= len(index.times_s) < len(frames)
    np.testing.assert_array_equal(index[1].image, frames[1].image)


def test_damaged_bytes_and_a_file_replaced_meanwhile_are_noticed(many_chunks, forms):
    index, content = open_film(many_chunks, scan=True), bytearray(many_chunks.read_bytes())
    many_chunks.write_bytes(forms["mcap"].read_bytes())
    with pytest.raises(DataError):
        index[5]
    content[len(content) // 2] ^= 0xFF
    many_chunks.write_bytes(bytes(content))
    with pytest.raises(DataError, match=r"many\.mcap"):
        open_film(many_chunks)[3]


class Shown:
    """What a player gives, taken in a thread as a grabber takes it."""

    def __init__(self, player):
        self.player, self.frames = player, []
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def _take(self):
        for frame in self.player:
            self.frames.append(frame)

    @property
    def numbers(self):
        return [frame.number for frame in self.frames]

    def close(self):
        self.player.close()
        self._thread.join(2)
        assert not self._thread.is_alive()


@pytest.fixture
def recording(forms):
    return open_film(forms["mcap"])


@pytest.fixture
def shown(recording):
    made = Shown(Player(recording))
    yield made
    made.close()


def test_it_plays_once_and_holds_the_last_frame(shown, recording, frames):
    until(lambda: not shown.player.playing)
    assert shown.numbers[-1] == len(frames) - 1
    assert shown.numbers == sorted(set(shown.numbers))
    assert [frame.index for frame in shown.frames] == list(range(len(shown.frames)))
    np.testing.assert_array_equal(shown.frames[-1].image, frames[-1].image)
    assert shown.frames[-1].recorded_s == recording.times_s[-1]
    assert abs(shown.frames[-1].time_s - time.monotonic()) < 5


def test_it_keeps_the_pace(recording):
    """At 1/16 of the speed the frames are 0.8 s apart: a tenth of a second on, the second one has not come."""
    now = [100.0]
    player = Player(recording, clock=lambda: now[0])
    for speed in (0.0, -1.0, 1e3):
        with pytest.raises(GelformError, match="speed"):
            player.set_speed(speed)
    player.set_speed(1 / 16)
    source = iter(player)
    assert next(source).number == 0
    now[0] += 16 * 0.05 + 1e-6
    assert next(source).number == 1
    now[0] += 3 * 16 * 0.05  # late: the newest that is due
    assert next(source).number == 4


def test_step_and_seek_show_what_they_say(shown):
    until(lambda: shown.frames)
    shown.player.seek(3)
    shown.player.play(False)
    until(lambda: shown.numbers[-1] >= 3)
    shown.player.seek(2)
    until(lambda: shown.numbers[-1] == 2)
    shown.player.step(1)
    until(lambda: shown.numbers[-1] == 3)
    shown.player.step(-1)
    shown.player.step(-1)
    until(lambda: shown.numbers[-1] == 1)
    shown.player.seek(10**6)
    until(lambda: shown.numbers[-1] == 6)
    shown.player.seek(-4)
    until(lambda: shown.numbers[-1] == 0)
    assert not shown.player.playing
    count = len(shown.frames)
    shown.player.again()
    until(lambda: len(shown.frames) == count + 1)
    assert shown.numbers[-1] == 0


def test_at_the_end_it_begins_again_where_it_loops_or_is_told_to(shown):
    shown.player.set_speed(16)
    until(lambda: not shown.player.playing)
    shown.player.play()
    until(lambda: shown.numbers.count(0) >= 2)
    shown.player.loop()
    shown.player.play()
    until(lambda: shown.numbers.count(0) >= 4)


def test_a_single_frame_is_shown_once_though_it_loops(tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((4, 4, 3), np.uint8))
    player = Player(open_film(tmp_path))
    player.loop(True)
    source, ending = iter(player), threading.Timer(0.2, player.close)
    assert next(source).number == 0
    ending.start()
    assert next(source, None) is None, "it waits until it is closed"


def test_a_damaged_frame_is_said_and_passed_over(recording):
    def frame(number):
        if number == 2:
            raise DataError("Frame 2 is damaged.")
        return recording[number]

    damaged = copy(recording)
    damaged._alone, damaged._frame = threading.Lock(), frame
    made = Shown(Player(damaged))
    try:
        made.player.seek(2)
        until(lambda: made.player.problem)
        assert not made.player.playing
        made.player.step(1)
        until(lambda: made.numbers and made.numbers[-1] == 3)
    finally:
        made.close()
