"""The hub: facts for the page, notices, long work and its end, frames on request."""

import json
import threading
import time

import numpy as np
import pytest

from gelform.errors import DataError, GelformError, SensorError, SourceLostError
from gelform.live.hub import GRACE_S, Hub, Pages, page_named, sentence_for_page, wait_for_frames
from gelform.live.station import Station
from live_waiting import until
from made.sources import ImageSource


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


def test_work_that_fails_as_nobody_expected_ends_too(hub, caplog):
    hub.start(lambda _: {}["there is none"], 0, "starting")
    until(lambda: not hub.facts()["work"])
    assert hub.notices[-1][1] == "error"
    assert "mistake in gelform, not yours: KeyError: 'there is none'" in hub.notices[-1][2]
    assert caplog.records[-1].exc_info[0] is KeyError


def test_a_sentence_about_a_file_names_it(tmp_path, caplog):
    with pytest.raises(OSError) as problem:
        (tmp_path / "none").read_text()
    assert sentence_for_page(problem.value) == f"No such file or directory: {tmp_path / 'none'}."
    assert not caplog.records


def test_frames_that_do_not_come_are_an_error(hub):
    station, began_s = hub.stations[0], time.monotonic()
    with pytest.raises(GelformError, match=r"Expected 5000 frames within 0\.2 s"):
        wait_for_frames(station, 5000, timeout_s=0.2)
    station.pause(True)
    with pytest.raises(GelformError, match=r"picture is held\. Press Continue first"):
        wait_for_frames(station, 1)
    station.pause(False)
    until(lambda: not station.silence)
    station.close()
    with pytest.raises(GelformError, match="server is stopping"):
        wait_for_frames(station, 1)
    assert not station.taps
    assert time.monotonic() - began_s < 15


def test_a_sensor_that_was_unplugged_is_named_at_once(hub):
    """Also while its frames are awaited."""
    images = [np.full((48, 64, 3), 90, np.uint8)]
    gone = threading.Event()

    def opened():
        if gone.is_set():
            raise SensorError("No camera.")
        return ImageSource(images, count=20, fails=SourceLostError("It was unplugged."))

    station = Station(1, "camera", opened, hub.changed)
    hub.stations.append(station)
    station.start()
    try:
        until(lambda: station.newest)
        gone.set()
        for _ in range(2):
            with pytest.raises(GelformError, match=r"gives no frames: (It was unplugged|No camera)"):
                wait_for_frames(station, 5000)
    finally:
        station.close()


def test_one_action_at_a_time_changes_a_sensor(hub):
    with hub.turn(0), pytest.raises(GelformError, match="This sensor is busy"), hub.turn(0):
        pass
    with hub.turn(0), pytest.raises(GelformError, match="no sensor 1"), hub.turn(1):
        pass


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
