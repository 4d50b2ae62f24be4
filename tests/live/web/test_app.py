"""Access to the server: hosts, origins, tokens.

Requests to the running server: the page's files, headers, hosts, origins, the token, floods of bytes.

Where the server listens: ports, hosts, tokens, and the error if it cannot.

Connections that say nothing, half of a request, or bytes that are no text: nobody else waits for them.
"""

import contextlib
import json
import logging
import os
import re
import socket
import sys
import time
from pathlib import Path

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from websockets.exceptions import ConnectionClosed

from gelform.calibration.guide import GuidedCalibration
from gelform.errors import GelformError
from gelform.live import actions
from gelform.live.hub import Hub
from gelform.live.lists import Recordings
from gelform.live.web.app import HEADERS, MAX_BODY, Access, page_files, split_host
from gelform.live.web.connections import REQUEST_S
from gelform.live.web.server import MAX_CONNECTIONS, check_extra, is_loopback, listen


def test_hosts_of_a_server():
    own, access = Access(8765), Access(80, ["robot"], token="t", any_address=True)
    for host in ("127.0.0.1:8765", "localhost:8765", "LOCALHOST:8765", "[::1]:8765"):
        assert own.host_allowed(host), host
    others = "127.0.0.1:8766 127.0.0.1 evil.example:8765 127.0.0.1.evil.example:8765 127.0.0.2:8765"
    for host in (*others.split(), "", ":8765", "[::1]", "localhost:8765:8765", "localhost:08765x"):
        assert not own.host_allowed(host), host
    assert access.host_allowed("192.168.1.7:80"), "a server for all takes addresses"
    assert access.host_allowed("robot")
    assert not access.host_allowed("evil.example"), "but no unknown names"


def test_the_token_is_wanted_whole():
    access = Access(1, token="secret")
    assert access.token_allowed("secret")
    assert access.cookie_allowed("other=1; gelform_1=secret")
    for cookie in ("", "gelform_1=", "gelform_1=secre", "gelform_1=secrets", "gelform_2=secret", "\0=;;;"):
        assert not access.cookie_allowed(cookie)


@given(st.text(max_size=40))
def test_any_text_can_be_a_host_or_a_cookie(text):
    name, port = split_host(text)
    assert isinstance(name, str)
    assert -1 <= port <= 99999
    assert not Access(99999 + 1, token="t").host_allowed(text)
    assert not Access(1, token="never guessed").cookie_allowed(text)


@pytest.fixture
def running(serving_of):
    """A server of a hub without stations."""
    return serving_of(Hub())


@pytest.fixture
def guarded(serving_of):
    """The same with a token."""
    return serving_of(Hub(), token=True)


def test_the_page_weighs_little_and_names_no_other_host():
    files = page_files()
    assert sum(map(len, files.values())) < 300_000
    text = b"\n".join(files.values()).decode()
    assert set(re.findall(r"https?://[\w.]+", text)) == {"http://www.w3.org"}  # a name, fetched by nobody
    assert not re.search(r"""["'(]//\w""", text)


def test_files_come_with_their_type_and_the_headers(running):
    with httpx.Client(base_url=running.url) as client:
        for path in page_files():
            answer = client.get(path)
            assert answer.status_code == 200
            assert has_headers(answer)
            assert "server" not in answer.headers
        assert client.get("/js/main.js").headers["content-type"].startswith("text/javascript")


def has_headers(answer):
    return all(answer.headers[name.decode()] == value.decode() for name, value in HEADERS.items())


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes")
def test_a_recording_with_an_odd_name_is_downloaded(serving, hub, tmp_path):
    for name in (b"a\nb.mcap", b"no\xfftext.mcap"):
        Path(os.fsdecode(os.fsencode(tmp_path) + b"/" + name)).write_bytes(b"content")
    (tmp_path / "self.mcap").symlink_to(tmp_path / "self.mcap")
    hub.recordings = Recordings((), tmp_path)
    with httpx.Client(base_url=serving().url) as client:
        for number in (0, 1):
            answer = client.get(f"/recordings/{number}")
            assert (answer.status_code, answer.content) == (200, b"content")
        assert client.get("/recordings/2").status_code == 404


def test_the_report_of_a_guide_comes_with_a_policy_of_its_own(serving, hub, station, tmp_path):
    with httpx.Client(base_url=serving().url) as client:
        assert client.get("/reports/0").status_code == 404
        actions.guide_start(hub, station, 5.0, "", 0.0)
        assert client.get("/reports/0").status_code == 404
        (tmp_path / "report.html").write_text("<html>the report")
        hub.guides[0].guide.made = GuidedCalibration(None, tmp_path, {}, None, ())
        answer = client.get("/reports/0")
        assert (answer.status_code, answer.text) == (200, "<html>the report")
        (policy,) = answer.headers.get_list("content-security-policy")
        assert "default-src 'none'; style-src 'unsafe-inline'; img-src data:" in policy
        assert answer.headers["x-frame-options"] == "DENY"
        for path in ("/reports/1", "/reports/-1", "/reports/0/report.html", "/reports/" + "0" * 40):
            assert client.get(path).status_code == 404


