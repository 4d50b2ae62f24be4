"""The hub: facts for the page, notices, long work and its end, frames on request."""

import json
import threading

import pytest

from gelform.errors import DataError, GelformError
from gelform.live.hub import Hub, wait_for_frames
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
