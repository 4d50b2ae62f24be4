"""One interface to every source of frames; files and videos play in order, with their times and pace, or give an error."""

import time

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import DataError, SensorError
from gelform.image.frame import Frame
from gelform.sensors import playback
from gelform.sensors.playback import Pace, Playback, folder_playback, video_playback
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.source import open_source
from gelform.sensors.video_files import is_video


def test_a_folder_and_what_cannot_be_set(tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), np.zeros((4, 4, 3), np.uint8))
    assert [frame.index for frame in open_source(tmp_path)] == [0]
    assert open_source(str(tmp_path), paced=True).live
    for spec in ("simulated", tmp_path):
        with pytest.raises(SensorError, match="is no USB camera: exposure cannot be set"):
            open_source(spec, settings={"exposure": 5})
        open_source(spec, settings={}).close()


def test_frames_of_blue_green_red_are_given_as_rgb(tmp_path):
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    cv2.imwrite(str(tmp_path / "0.png"), image)  # it takes the array as blue, green, red
    with open_source(tmp_path, bgr=True) as source:
        (frame,) = source
    np.testing.assert_array_equal(frame.image, image)
    assert (source.name, source.live, frame.encoded) == (open_source(tmp_path).name, False, None)


def test_what_is_no_source_says_what_is(tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.sensors.cameras.camera.cameras_there", lambda: [])
    (tmp_path / "notes.txt").write_text("x")
    for spec, error, said in (
        (tmp_path / "notes.txt", DataError, r"is no video, no folder of images and no recording"),
        (tmp_path / "none", DataError, "Check the path"),
        (tmp_path / "none.mp4", DataError, "No video file"),
        (3, TypeError, "text or a path"),
        ("simulated:gelsigt", SensorError, r"three-edges.*gelsight-mini"),
        ("D20123", SensorError, r"No camera.*plugged in"),
        ("", SensorError, r"No camera.*plugged in"),
        ("/dev/video77", SensorError, r"No camera.*plugged in"),
    ):
        with pytest.raises(error, match=said):
            open_source(spec)


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
    source = Playback(frames(100, 0.5), RecordingFacts("x", rate_hz=0.5))
    started = time.monotonic()
    taken = list(source)
    assert time.monotonic() - started < 100  # 200 s at their pace
    assert not source.live
    assert [frame.index for frame in taken] == list(range(100))
    assert taken[10].time_s == pytest.approx(27)


def test_paced_frames_come_at_their_time_on_our_clock():
    source = Playback(frames(6), RecordingFacts("x", rate_hz=50.0), paced=True)
    assert source.live
    ages = [time.monotonic() - frame.time_s for frame in source]
    assert min(ages) >= 0
    taken = list(Playback(frames(6), RecordingFacts("x", rate_hz=50.0), paced=True))
    times, steps = (np.diff([getattr(frame, name) for frame in taken]) for name in ("time_s", "index"))
    assert times == pytest.approx(0.02 * steps, abs=1e-9)  # a late reader passes over some
    assert all(abs(time.time_ns() - frame.wall_time_ns) < 10e9 for frame in taken)


def test_a_late_reader_gets_the_frame_that_is_due_and_closing_ends_the_loop():
    reader = iter(Playback(frames(60), RecordingFacts("x", rate_hz=50.0), paced=True))
    next(reader)
    time.sleep(0.3)
    assert next(reader).index >= 14
    with Playback(frames(60), RecordingFacts("x")) as source:
        reader = iter(source)
        next(reader)
    assert list(reader) == []


def test_a_folder_in_the_order_of_names_in_rgb_and_one_without_images(folder):
    taken = list(folder_playback(folder, rate_hz=10.0))
    assert [int(frame.image[0, 0, 0]) for frame in taken] == [201, 200, 202]
    np.testing.assert_array_equal(taken[1].image[3, 3], RED)
    assert [frame.time_s for frame in taken] == pytest.approx([0, 0.1, 0.2])
    (folder / "empty").mkdir()
    with pytest.raises(DataError, match="Expected images"):
        folder_playback(folder / "empty")


def write(path, frames, rate_hz=25.0):
    """Frames (RGB) as a video."""
    height, width = frames[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), rate_hz, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    writer.release()


@pytest.fixture
def smooth():
    """Smooth, colored, no two alike."""
    y, x = np.mgrid[0:48, 0:64]
    return [
        np.stack([2 * x + k, 3 * y, 200 - 2 * x - k], axis=-1).clip(0, 255).astype(np.uint8)
        for k in range(12)
    ]


def test_frames_are_rgb_in_order_with_times_also_in_part(tmp_path, smooth):
    write(tmp_path / "a.avi", smooth)
    video, source = gelform.Video(tmp_path / "a.avi"), video_playback(tmp_path / "a.avi")
    assert (source.rate_hz, source.settings) == (25.0, {"width": 64, "height": 48})
    read = list(source)
    assert [frame.index for frame in read] == list(range(12))
    np.testing.assert_allclose([frame.time_s for frame in read], np.arange(12) / 25, atol=1e-3)
    for frame, true in zip(read, smooth):
        assert np.abs(frame.image.astype(int) - true).mean() < 4
    assert (video.facts.shape, video.facts.count) == ((48, 64), 12)
    assert video.facts.frame_rate_hz == pytest.approx(25)
    part = list(video.frames({3, 7}))
    assert [frame.index for frame in part] == [3, 7]
    for frame in part:
        np.testing.assert_array_equal(frame.image, read[frame.index].image)
        assert frame.time_s == read[frame.index].time_s
    assert is_video("presses.MP4")
    assert not is_video("presses.png")


def test_no_file_empty_file_no_video_and_a_truncated_one(tmp_path, smooth):
    write(tmp_path / "cut.avi", smooth)
    whole = (tmp_path / "cut.avi").read_bytes()
    for content, said in (
        (None, "No video file"),
        (b"", "is empty"),
        (b"no video " * 100, "cannot be decoded"),
        (whole[: len(whole) // 2], "truncated or damaged|cannot be decoded"),
    ):
        if content is not None:
            (tmp_path / "a.avi").write_bytes(content)
        with pytest.raises(gelform.DataError, match=said):
            list(gelform.Video(tmp_path / "a.avi"))


def test_an_address_of_another_kind_says_what_is_read_instead():
    for address in ("rtsp://10.0.0.7/stream", "udp://@:5000", "file:///tmp/a.mp4"):
        with pytest.raises(SensorError, match=r"begins with http:// or https:// .*got \w+://.*ffmpeg"):
            gelform.open_source(address)