def test_other_pages_and_names_are_refused(running):
    others = f"http://evil.example null https://{running.address} {running.url}.evil.example http://localhost"
    link = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"}
    for headers, status in (
        ({}, 200),
        (link, 200),
        ({"host": "evil.example"}, 421),
        ({"host": "127.0.0.1"}, 421),
        ({"origin": running.url}, 200),
        *(({"origin": origin}, 403) for origin in others.split()),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site", "sec-fetch-mode": "no-cors"}, 403),
    ):
        answer = httpx.get(running.url + "/", headers=headers)
        assert answer.status_code == status, headers
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert status == 200 or b"gelform" not in answer.content


PARTS = st.sampled_from(["..", "%2e%2e", ".", "js", "page", "etc", "passwd", "%00", "\\", "app.py", "~"])


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(PARTS, min_size=1, max_size=6))
def test_no_path_leads_out_of_the_page(running, parts):
    request = f"GET /{'/'.join(parts)} HTTP/1.1\r\nHost: {running.address}\r\nConnection: close\r\n\r\n"
    answer = answer_to(running, request.encode())
    status = int(answer.split(b" ")[1])
    assert status in (307, 400, 404, 405) or b"Host" in answer
    assert b"root:" not in answer
    assert b"Traceback" not in answer
    assert b"/work" not in answer


def answer_to(running, sent):
    """What the server answers to bytes."""
    answer = b""
    with connected(running) as connection, contextlib.suppress(ConnectionError):
        connection.sendall(sent)
        connection.shutdown(socket.SHUT_WR)
        while chunk := connection.recv(65536):
            answer += chunk
    return answer


def connected(running):
    host, port = running.address.split(":")
    return socket.create_connection((host, int(port)), timeout=10)


def test_the_token_is_wanted_and_changed_for_a_cookie_and_never_logged(serving, caplog, capfd):
    running = serving(token=True)
    token = running.server.token
    assert len(token) >= 40
    assert running.server.url.endswith(f"#token={token}")
    with httpx.Client(base_url=running.url) as client:
        assert client.get("/").status_code == 200  # the page itself holds nothing
        assert client.get("/snapshots/1/frame.png").status_code == 401
        for wrong in ("", token[:-1], token + "x", "x" * len(token), "é"):
            assert client.post("/session", content=wrong.encode()).status_code == 401
        assert not client.cookies
        answer = client.post("/session", content=token)
        assert answer.status_code == 204
        cookie = answer.headers["set-cookie"].lower()
        assert "httponly" in cookie
        assert "samesite=strict" in cookie
        assert client.get("/snapshots/1/frame.png").status_code == 404
    assert token not in caplog.text + "".join(capfd.readouterr())


TORN = {
    "zeros": b"\x00" * 300,
    "a long header": b"GET / HTTP/1.1\r\n" + b"a" * 40_000,
    "two hosts": b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    "a word": b"GET",
    "half a body": b"POST /session HTTP/1.1\r\nContent-Length: 5\r\n\r\nab",
}


def test_torn_and_oversized_requests_leave_the_server_alive(guarded):
    large = httpx.post(guarded.url + "/session", content=b"x" * (MAX_BODY * 50))
    assert large.status_code == 401
    for name, sent in TORN.items():
        answer_to(guarded, sent)
        assert httpx.get(guarded.url + "/").status_code == 200, name


def test_a_snapshot_is_fetched_under_the_servers_own_name(serving, hub, station):
    number, url = actions.snapshot(hub, station)["number"], serving().url
    answer = httpx.get(f"{url}/snapshots/{number}/frame.png")
    assert answer.content.startswith(b"\x89PNG")
    assert answer.headers["content-disposition"] == f'attachment; filename="gelform-{number:03d}-frame.png"'
    assert httpx.get(f"{url}/snapshots/{number}/..%2Fframe.png").status_code == 404


def test_recordings_are_fetched_by_their_place_in_the_list_alone(serving, hub, tmp_path):
    file = tmp_path / "session.mcap"
    file.write_bytes(b"recorded")
    (tmp_path / "secret.txt").write_bytes(b"secret")
    hub.recordings.add(tmp_path)
    hub.recordings.add(file)
    assert httpx.get(f"{serving(token=True).url}/recordings/1").status_code == 401
    url = serving().url
    answer = httpx.get(f"{url}/recordings/1")
    assert answer.content == b"recorded"
    assert answer.headers["content-disposition"] == 'attachment; filename="session.mcap"'
    assert answer.headers["cache-control"] == "no-store"
    assert has_headers(answer)
    assert httpx.get(f"{url}/recordings/1", headers={"origin": "http://evil.example"}).status_code == 403
    file.unlink()
    for path in ("0", "1", "2", "-1", "1e9", "9" * 20, "session.mcap", "..%2fsecret.txt", "1/../1"):
        gone = httpx.get(f"{url}/recordings/{path}")
        assert gone.status_code == 404, path
        assert str(tmp_path) not in gone.text


