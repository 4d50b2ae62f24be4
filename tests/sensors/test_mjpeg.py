"""A network camera: newest picture, torn pictures, any answer and boundary, and a real server that is killed."""

import re
import socket
import time

import numpy as np
import pytest

from gelform.errors import SensorError, SourceLostError
from gelform.sensors.grabber import Grabber
from gelform.sensors.mjpeg import MAX_PART_BYTES, Dechunker, HttpBody, MjpegUrl, PartSplitter, shown_address
from live_waiting import until
from made.sources import HEADER, SEEN, MjpegServer, jpeg, part
from stream.ffmpeg_camera import FfmpegCamera, why_absent

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


def test_frames_in_rgb_as_they_come_large_ones_reduced():
    frames, source = taken([part(RED), SEEN, part(GREEN), SEEN, part(BLUE)], 3)
    assert [(channel(frame), frame.index) for frame in frames] == [(0, 0), (1, 1), (2, 2)]
    assert frames[1].encoded == GREEN
    assert source.settings == {"width": 64, "height": 48, "reduced": 1}
    assert 0 <= time.monotonic() - frames[0].time_s < WAIT_S
    frames, source = taken([part(jpeg((960, 1280)))], 1)
    assert frames[0].image.shape == (480, 640, 3)
    assert source.settings == {"width": 1280, "height": 960, "reduced": 2}


def test_of_many_that_wait_the_newest_is_taken():
    with MjpegServer([part(RED), SEEN, part(RED) * 7 + part(BLUE)]) as server, MjpegUrl(server.url) as source:
        reader = iter(source)
        assert channel(next(reader)) == 0
        server.seen.release()
        assert server.sent.wait(WAIT_S)
        frame = next(reader)
    assert (channel(frame), frame.index) == (2, 8)


