"""The player: in step with its clock, and controlled; the test advances the clock."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from gelform.errors import DataError, GelformError
from gelform.sensors.recordings.indexed import indexed
from gelform.sensors.recordings.player import Player
from live_waiting import until


@pytest.fixture
def recording(forms):
    return indexed(forms["mcap"])


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


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e3])
def test_speeds_out_of_range_are_refused(recording, speed):
    with pytest.raises(GelformError, match="speed"):
        Player(recording).set_speed(speed)


def test_a_damaged_frame_is_said_and_passed_over(recording):
    def frame(number):
        if number == 2:
            raise DataError("Frame 2 is damaged.")
        return recording.frame(number)

    made = Shown(Player(replace(recording, frame=frame)))
    try:
        made.player.seek(2)
        until(lambda: made.player.problem)
        assert not made.player.playing
        made.player.step(1)
        until(lambda: made.numbers and made.numbers[-1] == 3)
    finally:
        made.close()
