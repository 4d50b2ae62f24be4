"""Requests to the running server: the page's files, headers, hosts, origins, the token, floods of bytes."""

import os
import re
import socket
import sys
from pathlib import Path

import httpx
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from gelform.calibration.guided.fit import GuidedCalibration
from gelform.live import actions
from gelform.live.lists import Recordings
from gelform.live.web.app import MAX_BODY, page_files
from gelform.live.web.guard import HEADERS

PARTS = ["..", "%2e%2e", ".", "js", "page", "etc", "passwd", "%00", "\\", "app.py", "~"]
TORN = [
    b"\x00" * 300,
    b"GET / HTTP/1.1\r\n" + b"a" * 40_000,
    b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n",
    b"GET",
    b"POST /session HTTP/1.1\r\nContent-Length: 5\r\n\r\nab",
]
OWN = {
    "same": {},
    "link": {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate", "sec-fetch-dest": "document"},
}


def test_the_page_weighs_little_and_names_no_other_host():
    files = page_files()
    assert sum(map(len, files.values())) < 300_000
    text = b"\n".join(files.values()).decode()
    assert set(re.findall(r"https?://[\w.]+", text)) == {"http://www.w3.org"}  # a name, fetched by nobody
    assert not re.search(r"""["'(]//\w""", text)


def test_files_come_with_their_type_and_the_headers(serving):
    with httpx.Client(base_url=serving().url) as client:
        for path in page_files():
            answer = client.get(path)
            assert answer.status_code == 200
            for name, value in HEADERS.items():
                assert answer.headers[name.decode()] == value.decode()
            assert "server" not in answer.headers
        assert client.get("/js/main.js").headers["content-type"].startswith("text/javascript")


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


def test_the_report_of_a_guide_comes_with_a_policy_of_its_own(serving, hub, tmp_path):
    with httpx.Client(base_url=serving().url) as client:
        assert client.get("/reports/0").status_code == 404
        actions.guide_start(hub, 0, 5.0, "", 0.0)
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


def test_other_pages_and_names_are_refused(serving):
    url = serving().url + "/"
    for headers, status in (
        (OWN["same"], 200),
        (OWN["link"], 200),
        ({"host": "evil.example"}, 421),
        ({"host": "127.0.0.1"}, 421),
        ({"origin": "http://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"sec-fetch-site": "cross-site"}, 403),
        ({"sec-fetch-site": "same-site", "sec-fetch-mode": "no-cors"}, 403),
    ):
        answer = httpx.get(url, headers=headers)
        assert answer.status_code == status, headers
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert status == 200 or b"gelform" not in answer.content


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.sampled_from(PARTS), min_size=1, max_size=6))
def test_no_path_leads_out_of_the_page(one_server, parts):
    request = f"GET /{'/'.join(parts)} HTTP/1.1\r\nHost: {one_server.address}\r\nConnection: close\r\n\r\n"
    answer = raw(one_server, request.encode())
    status = int(answer.split(b" ")[1])
    assert status in (307, 400, 404, 405) or b"Host" in answer
    assert b"root:" not in answer
    assert b"Traceback" not in answer
    assert b"/work" not in answer


@pytest.fixture
def one_server(serving):
    return serving()


def test_the_token_is_wanted_and_changed_for_a_cookie(serving):
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


def test_the_token_is_never_logged(serving, caplog, capfd):
    running = serving(token=True)
    httpx.post(running.url + "/session", content=running.server.token)
    httpx.get(running.url + "/nothing")
    assert running.server.token not in caplog.text + "".join(capfd.readouterr())


def test_a_large_body_is_refused_and_the_server_lives(serving):
    running = serving(token=True)
    assert httpx.post(running.url + "/session", content=b"x" * (MAX_BODY * 50)).status_code == 401
    assert httpx.get(running.url + "/").status_code == 200


def test_torn_and_oversized_requests_leave_the_server_alive(one_server):
    for sent in TORN:
        raw(one_server, sent)
        assert httpx.get(one_server.url + "/").status_code == 200, sent[:40]


def test_a_snapshot_is_fetched_under_the_servers_own_name(serving, hub):
    from gelform.live import actions

    number = actions.snapshot(hub, 0)["number"]
    answer = httpx.get(f"{serving().url}/snapshots/{number}/frame.png")
    assert answer.content.startswith(b"\x89PNG")
    assert answer.headers["content-disposition"] == f'attachment; filename="gelform-{number:03d}-frame.png"'
    assert httpx.get(f"{serving().url}/snapshots/{number}/..%2Fframe.png").status_code == 404


def test_recordings_are_fetched_by_their_place_in_the_list_alone(serving, hub, tmp_path):
    file = tmp_path / "session.mcap"
    file.write_bytes(b"recorded")
    (tmp_path / "secret.txt").write_bytes(b"secret")
    hub.recordings.add(tmp_path)
    hub.recordings.add(file)
    url = serving(token=True).url
    assert httpx.get(f"{url}/recordings/1").status_code == 401
    open_url = serving().url
    answer = httpx.get(f"{open_url}/recordings/1")
    assert answer.content == b"recorded"
    assert answer.headers["content-disposition"] == 'attachment; filename="session.mcap"'
    assert answer.headers["cache-control"] == "no-store"
    for name, value in HEADERS.items():
        assert answer.headers[name.decode()] == value.decode()
    assert httpx.get(f"{open_url}/recordings/1", headers={"origin": "http://evil.example"}).status_code == 403
    file.unlink()
    for path in ("0", "1", "2", "-1", "1e9", "9" * 20, "session.mcap", "..%2fsecret.txt", "1/../1"):
        gone = httpx.get(f"{open_url}/recordings/{path}")
        assert gone.status_code == 404, path
        assert str(tmp_path) not in gone.text


def raw(running, sent):
    """What the server answers to bytes."""
    host, port = running.address.split(":")
    with socket.create_connection((host, int(port)), timeout=5) as connection:
        connection.sendall(sent)
        connection.shutdown(socket.SHUT_WR)
        answer = b""
        try:
            while chunk := connection.recv(65536):
                answer += chunk
        except ConnectionError:
            pass
    return answer
