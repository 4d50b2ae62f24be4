"""The newest frame, gaps, and a source that is lost and reopened."""

import queue
import re
import threading
import time

import numpy as np
import pytest

import gelform.sensors.grabber as grabber_module
from gelform.errors import DataError, SensorError, SourceLostError
from gelform.image.frame import Frame
from gelform.sensors.grabber import Grabber
from live_waiting import until
from made.sources import ImageSource

IMAGE = np.zeros((4, 4, 3), np.uint8)
WAIT_S = 5.0  # longest wait for what must happen at once


def awaited(condition):
    until(condition, WAIT_S)


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


def test_takes_what_open_source_takes():
    with Grabber("simulated") as grabber:
        assert grabber.newest(-1, WAIT_S).image.shape == (240, 320, 3)
        assert grabber.name == "simulated three-edges"
        assert grabber.settings["fps"] == 60.0
        assert grabber.serial == "simulated-three-edges"
    assert grabber.state == "ended"


def test_it_needs_a_source_that_opens_and_to_be_entered(device):
    with pytest.raises(RuntimeError, match="with Grabber"):
        _ = Grabber(device.open).name
    for keep in (0, 2**70):
        with pytest.raises(ValueError, match="Expected keep between 1 and"):
            Grabber(device.open, keep=keep)
    device.there = False
    with pytest.raises(SensorError, match="no such camera"), Grabber(device.open):
        pass