def test_torn_pictures_leave_a_gap_and_nothing_else_is_a_lost_source():
    torn = part(GREEN[: len(GREEN) // 2])
    frames, _ = taken([part(RED), SEEN, torn, 0.1, part(BLUE)], 2)
    assert [(channel(frame), frame.index) for frame in frames] == [(0, 0), (2, 2)]
    torn = [piece for _ in range(15) for piece in (part(GREEN[:-2]), 0.01)]
    with pytest.raises(SourceLostError, match="torn pictures in a row"):
        taken([part(RED), 0.1, *torn], 2)
    with pytest.raises(SourceLostError, match="header of at most"):
        taken([b"--frame\r\n" + b"X-Filler: a\r\n" * 2000], 1)
    with pytest.raises(SourceLostError, match="ended the stream"):
        taken([part(RED), 0.1, part(GREEN)[:200], None], 2)


def test_a_server_that_names_no_kind_is_read_by_its_first_line_and_a_page_refused():
    kind = "HTTP/1.0 200 OK\r\nContent-Type: {}\r\n\r\n"
    frames, _ = taken([part(RED), 0.1, part(GREEN)], 2, kind.format("application/octet-stream").encode())
    assert [channel(frame) for frame in frames] == [0, 1]
    with pytest.raises(SensorError, match="not of the page"):
        taken([b"<html>", None], 1, kind.format("text/html").encode())


def test_closing_wakes_a_waiting_reader():
    with MjpegServer([part(RED)]) as server, Grabber(server.url) as grabber:
        assert grabber.name.endswith("/stream")
        assert channel(grabber.newest(-1, WAIT_S)) == 0
        started = time.monotonic()
        grabber.close()
        assert grabber.state == "ended"
    assert time.monotonic() - started < WAIT_S


@pytest.mark.slow
@pytest.mark.skipif(why_absent() is not None, reason=str(why_absent()))
def test_a_killed_camera_is_back_when_it_returns():
    with FfmpegCamera() as camera, Grabber(camera.url) as grabber:
        frame = grabber.newest(-1, WAIT_S)
        for _ in range(2):
            camera.kill()
            until(lambda: grabber.state == "reconnecting")
            assert re.search("Nothing answers|lost|ended", grabber.reason)
            last = grabber.newest(-1, 0).index
            camera.start()
            frame = grabber.newest(last, WAIT_S)
            assert frame is not None
            assert frame.index > last
            assert grabber.state == "running"
        assert grabber.stats.reopened == 2
    assert frame.image.shape == (240, 320, 3)
    assert np.ptp(frame.image) > 100


CHUNKED = HEADER.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n")


def body_of(pieces, header=HEADER, url=lambda url: url):
    with MjpegServer(pieces, header) as server:
        body = HttpBody(url(server.url), 2.0)
        read = b""
        while data := body.read(2.0):
            read += data
        body.close()
    return read, server.requests[0].decode()


def test_the_body_is_what_was_sent_with_user_and_password_in_the_header():
    read, request = body_of([b"one", 0.02, b"two", None])
    assert read == b"onetwo"
    assert request.startswith("GET /stream HTTP/1.1\r\n")
    assert "\r\nHost: 127.0.0.1:" in request
    read, _ = body_of([b"3\r\none\r\n", 0.02, b"8;x=1\r\ntwo", 0.02, b"three\r\n", b"0\r\n\r\n"], CHUNKED)
    assert read == b"onetwothree"
    _, request = body_of([None], url=lambda url: url.replace("//", "//eve:p%40ss@") + "?a=1")
    for said in ("Authorization: Basic ZXZlOnBAc3M=", "GET /stream?a=1 ", "Host: 127.0.0.1:"):
        assert said in request


def test_chunks_may_be_cut_anywhere_and_torn_ones_are_a_lost_source():
    sent = b"3\r\none\r\nA\r\n0123456789\r\n0\r\n\r\n"
    for size in (1, 2, 5, 100):
        dechunk = Dechunker()
        pieces = [dechunk.feed(sent[at : at + size]) for at in range(0, len(sent), size)]
        assert b"".join(pieces) == b"one0123456789"
        assert dechunk.ended
    # A size below 0 would be awaited for ever, and a line that never ends would fill the memory.
    for torn in (b"\xff\xd8zz\r\n", b"\r\n\r\n", b"-5\r\nab", b"0" * 2000):
        with pytest.raises(SourceLostError, match="torn"):
            Dechunker().feed(torn)


def test_other_answers_and_a_connection_to_itself_say_what_to_do(monkeypatch):
    for answer, says in (
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "user and password"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "404 Not Found. Check the path"),
        (b"HTTP/1.1 302 Found\r\nLocation: http://x/y\r\n\r\n", "http://x/y"),
        (b"SSH-2.0-OpenSSH\r\n\r\n", "does not speak HTTP"),
    ):
        with MjpegServer([], answer) as server, pytest.raises(SensorError, match=says):
            HttpBody(server.url, 2.0)
    with pytest.raises(SensorError, match=r"Nothing answers at 127\.0\.0\.1"):
        HttpBody(server.url, 2.0)
    for url in ("http:///x", "http://host:port/"):
        with pytest.raises(SensorError, match="Expected an address"):
            HttpBody(url, 2.0)
    # Of many attempts at a port that nobody has, one may get that port as its own end.
    with socket.socket() as own:
        own.bind(("127.0.0.1", 0))
        own.connect(own.getsockname())
        url = f"http://127.0.0.1:{own.getsockname()[1]}/"
        monkeypatch.setattr(socket, "create_connection", lambda *_: own)
        with pytest.raises(SensorError, match="no program listens"):
            HttpBody(url, 2.0)


def test_silence_is_a_lost_source():
    with MjpegServer([b"one"]) as server:
        body = HttpBody(server.url, 2.0)
        assert body.read(2.0) == b"one"
        started = time.monotonic()
        with pytest.raises(SourceLostError, match=r"nothing for 0\.05 s"):
            body.read(0.05)
        assert time.monotonic() - started < 2
        body.close()


BODIES = [b"\xff\xd8one\xff\xd9", b"\xff\xd8" + bytes(3000) + b"\xff\xd9", b"\xff\xd8--fra\r\n\xff\xd9"]


def test_parts_come_out_whole_however_they_arrive_or_torn_where_they_lie():
    for with_length in (True, False):
        for size in (1, 7, 1000, 10**6):
            stream = b"".join(part(body, with_length) for body in BODIES) + b"--frame\r\n"
            feed = PartSplitter("frame").feed
            found = [one for at in range(0, len(stream), size) for one in feed(stream[at : at + size])]
            assert found == BODIES
    stream = part(BODIES[0], False, "--frame") + part(BODIES[1], False, "--frame") + b"----frame\r\n"
    for boundary in ("--frame", "frame", '"--frame"', "----frame"):
        assert PartSplitter(boundary).feed(stream) == BODIES[:2]
    for stated in ("4000", "999999999"):  # more than there is, up to what no memory holds
        lying = part(BODIES[1]).replace(b": 3004", f": {stated}".encode())
        for size in (1, 1000, 10**6):
            feed, sent = PartSplitter("frame").feed, lying + part(BODIES[0])
            found = [one for at in range(0, len(sent), size) for one in feed(sent[at : at + size])]
            assert found == [BODIES[1], BODIES[0]]
    with pytest.raises(ValueError, match="64 MB"):
        PartSplitter("frame").feed(bytes(MAX_PART_BYTES + 1))
    lying = part(BODIES[1]).replace(b"Content-Length: 3004", b"Content-Length: 1000")
    found = PartSplitter("frame").feed(lying + part(BODIES[0]))
    assert [len(one) for one in found] == [1000, len(BODIES[0])]
    assert found[1] == BODIES[0]


def test_an_address_is_shown_without_its_secrets():
    for given, shown in (
        ("http://eve:p%40ss@cam:8080/a?b=1", "http://cam:8080/a?b=1"),
        ("https://eve:p@ss@cam/a@2", "https://cam/a@2"),
        ("http://eve:p/ss@cam/a", "http://cam/a"),
        ("HTTP://eve@[::1]:80/", "HTTP://[::1]:80/"),
        ("http://[::1]/a@2", "http://[::1]/a@2"),
        ("http://cam/a@2?action=stream", "http://cam/a@2?action=stream"),
        ("http://cam/?user=eve&Password=hidden&x=1", "http://cam/?user=eve&Password=...&x=1"),
        ("2BKRXXXX", "2BKRXXXX"),
        ("simulated:digit", "simulated:digit"),
    ):
        assert shown_address(given) == shown


def test_no_message_has_the_password():
    for pieces in ([part(RED), 0.1, None], [None], [b"<html>", None]):
        with MjpegServer(pieces) as server:
            with pytest.raises(SensorError) as refused:
                list(MjpegUrl(server.url.replace("//", "//eve:hidden@")))
            assert server.url in str(refused.value)
            assert "hidden" not in str(refused.value)
    gone = server.url.replace("//", "//eve:hidden@")
    for url in (gone, "http://eve:hidden@/x", "http://eve:hidden@host:port/", "http://eve:hidden@[::1/"):
        with pytest.raises(SensorError) as refused:
            MjpegUrl(url)
        assert "hidden" not in str(refused.value)


def with_length(length):
    """A picture whose stated length is another."""
    return part(RED).replace(f": {len(RED)}".encode(), b": " + length)


FAULTS = {
    "a length beyond reason": with_length(b"67000000"),
    "the same, and no line's end after it": with_length(b"67000000")[:-2],
    "a length of thousands of digits": with_length(b"9" * 5000),
    "a length of nothing": with_length(b"0"),
    "a header without its end": b"--frame\r\nContent-Type: image/jpeg\r\n",
    "a header that goes on": b"--frame\r\n" + b"X-Filler: a\r\n" * 100,
    "a boundary alone": b"--frame\r\n" * 3,
}


@pytest.mark.parametrize("line_end", [b"\r\n", b"\n", b""], ids=["lines", "short lines", "no lines"])
@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS)
def test_a_fault_costs_one_picture(fault, line_end):
    """The one after it arrives, whatever the server writes between its pictures."""
    splitter, green = PartSplitter("frame"), part(GREEN)[:-2] + line_end
    found = splitter.feed(part(BLUE)[:-2] + line_end) + splitter.feed(fault)
    for _ in range(3):
        found += splitter.feed(green)
    assert found[0] == BLUE
    assert found[-2:] == [GREEN, GREEN]


