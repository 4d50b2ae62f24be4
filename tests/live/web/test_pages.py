"""The open pages: by name, over several connections, and for a moment after the last one."""

from gelform.live.web.pages import GRACE_S, Pages, page_named


class Clock:
    now_s = 100.0

    def __call__(self):
        return self.now_s


def test_a_page_is_open_until_it_has_been_away_for_a_while():
    clock = Clock()
    pages = Pages(clock)
    assert not pages.is_open("page-one")
    pages.came("page-one")
    clock.now_s += 1000
    assert pages.is_open("page-one")
    assert pages.any_connected
    pages.left("page-one")
    assert not pages.any_connected
    clock.now_s += GRACE_S - 0.1
    assert pages.is_open("page-one")
    clock.now_s += 0.2
    assert not pages.is_open("page-one")


def test_a_page_that_was_loaded_anew_never_was_away():
    clock = Clock()
    pages = Pages(clock)
    pages.came("page-one")
    pages.came("page-one")  # the new connection may come before the old one's end is heard of
    pages.left("page-one")
    clock.now_s += 1000
    assert pages.is_open("page-one")
    pages.left("page-one")
    clock.now_s += 1
    pages.came("page-one")
    clock.now_s += 1000
    assert pages.is_open("page-one")


def test_what_is_no_name_is_nobodys():
    assert page_named("0123456789abcdef") == "0123456789abcdef"
    for given in ("", "short", "A" * 20, "../../../etc", "a" * 65):
        assert page_named(given) == ""
