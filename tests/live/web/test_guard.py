"""Access to the server: hosts, origins, tokens."""

from hypothesis import given
from hypothesis import strategies as st

from gelform.live.web.guard import Access, split_host


def test_hosts_of_a_server_on_this_machine():
    for host in ("127.0.0.1:8765", "localhost:8765", "LOCALHOST:8765", "[::1]:8765"):
        assert Access(8765).host_allowed(host), host
    others = "127.0.0.1:8766 127.0.0.1 evil.example:8765 127.0.0.1.evil.example:8765 127.0.0.2:8765"
    for host in (*others.split(), "", ":8765", "[::1]", "localhost:8765:8765", "localhost:08765x"):
        assert not Access(8765).host_allowed(host), host


def test_a_server_for_all_takes_addresses_but_no_unknown_names():
    access = Access(80, ["robot"], token="t", any_address=True)
    assert access.host_allowed("192.168.1.7:80")
    assert access.host_allowed("robot")
    assert not access.host_allowed("evil.example")


def test_origins_are_the_page_under_the_same_host():
    assert Access(8765).origin_allowed("http://localhost:8765", "localhost:8765")
    others = "http://127.0.0.1:8765 https://localhost:8765 http://evil.example null"
    for origin in (*others.split(), "http://localhost:8765.evil.example"):
        assert not Access(8765).origin_allowed(origin, "localhost:8765"), origin


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