JUNK = [b"x" * 100, 0.02] * 200
STALLS = {
    "bytes that are no pictures": (HEADER, part(RED), JUNK),
    "one picture that never ends": (HEADER, part(RED), [part(RED, False)[:-40], *JUNK]),
    "a size line that never ends": (CHUNKED, b"%x\r\n" % len(part(RED)) + part(RED), [b"0" * 9, 0.02] * 200),
}


@pytest.mark.parametrize(("header", "first", "pieces"), STALLS.values(), ids=STALLS)
def test_a_camera_that_sends_no_pictures_is_lost_though_it_sends(monkeypatch, header, first, pieces):
    for limit in ("PICTURE_S", "STALL_S"):
        monkeypatch.setattr(f"gelform.sensors.mjpeg.{limit}", 0.3)
    with pytest.raises(SourceLostError, match=r"no whole picture|torn data|sizes of chunks"):
        taken([first, 0.1, *pieces], 2, header)


def test_a_stream_whose_parts_are_no_pictures_is_no_camera(monkeypatch):
    monkeypatch.setattr("gelform.sensors.mjpeg.OPEN_S", 0.3)
    text = [b"--frame\r\nContent-Length: 4\r\n\r\ntext\r\n", 0.02] * 100
    said = r"answers, but sent no JPEG picture within 0\.3 s"
    with MjpegServer(text, HEADER) as server, pytest.raises(SensorError, match=said):
        MjpegUrl(server.url)


def test_an_answer_that_comes_byte_by_byte_ends_also_where_its_end_resets_the_connection(monkeypatch):
    drip = [piece for one in b"HTTP/1.1 200 OK\r\nX: " + b"a" * 400 for piece in (bytes([one]), 0.02)]
    with MjpegServer(drip, b"") as server, pytest.raises(SensorError, match="did not finish its answer"):
        HttpBody(server.url, 0.15)

    for problem, said in (
        (SensorError("Connection reset by peer."), "did not finish its answer"),
        (KeyboardInterrupt("meant for the program"), "meant for the program"),
    ):

        def late(*_, problem=problem):
            time.sleep(0.12)
            raise problem

        monkeypatch.setattr("gelform.sensors.mjpeg._answer_to", late)
        with MjpegServer([]) as server, pytest.raises(type(problem), match=said):
            HttpBody(server.url, 0.05)
