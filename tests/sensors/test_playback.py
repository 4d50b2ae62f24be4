"""Playing files: order, times, pace."""

import time

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.frames import Frame
from gelform.sensors import playback
from gelform.sensors.playback import Pace, Playback, folder_playback, video_playback


class Clock:
    """A clock that only sleep moves."""

    now = 100.0

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds


def test_a_pace_waits_for_what_is_to_come_and_passes_over_what_is_late(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(playback, "time", clock)
    pace = Pace(20.0)
    assert [pace.wait_for(k) for k in range(4)] == pytest.approx([100, 100.05, 100.1, 100.15])
    assert clock.now == pytest.approx(100.15)
    clock.now = 101
    assert pace.wait_for(3) == pytest.approx(100.15)
    assert clock.now == 101
    pace = Pace(20.0)
    assert pace.next_after(0) == 1
    clock.now += 0.52
    assert pace.next_after(0) == 10
    assert pace.late_s(0.5) == pytest.approx(0.02)
    assert pace.late_s(1.0) < 0


RED = np.array([200, 30, 10], dtype=np.uint8)  # RGB


def frames(count, rate_hz=50.0):
    image = np.zeros((4, 6, 3), np.uint8)
    return lambda: (Frame(image + k, 7.0 + k / rate_hz, 0, k) for k in range(count))


@pytest.fixture
def folder(tmp_path):
    for k, name in enumerate(("b.png", "a.png", "c.png")):
        cv2.imwrite(str(tmp_path / name), np.full((8, 10, 3), RED[::-1]) + np.uint8(k))
    (tmp_path / "notes.txt").write_text("no image")
    return tmp_path


def test_as_fast_as_they_are_read_with_their_own_times():
    source = Playback(frames(100, 0.5), name="x", rate_hz=0.5)
    started = time.monotonic()
    taken = list(source)
    assert time.monotonic() - started < 100  # 200 s at their pace
    assert not source.live
    assert [frame.index for frame in taken] == list(range(100))
    assert taken[10].time_s == pytest.approx(27)


def test_paced_frames_come_at_their_time_on_our_clock():
    source = Playback(frames(6), name="x", rate_hz=50.0, paced=True)
    assert source.live
    ages = [time.monotonic() - frame.time_s for frame in source]
    assert min(ages) >= 0
    taken = list(Playback(frames(6), name="x", rate_hz=50.0, paced=True))
    assert np.diff([frame.time_s for frame in taken]) == pytest.approx(0.02, abs=1e-9)
    assert all(abs(time.time_ns() - frame.wall_time_ns) < 10e9 for frame in taken)


def test_a_late_reader_of_paced_frames_gets_the_one_that_is_due():
    reader = iter(Playback(frames(60), name="x", rate_hz=50.0, paced=True))
    next(reader)
    time.sleep(0.3)
    assert next(reader).index >= 14


def test_closing_ends_the_loop():
    with Playback(frames(60), name="x") as source:
        reader = iter(source)
        next(reader)
    assert list(reader) == []


def test_a_folder_in_the_order_of_names_in_rgb(folder):
    source = folder_playback(folder, rate_hz=10.0)
    taken = list(source)
    assert [int(frame.image[0, 0, 0]) for frame in taken] == [201, 200, 202]
    np.testing.assert_array_equal(taken[1].image[3, 3], RED)
    assert [frame.time_s for frame in taken] == pytest.approx([0, 0.1, 0.2])


def test_a_folder_without_images_says_so(tmp_path):
    with pytest.raises(DataError, match="Expected images"):
        folder_playback(tmp_path)


def test_a_video_in_rgb_with_its_rate(tmp_path):
    path = tmp_path / "v.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (32, 16))
    for _ in range(5):
        writer.write(np.full((16, 32, 3), RED[::-1]))
    writer.release()
    source = video_playback(path)
    assert (source.rate_hz, source.settings) == (10.0, {"width": 32, "height": 16})
    taken = list(source)
    assert len(taken) == 5
    np.testing.assert_allclose(taken[0].image[8, 16], RED, atol=6)