def test_beyond_this_machine_there_is_a_token_of_its_own():
    with contextlib.closing(listen(port=0)) as server:
        assert server.token is None
        assert server.url.startswith("http://127.0.0.1:")
    tokens = set()
    for _ in range(2):
        with contextlib.closing(listen("0.0.0.0", 0)) as server:
            tokens.add(server.token)
            assert f"#token={server.token}" in server.url
    assert len(tokens) == 2
    assert all(len(token) >= 40 for token in tokens)
    with pytest.raises(GelformError, match="address of this machine"):
        listen("203.0.113.7", 0)
    hosts = ("127.0.0.1", "::1", "localhost", "0.0.0.0", "10.0.0.3", "robot")
    assert list(map(is_loopback, hosts)) == [True] * 3 + [False] * 3


def test_a_port_in_use_is_said_where_it_was_asked_for_and_passed_over_where_not():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(GelformError, match=f"Port {port} is in use.*--port {port + 1}"):
            listen(port=port)
    first, second = listen(), listen()
    assert first.address != second.address
    first.close()
    second.close()


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(GelformError, match=r"needs the extra live: .*gelform\[live\]"):
        check_extra()


HALVES = {
    "nothing": b"",
    "half a header": b"GET / HTTP/1.1\r\nHost: a",
    "half a body": b"POST /session HTTP/1.1\r\nHost: HERE\r\nContent-Length: 43\r\n\r\nabc",
    "half a second request": b"GET /js/main.js HTTP/1.1\r\nHost: HERE\r\n\r\nGET / HTTP/1.1\r\nHo",
}


def test_many_silent_connections_keep_nobody_out(guarded):
    with contextlib.ExitStack() as held:
        for _ in range(MAX_CONNECTIONS + 12):
            held.enter_context(connected(guarded))
        for _ in range(3):
            assert httpx.get(guarded.url + "/").status_code == 200
            assert httpx.post(guarded.url + "/session", content=guarded.server.token).status_code == 204


@pytest.mark.slow
def test_connections_without_a_whole_request_end(guarded):
    with contextlib.ExitStack() as held:
        silent = {what: held.enter_context(connected(guarded)) for what in HALVES}
        for what, sent in HALVES.items():
            silent[what].sendall(sent.replace(b"HERE", guarded.address.encode()))
        for one in silent.values():
            with contextlib.suppress(ConnectionError):
                while one.recv(65536):
                    pass  # ended by the server: reading on would have raised a timeout after 10 s
    assert httpx.get(guarded.url + "/").status_code == 200


@pytest.mark.slow
def test_a_page_that_only_listens_stays(running):
    with running.opened() as page:
        until_s = time.monotonic() + REQUEST_S + 1
        while time.monotonic() < until_s:
            assert json.loads(page.recv(timeout=5))["kind"] == "state"


def test_numbers_beyond_reason_are_no_file(guarded, caplog):
    large = "9" * 5000
    with httpx.Client(base_url=guarded.url) as client:
        client.post("/session", content=guarded.server.token)
        for path in (f"recordings/{large}", f"snapshots/{large}/frame.png", "recordings/\u0664"):
            assert client.get("/" + path).status_code == 404
    assert not [one for one in caplog.records if one.exc_info]


ODD = {
    "invalid UTF-8": b"\xff\xfe{}",
    "a ping at infinity": b'{"do": "ping", "sent": 1e999}',
    "a ping beyond a float": b'{"do": "ping", "sent": 1' + b"0" * 400 + b"}",
    "a number beyond a float": b'{"do": "speed", "station": 0, "speed": 1' + b"0" * 400 + b"}",
    "a number at infinity": b'{"do": "speed", "station": 0, "speed": -1e999}',
}


@pytest.mark.parametrize("sent", ODD.values(), ids=ODD)
def test_odd_messages_are_answered_without_a_traceback(running, caplog, sent):
    caplog.set_level(logging.INFO)
    with running.opened() as page:
        with page.send_context():
            page.protocol.send_text(sent)
        with contextlib.suppress(ConnectionClosed):
            for _ in range(100):
                page.recv(timeout=5)
    assert page.protocol.close_rcvd.code == 1008
    assert not [one for one in caplog.records if one.exc_info or "Traceback" in one.getMessage()]
