"""The hub: facts for the page, notices, long work and its end, frames on request."""

import json
import threading

import pytest

from gelform.errors import DataError, GelformError
from gelform.live.hub import GRACE_S, Hub, Pages, page_named, wait_for_frames
from live_waiting import until


def test_facts_can_be_sent_as_json(hub):
    facts = json.loads(json.dumps(hub.facts(), allow_nan=False))
    assert facts["stations"][0]["state"] == "running"
    assert facts["calibrations"] == ["mine"]
    assert "auto" in facts["solvers"]
    hub.notice("first\nline")
    facts = hub.facts()
    assert facts["notices"] == [[1, "info", "first line"]]
    assert hub.facts(notices_after=1)["notices"] == []


def test_pages_and_sinks_want_every_result():
    hub = Hub()
    assert not hub.watched()
    hub.pages.came("page-one")
    assert hub.watched()
    hub.pages.left("page-one")
    assert not hub.watched()
    hub.sinks = 1
    assert hub.watched()


def test_work_shows_its_progress_and_its_failure(hub):
    go_on = threading.Event()

    def work(progress):
        progress(1, 4, "pressing")
        go_on.wait(5)
        raise DataError("The disk is full.")

    hub.start(work, 0, "starting")
    until(lambda: hub.facts()["work"].get(0) == ["pressing", 1, 4])
    with pytest.raises(GelformError, match="busy"):
        hub.start(work, 0, "again")
    go_on.set()
    until(lambda: not hub.facts()["work"])
    assert hub.notices[-1][1:] == ("error", "The disk is full.")


def test_frames_that_do_not_come_are_an_error(hub):
    hub.stations[0].paused = True
    with pytest.raises(GelformError, match="Is the camera connected"):
        wait_for_frames(hub.stations[0], 500, timeout_s=0.2)
    assert not hub.stations[0].taps


def test_there_is_no_station_of_another_number(hub):
    for number in (-1, 1):
        with pytest.raises(GelformError):
            hub.station(number)


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
