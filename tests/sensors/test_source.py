"""One interface to every source of frames: files and videos in order, at their pace; the newest one of a lost source."""

import queue
import re
import sys
import threading
import time
from functools import partial

import cv2
import numpy as np
import pytest

import gelform
import gelform.sensors.grabber as grabber_module
from gelform.errors import DataError, SensorError, SourceLostError
from gelform.image.view import Frame
from gelform.sensors.files import is_video
from gelform.sensors.films import is_film
from gelform.sensors.grabber import Grabber
from gelform.sensors.playback import Playback, RecordingFacts
from gelform.sensors.source import open_source
from live_waiting import until
from made import sources
from made.sources import ImageSource, video_file


def test_a_folder_also_of_blue_green_red_and_what_cannot_be_set(tmp_path):
    image = np.arange(768, dtype=np.uint8).reshape(16, 16, 3)
    cv2.imwrite(str(tmp_path / "0.png"), image)  # it takes the array as blue, green, red
    ((frame,), (other,)) = (open_source(tmp_path, bgr=bgr) for bgr in (False, True))
    np.testing.assert_array_equal(frame.image, image[..., ::-1])
    np.testing.assert_array_equal(other.image, image)
    with open_source(tmp_path, bgr=True) as source:
        assert (source.name, source.live, other.encoded) == (tmp_path.name, False, None)
        frames = iter(source)
    assert list(frames) == [], "the end of the block closes the source that it turns"
    assert open_source(str(tmp_path), paced=True).live
    for spec in ("simulated", tmp_path):
        with pytest.raises(SensorError, match="is no USB camera: exposure cannot be set"):
            open_source(spec, settings={"exposure": 5})
        open_source(spec, settings={}).close()
        with open_source(spec, settings={"fps": 10}) as source:
            assert source.rate_hz == 10
    film = video_file(tmp_path / "film.avi", [image])
    with pytest.raises(SensorError, match=r"film\.avi is no USB camera: fps cannot be set"):
        open_source(film, settings={"fps": 10})


