"""Who may talk to the server: hosts, origins, tokens."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gelform.live.web.guard import Access, split_host


@pytest.mark.parametrize(
    ("host", "allowed"),
    [
        ("127.0.0.1:8765", True),
        ("localhost:8765", True),
        ("LOCALHOST:8765", True),
        ("[::1]:8765", True),
        ("127.0.0.1:8766", False),
        ("127.0.0.1", False),
        ("evil.example:8765", False),
        ("127.0.0.1.evil.example:8765", False),
        ("127.0.0.2:8765", False),
        ("", False),
        (":8765", False),
        ("[::1]", False),
        ("localhost:8765:8765", False),
        ("localhost:08765x", False),
    ],
)
def test_hosts_of_a_server_on_this_machine(host, allowed):
    assert Access(8765).host_allowed(host) is allowed


def test_a_server_for_all_takes_addresses_but_no_unknown_names():
    access = Access(80, ["robot"], token="t", any_address=True)
    assert access.host_allowed("192.168.1.7:80")
    assert access.host_allowed("robot")
    assert not access.host_allowed("evil.example")


@pytest.mark.parametrize(
    ("origin", "allowed"),
    [
        ("http://localhost:8765", True),
        ("http://127.0.0.1:8765", False),
        ("https://localhost:8765", False),
        ("http://evil.example", False),
        ("null", False),
        ("http://localhost:8765.evil.example", False),
    ],
)
def test_origins_are_the_page_under_the_same_host(origin, allowed):
    assert Access(8765).origin_allowed(origin, "localhost:8765") is allowed


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
