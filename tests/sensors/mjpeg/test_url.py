"""A camera at an address: newest picture, torn pictures, and a real server that is killed and comes back."""

import time

import numpy as np
import pytest

from ffmpeg_camera import FfmpegCamera, why_absent
from gelform.errors import SensorError, SourceLostError
from gelform.sensors.grabber import Grabber
from gelform.sensors.mjpeg.url import MjpegUrl
from gelform.sensors.source import open_source
from made.mjpeg_server import HEADER, SEEN, MjpegServer, jpeg, part

RED, GREEN, BLUE = jpeg(color=(200, 0, 0)), jpeg(color=(0, 200, 0)), jpeg(color=(0, 0, 200))
WAIT_S = 20.0


def taken(pieces, count, header=HEADER):
    with MjpegServer(pieces, header) as server, MjpegUrl(server.url) as source:
        frames = []
        for _, frame in zip(range(count), source):
            frames.append(frame)
            server.seen.release()
        return frames, source


def channel(frame):
    return int(frame.image[10, 10].argmax())


def test_frames_in_rgb_as_they_come():
    frames, source = taken([part(RED), SEEN, part(GREEN), SEEN, part(BLUE)], 3)
    assert [channel(frame) for frame in frames] == [0, 1, 2]
    assert [frame.index for frame in frames] == [0, 1, 2]
    assert frames[1].encoded == GREEN
    assert source.settings == {"width": 64, "height": 48, "reduced": 1}
    assert 0 <= time.monotonic() - frames[0].time_s < WAIT_S


def test_of_many_that_wait_the_newest_is_taken():
    with MjpegServer([part(RED), SEEN, part(RED) * 7 + part(BLUE)]) as server, MjpegUrl(server.url) as source:
        reader = iter(source)
        assert channel(next(reader)) == 0
        server.seen.release()
        assert server.sent.wait(WAIT_S)
        frame = next(reader)
    assert (channel(frame), frame.index) == (2, 8)


def test_torn_pictures_are_left_out_and_leave_a_gap():
    torn = part(GREEN[: len(GREEN) // 2])
    frames, _ = taken([part(RED), SEEN, torn, 0.1, part(BLUE)], 2)
    assert [(channel(frame), frame.index) for frame in frames] == [(0, 0), (2, 2)]


def test_nothing_but_torn_pictures_is_a_lost_source():
    torn = [piece for _ in range(15) for piece in (part(GREEN[:-2]), 0.01)]
    with pytest.raises(SourceLostError, match="torn pictures in a row"):
        taken([part(RED), 0.1, *torn], 2)


def test_a_hang_up_in_mid_picture_is_a_lost_source():
    with pytest.raises(SourceLostError, match="ended the stream"):
        taken([part(RED), 0.1, part(GREEN)[:200], None], 2)


def test_a_server_that_names_no_kind_is_read_by_its_first_line():
    header = b"HTTP/1.0 200 OK\r\nContent-Type: application/octet-stream\r\n\r\n"
    frames, _ = taken([part(RED), 0.1, part(GREEN)], 2, header)
    assert [channel(frame) for frame in frames] == [0, 1]


def test_a_page_is_no_stream():
    header = b"HTTP/1.0 200 OK\r\nContent-Type: text/html\r\n\r\n"
    with pytest.raises(SensorError, match="not of the page"):
        taken([b"<html>", None], 1, header)


def test_large_pictures_are_decoded_at_reduced_size():
    frames, source = taken([part(jpeg((960, 1280)))], 1)
    assert frames[0].image.shape == (480, 640, 3)
    assert source.settings == {"width": 1280, "height": 960, "reduced": 2}


def test_closing_wakes_a_waiting_reader():
    with MjpegServer([part(RED)]) as server, Grabber(server.url) as grabber:
        assert channel(grabber.newest(-1, WAIT_S)) == 0
        started = time.monotonic()
        grabber.close()
        assert grabber.state == "ended"
    assert time.monotonic() - started < WAIT_S


@pytest.mark.skipif(why_absent() is not None, reason=str(why_absent()))
def test_a_killed_camera_is_back_when_it_returns():
    with FfmpegCamera() as camera, Grabber(camera.url) as grabber:
        frame = grabber.newest(-1, WAIT_S)
        for _ in range(2):
            camera.kill()
            until = time.monotonic() + WAIT_S
            while grabber.state != "reconnecting":
                assert time.monotonic() < until
                time.sleep(0.005)
            assert (
                "Nothing answers" in grabber.reason or "lost" in grabber.reason or "ended" in grabber.reason
            )
            last = grabber.newest(-1, 0).index
            camera.start()
            frame = grabber.newest(last, WAIT_S)
            assert frame is not None
            assert frame.index > last
            assert grabber.state == "running"
        assert grabber.stats.reopened == 2
    assert frame.image.shape == (240, 320, 3)
    assert np.ptp(frame.image) > 100


def test_the_door_knows_addresses():
    with MjpegServer([part(RED)]) as server, open_source(server.url) as source:
        assert source.live
        assert source.name.endswith("/stream")