def test_what_is_no_source_says_what_is(tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.sensors.cameras.cameras_there", lambda: [])
    (tmp_path / "notes.txt").write_text("x")
    for spec, error, said in (
        (tmp_path / "notes.txt", DataError, r"is no video, no folder of images and no recording"),
        (tmp_path / "none", DataError, "Check the path"),
        (tmp_path / "none.mp4", DataError, "No video file"),
        (3.0, TypeError, "text, a path or a camera's number"),
        (True, TypeError, "text, a path or a camera's number"),
        (
            2,
            SensorError,
            r"No camera '/dev/video2'.*plugged in" if sys.platform.startswith("linux") else "No camera",
        ),
        (-1, SensorError, "0 or more, got -1"),
        ("9" * 200, SensorError, r"No camera.*plugged in"),
        ("simulated:gelsigt", SensorError, r"three-edges.*gelsight-mini"),
        ("D20123", SensorError, r"No camera.*plugged in"),
        ("", SensorError, r"No camera.*plugged in"),
        ("/dev/video77", SensorError, r"No camera.*plugged in"),
        ("rtsp://10.0.0.7/stream", SensorError, r"begins with http:// or https:// .*got rtsp://.*ffmpeg"),
        ("udp://@:5000", SensorError, r"begins with http:// or https:// .*got udp://.*ffmpeg"),
        ("file:///tmp/a.mp4", SensorError, r"begins with http:// or https:// .*got file://.*ffmpeg"),
    ):
        with pytest.raises(error, match=said):
            open_source(spec)
    assert is_film(str(tmp_path))
    assert not any(map(is_film, ("/dev/null", "2BKRXXXX", "http://a/?" + "9" * 5000)))


def frames(count, rate_hz=50.0):
    image = np.zeros((4, 6, 3), np.uint8)
    return (Frame(image + k, 7.0 + k / rate_hz, 0, k) for k in range(count))


def test_as_fast_as_they_are_read_with_their_own_times():
    source = Playback(frames(100, 0.5), RecordingFacts("x", rate_hz=0.5))
    started = time.monotonic()
    taken = list(source)
    assert time.monotonic() - started < 100  # 200 s at their pace
    assert not source.live
    assert [frame.index for frame in taken] == list(range(100))
    assert taken[10].time_s == pytest.approx(27)


def test_paced_frames_come_at_their_time_on_our_clock():
    given = sources.frames(6)  # unevenly spaced
    source = Playback(given, RecordingFacts("x", rate_hz=50.0), paced=True)
    assert source.live
    taken = [(frame, time.monotonic()) for frame in source]
    for frame, now in taken:  # a late reader passes over some
        after_s = next(one.time_s for one in given if one.index == frame.index) - given[0].time_s
        assert frame.time_s - taken[0][0].time_s == pytest.approx(after_s, abs=1e-6)
        assert now >= frame.time_s
        assert frame.wall_time_ns == sources.START_NS + round(frame.index / 50 * 1e9)
    stamped = next(iter(Playback(frames(6), RecordingFacts("x"), paced=True)))
    assert abs(time.time_ns() - stamped.wall_time_ns) < 10e9


def test_a_late_reader_gets_the_frame_that_is_due_and_closing_ends_the_loop():
    reader = iter(Playback(frames(60), RecordingFacts("x", rate_hz=50.0), paced=True))
    next(reader)
    time.sleep(0.3)
    assert next(reader).index >= 14
    late = (time.sleep(0.1) or one for one in frames(1))
    assert len(list(Playback(late, RecordingFacts("x", rate_hz=50.0), paced=True))) == 1, "never the first"
    with Playback(frames(60), RecordingFacts("x")) as source:
        reader = iter(source)
        next(reader)
    assert list(reader) == []


def test_a_folder_in_the_order_of_names_and_one_without_images(tmp_path):
    for k, name in enumerate(("b.png", "a.png", "c.png")):
        cv2.imwrite(str(tmp_path / name), np.full((8, 10, 3), k, np.uint8))
    (tmp_path / "notes.txt").write_text("no image")
    taken = list(open_source(tmp_path, rate_hz=10.0))
    assert [int(frame.image[0, 0, 0]) for frame in taken] == [1, 0, 2]
    assert [frame.time_s for frame in taken] == pytest.approx([0, 0.1, 0.2])
    (tmp_path / "empty").mkdir()
    with pytest.raises(DataError, match="Expected images"):
        open_source(tmp_path / "empty")


@pytest.fixture
def smooth():
    """Smooth, colored, no two alike."""
    y, x = np.mgrid[0:48, 0:64]
    stacks = (np.stack([2 * x + k, 3 * y, 200 - 2 * x - k], axis=-1) for k in range(12))
    return [stack.clip(0, 255).astype(np.uint8) for stack in stacks]


def test_frames_are_rgb_in_order_with_times_also_in_part(tmp_path, smooth):
    video, source = (
        opened(video_file(tmp_path / "a.avi", smooth)) for opened in (gelform.Video, open_source)
    )
    assert (source.rate_hz, source.settings) == (25.0, {"width": 64, "height": 48})
    read = list(source)
    assert [frame.index for frame in read] == list(range(12))
    np.testing.assert_allclose([frame.time_s for frame in read], np.arange(12) / 25, atol=1e-3)
    for frame, true in zip(read, smooth):
        assert np.abs(frame.image.astype(int) - true).mean() < 4
    assert video.count == 12
    part = list(video.frames({3, 7}))
    assert [frame.index for frame in part] == [3, 7]
    for frame in part:
        np.testing.assert_array_equal(frame.image, read[frame.index].image)
        assert frame.time_s == read[frame.index].time_s
    assert is_video("presses.MP4")
    assert not is_video("presses.png")


def test_no_file_empty_file_no_video_and_a_truncated_one(tmp_path, smooth):
    whole = video_file(tmp_path / "cut.avi", smooth).read_bytes()
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


IMAGE = np.zeros((4, 4, 3), np.uint8)
WAIT_S = 5.0  # longest wait for what must happen at once


awaited = partial(until, timeout_s=WAIT_S)


class Device:
    """A device that a test drives: it gives the frames it is told to, and is lost when told to be."""

    def __init__(self, serial="A"):
        self.serial, self.opened, self.closed, self.there = serial, 0, set(), True
        self.frames = queue.SimpleQueue()

    def give(self, index, problem=None):
        self.frames.put(problem or Frame(IMAGE, time.monotonic(), time.time_ns(), index))

    def open(self):
        if not self.there:
            raise SensorError("no such camera")
        self.opened += 1
        return Opened(self, self.serial)


class Opened(ImageSource):
    def __init__(self, device, serial):
        super().__init__([IMAGE], rate_hz=30.0)
        self.name, self.settings = "device", {"gain": 3.0}
        self.device, self.serial = device, serial

    def __iter__(self):
        while not self.closed:
            try:
                frame = self.device.frames.get(timeout=0.05)
            except queue.Empty:
                continue
            if isinstance(frame, Exception):
                raise frame
            if frame == "end":
                return
            yield frame

    def close(self):
        self.closed = True
        self.device.closed.add(self)


@pytest.fixture
def device():
    return Device()


def test_gives_the_newest_and_counts_what_nobody_saw(device):
    with Grabber(device.open) as grabber:
        for k in range(5):
            device.give(k)
        awaited(lambda: grabber.stats.frames == 5)
        assert grabber.newest().index == 4
        assert grabber.stats.unseen == 4
        assert grabber.newest(4, timeout_s=0) is None
        device.give(5)
        assert grabber.newest(4, WAIT_S).index == 5
        assert grabber.stats.unseen == 4


def test_gaps_are_drops_and_a_recorder_gets_all_that_are_held_in_order(device):
    with Grabber(device.open, keep=4) as grabber:
        for k in (0, 1, 4, 5, 6, 7):
            device.give(k)
        awaited(lambda: grabber.stats.frames == 6)
        assert grabber.stats.drops == 2
        taken, after = [], -1
        while (frame := grabber.following(after, 0)) is not None:
            taken.append(after := frame.index)
    assert taken == [4, 5, 6, 7]


def test_every_consumer_gets_the_frame(device):
    got = []
    with Grabber(device.open) as grabber:
        readers = [threading.Thread(target=lambda: got.append(grabber.newest(-1, WAIT_S))) for _ in range(3)]
        for reader in readers:
            reader.start()
        device.give(0)
        for reader in readers:
            reader.join()
    assert [frame.index for frame in got] == [0, 0, 0]
    assert got[0] is got[1] is got[2]


def test_a_lost_source_is_opened_again_and_counted_on(device):
    with Grabber(device.open) as grabber:
        device.give(0)
        device.give(7)
        assert grabber.newest(6, WAIT_S).index == 7
        assert grabber.state == "running"
        device.there = False
        device.give(0, SourceLostError("unplugged"))
        awaited(lambda: grabber.state == "reconnecting" and grabber.reason == "no such camera")
        assert grabber.newest(7, timeout_s=0.01) is None
        device.there = True
        device.give(0)
        assert grabber.newest(7, WAIT_S).index == 8
        assert grabber.stats.rate_hz == 0, "the time without the source is no time between frames"
        device.give(1)
        assert grabber.newest(8, WAIT_S).index == 9
        assert (grabber.state, grabber.reason) == ("running", "")
        assert grabber.stats.reopened == 1
        assert grabber.stats.drops == 6
    assert device.opened == len(device.closed) == 2


def test_another_camera_is_not_taken_for_the_lost_one(device):
    with Grabber(device.open) as grabber:
        device.serial = "B"
        device.give(0, SourceLostError("unplugged"))
        awaited(lambda: "serial A" in grabber.reason)
        assert grabber.state == "reconnecting"
        device.serial = "A"
        device.give(0)
        assert grabber.newest(-1, WAIT_S) is not None


def test_cameras_that_changed_places_are_found_by_serial(monkeypatch):
    """Opened by its path, plugged in again after another one that has the path now."""
    ours, other = Device("A"), Device("B")
    at = {"/dev/video0": ours, "A": ours}

    def open_source(spec, timeout_s=None):
        if spec not in at:
            raise SensorError(f"no camera {spec}")
        return at[spec].open()

    monkeypatch.setattr(grabber_module, "open_source", open_source)
    with Grabber("/dev/video0") as grabber:
        ours.give(0)
        grabber.newest(-1, WAIT_S)
        at["/dev/video0"] = other
        ours.give(0, SourceLostError("unplugged"))
        ours.give(0)
        assert grabber.newest(0, WAIT_S).index == 1
        assert grabber.serial == "A"
    assert other.opened == len(other.closed)


def test_a_source_that_stands_still_is_said_to_be_reconnecting(device):
    with Grabber(device.open, stall_s=0.4) as grabber:
        device.give(0)
        grabber.newest(-1, WAIT_S)
        awaited(lambda: grabber.state == "reconnecting")
        assert re.match(r"no frame for \d", grabber.reason)
        device.give(1)
        grabber.newest(0, WAIT_S)
        assert grabber.state == "running"


def test_the_end_of_the_source_ends_the_waiting_and_its_error_reaches_the_consumer(device):
    with Grabber(device.open) as grabber:
        device.give(0)
        grabber.newest(-1, WAIT_S)
        device.give(0, "end")
        assert grabber.newest(0) is None
        assert (grabber.state, grabber.reason) == ("ended", "the source has no more frames")
    with Grabber(device.open) as grabber:
        device.give(0, DataError("frame 3 is damaged"))
        with pytest.raises(DataError, match="frame 3"):
            grabber.newest()
        assert grabber.state == "ended"


def test_age_and_rate_are_of_the_capture(device):
    with Grabber(device.open) as grabber:
        assert grabber.state == "starting"
        assert grabber.stats.age_s is None
        started = time.monotonic() - 1
        for k in range(11):
            device.frames.put(Frame(IMAGE, started + k / 50, 0, k))
        awaited(lambda: grabber.stats.frames == 11)
        assert grabber.stats.rate_hz == pytest.approx(50)
        least_s = time.monotonic() - started - 10 / 50
        assert least_s <= grabber.stats.age_s <= time.monotonic() - started - 10 / 50


def test_it_needs_to_be_entered_and_a_source_that_opens_as_open_source_takes_it(device):
    with Grabber("simulated") as grabber:
        assert grabber.newest(-1, WAIT_S).image.shape == (240, 320, 3)
        assert (grabber.name, grabber.serial) == ("simulated three-edges", "simulated-three-edges")
        assert grabber.settings["fps"] == 60.0
    assert grabber.state == "ended"
    with pytest.raises(RuntimeError, match="with Grabber"):
        _ = Grabber(device.open).name
    for keep in (0, 2**70):
        with pytest.raises(ValueError, match="Expected keep between 1 and"):
            Grabber(device.open, keep=keep)
    device.there = False
    with pytest.raises(SensorError, match="no such camera"), Grabber(device.open):
        pass
