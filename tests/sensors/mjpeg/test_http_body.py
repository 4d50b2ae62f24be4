"""The body of an HTTP answer as it arrives, and answers that are none."""

import socket
import time

import pytest

from gelform.errors import SensorError, SourceLostError
from gelform.sensors.mjpeg.http_body import Dechunker, HttpBody
from made.mjpeg_server import HEADER, MjpegServer

CHUNKED = HEADER.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n")


def body_of(pieces, header=HEADER, url=lambda url: url):
    with MjpegServer(pieces, header) as server:
        body = HttpBody(url(server.url), 2.0)
        read = b""
        while data := body.read(2.0):
            read += data
        body.close()
    return read, server.requests[0].decode()


def test_the_body_is_what_was_sent():
    read, request = body_of([b"one", 0.02, b"two", None])
    assert read == b"onetwo"
    assert request.startswith("GET /stream HTTP/1.1\r\nHost: 127.0.0.1:")


def test_chunks_are_taken_apart():
    read, _ = body_of([b"3\r\none\r\n", 0.02, b"8;x=1\r\ntwo", 0.02, b"three\r\n", b"0\r\n\r\n"], CHUNKED)
    assert read == b"onetwothree"


@pytest.mark.parametrize("size", [1, 2, 5, 100])
def test_chunks_may_be_cut_anywhere(size):
    sent = b"3\r\none\r\nA\r\n0123456789\r\n0\r\n\r\n"
    dechunk = Dechunker()
    assert (
        b"".join(dechunk.feed(sent[at : at + size]) for at in range(0, len(sent), size)) == b"one0123456789"
    )
    assert dechunk.ended


def test_torn_chunks_are_a_lost_source():
    with pytest.raises(SourceLostError, match="torn"):
        Dechunker().feed(b"\xff\xd8zz\r\n")


def test_user_and_password_go_into_the_header():
    _, request = body_of([None], url=lambda url: url.replace("//", "//eve:p%40ss@") + "?a=1")
    assert "Authorization: Basic ZXZlOnBAc3M=" in request
    assert "GET /stream?a=1 " in request
    assert "Host: 127.0.0.1:" in request


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (b"HTTP/1.1 401 Unauthorized\r\n\r\n", "user and password"),
        (b"HTTP/1.1 404 Not Found\r\n\r\n", "404 Not Found. Check the path"),
        (b"HTTP/1.1 302 Found\r\nLocation: http://x/y\r\n\r\n", "http://x/y"),
        (b"SSH-2.0-OpenSSH\r\n\r\n", "does not speak HTTP"),
    ],
)
def test_other_answers_say_what_to_do(answer, says):
    with MjpegServer([], answer) as server, pytest.raises(SensorError, match=says):
        HttpBody(server.url, 2.0)


def test_a_closed_port_and_a_wrong_address_say_so():
    with MjpegServer([]) as server:
        url = server.url
    with pytest.raises(SensorError, match=r"Nothing answers at 127\.0\.0\.1"):
        HttpBody(url, 2.0)
    for wrong in ("http:///x", "http://host:port/"):
        with pytest.raises(SensorError, match="Expected an address"):
            HttpBody(wrong, 2.0)


def test_a_connection_to_itself_is_no_server(monkeypatch):
    """Of many attempts at a port that nobody has, one may get that port as its own end."""
    with socket.socket() as own:
        own.bind(("127.0.0.1", 0))
        own.connect(own.getsockname())
        url = f"http://127.0.0.1:{own.getsockname()[1]}/"
        monkeypatch.setattr(socket, "create_connection", lambda *_: own)
        with pytest.raises(SensorError, match="nobody listens"):
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
