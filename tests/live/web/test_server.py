"""Where the server listens: ports, hosts, tokens, and the error if it cannot."""

import socket
import sys
from contextlib import closing

import pytest

from gelform.errors import GelformError
from gelform.live.web.server import check_extra, is_loopback, listen


def test_beyond_this_machine_there_is_a_token_of_its_own():
    with closing(listen(port=0)) as server:
        assert server.token is None
        assert server.url.startswith("http://127.0.0.1:")
    tokens = set()
    for _ in range(2):
        with closing(listen("0.0.0.0", 0)) as server:
            tokens.add(server.token)
            assert f"#token={server.token}" in server.url
    assert len(tokens) == 2
    assert all(len(token) >= 40 for token in tokens)


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


def test_which_hosts_are_this_machine_alone():
    for host in ("127.0.0.1", "::1", "localhost"):
        assert is_loopback(host)
    for host in ("0.0.0.0", "10.0.0.3", "robot"):
        assert not is_loopback(host)
    with pytest.raises(GelformError, match="address of this machine"):
        listen("203.0.113.7", 0)


def test_without_the_extra_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    with pytest.raises(GelformError, match=r"needs the extra live: .*gelform\[live\]"):
        check_extra()
