"""From an uncalibrated sensor to depth in mm, in a real browser: one button, and a banner that stays."""

import pytest

from gelform.calibration.starters import load_starter
from gelform.live.start import Options, start
from live_waiting import until

pytestmark = pytest.mark.slow
MAKE = "simulated-three-edges"


@pytest.fixture
def started():
    hubs = []

    def of(sensor=MAKE):
        hubs.append(start(Options(rate_hz=20, sensor=sensor)))
        return hubs[-1]

    yield of
    for hub in hubs:
        hub.close()


def test_one_button_gives_depth_and_a_banner_that_stays(visit, serving_of, started, calibration):
    hub = started()
    page = visit(serving_of(hub).url)
    until(lambda: page.is_visible("#starter-take"))
    until(lambda: f"This {MAKE} has no calibration" in page.inner_text("#starter"))
    until(lambda: "Take the background" in page.inner_text("#stages .empty"))
    page.click("#starter-take")
    until(lambda: page.is_visible("#starter-calibrate"))
    until(lambda: page.evaluate("Boolean(gelform.frame.has('depth')) && gelform.frame.unit === 'mm'"))
    off = f"off by {100 * load_starter(MAKE).spread:.0f} %"
    until(lambda: off in page.inner_text("#starter"))
    page.click("#starter-calibrate")
    until(lambda: not page.is_visible("#starter-calibrate"))
    until(lambda: page.is_visible("#guide-start"))
    until(lambda: "The starter knows the scale" in page.inner_text("#guide-body"))
    page.fill("#ball", "5")
    page.click("#guide-start")
    until(lambda: page.evaluate("gelform.facts.guides[0]?.step === 'press'"))
    hub.end_guide(0)
    hub.stations[0].setup = hub.stations[0].setup.with_calibration(calibration, "mine")
    until(lambda: not page.is_visible("#starter"))


def test_a_sensor_that_is_not_known_is_chosen_and_a_wrong_one_is_said(visit, serving_of, started):
    hub = started()
    hub.stations[0].sensor = ""
    page = visit(serving_of(hub).url)
    until(lambda: page.is_visible("#starter-sensor"))
    until(lambda: page.is_disabled("#starter-take"))
    page.select_option("#starter-sensor", "gelsight-mini")
    page.click("#starter-take")
    until(lambda: "background of a GelSight Mini" in page.inner_text("#starter ul"))
    page.select_option("#starter-sensor", MAKE)
    page.click("#starter-take")
    until(lambda: page.is_visible("#starter-calibrate"))
