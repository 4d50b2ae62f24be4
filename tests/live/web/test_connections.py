"""Connections that say nothing, half of a request, or bytes that are no text: nobody else waits for them."""

import contextlib
import json
import logging
import socket
import time

import httpx
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from gelform.live.hub import Hub
from gelform.live.web.connections import REQUEST_S
from gelform.live.web.server import MAX_CONNECTIONS

HALVES = {
    "nothing": b"",
    "half a header": b"GET / HTTP/1.1\r\nHost: a",
    "half a body": b"POST /session HTTP/1.1\r\nHost: HERE\r\nContent-Length: 43\r\n\r\nabc",
    "half a second request": b"GET /js/main.js HTTP/1.1\r\nHost: HERE\r\n\r\nGET / HTTP/1.1\r\nHo",
}


@pytest.fixture
def empty(serving_of):
    return serving_of(Hub(), token=True)


def connected(running):
    host, port = running.address.split(":")
    return socket.create_connection((host, int(port)), timeout=10)


def test_many_silent_connections_keep_nobody_out(empty):
    with contextlib.ExitStack() as held:
        for _ in range(MAX_CONNECTIONS + 12):
            held.enter_context(connected(empty))
        for _ in range(3):
            assert httpx.get(empty.url + "/").status_code == 200
            assert httpx.post(empty.url + "/session", content=empty.server.token).status_code == 204


@pytest.mark.slow
@pytest.mark.parametrize("sent", HALVES.values(), ids=HALVES)
def test_a_connection_without_a_whole_request_ends(empty, sent):
    with connected(empty) as silent:
        silent.sendall(sent.replace(b"HERE", empty.address.encode()))
        with contextlib.suppress(ConnectionError):
            while silent.recv(65536):
                pass  # ended by the server: reading on would have raised a timeout after 10 s
    assert httpx.get(empty.url + "/").status_code == 200


@pytest.mark.slow
def test_a_page_that_only_listens_stays(serving_of):
    running = serving_of(Hub())
    with connect(f"ws://{running.address}/ws", origin=running.url, proxy=None) as page:
        until_s = time.monotonic() + REQUEST_S + 1
        while time.monotonic() < until_s:
            assert json.loads(page.recv(timeout=5))["kind"] == "state"


def test_numbers_beyond_reason_are_no_file(empty, caplog):
    with httpx.Client(base_url=empty.url) as client:
        client.post("/session", content=empty.server.token)
        for path in (
            "recordings/" + "9" * 5000,
            "snapshots/" + "9" * 5000 + "/frame.png",
            "recordings/\u0664",
        ):
            assert client.get("/" + path).status_code == 404
    assert not [one for one in caplog.records if one.exc_info]


ODD = {
    "invalid UTF-8": b"\xff\xfe{}",
    "a ping at infinity": b'{"do": "ping", "sent": 1e999}',
    "a ping beyond a float": b'{"do": "ping", "sent": 1' + b"0" * 400 + b"}",
    "a number beyond a float": b'{"do": "speed", "station": 0, "speed": 1' + b"0" * 400 + b"}",
    "a number at infinity": b'{"do": "speed", "station": 0, "speed": -1e999}',
}


def until_closed(page):
    for _ in range(100):
        page.recv(timeout=5)


@pytest.mark.parametrize("sent", ODD.values(), ids=ODD)
def test_odd_messages_are_answered_without_a_traceback(serving_of, caplog, sent):
    running = serving_of(Hub())
    caplog.set_level(logging.INFO)
    with connect(f"ws://{running.address}/ws", origin=running.url, proxy=None, close_timeout=1) as page:
        with page.send_context():
            page.protocol.send_text(sent)
        with pytest.raises(ConnectionClosed) as ended:
            until_closed(page)
    assert ended.value.rcvd.code == 1008
    assert not [one for one in caplog.records if one.exc_info or "Traceback" in one.getMessage()]
