"""The whole guided calibration in a real browser: from the ball to a calibration in use, with suggested presses.

From an uncalibrated sensor to depth in mm, in a real browser: one button, and a banner that stays.
"""

import contextlib

import numpy as np
import pytest

import gelform
from gelform.calibration.guide import LEAST
from gelform.calibration.starters import load_starter
from gelform.live.actions import start
from gelform.live.station import Setup
from live_waiting import held, until

pytestmark = pytest.mark.slow

YELLOW = np.array([255, 209, 102])  # of the circle where to press


def yellow_pixels(image):
    """How many pixels (H, W, 3), BGR, have the color of the target."""
    return int((np.abs(image[..., ::-1].astype(int) - YELLOW).max(axis=-1) < 30).sum())


def count(page):
    return page.evaluate("gelform.facts.guides[0]?.count ?? 0")


def test_the_guide_leads_from_the_ball_to_a_calibration_in_use(
    visit, hub, station, tmp_path, library, picture
):
    """The simulated sensor is pressed by the guide; what was made reads the depth of a press that it has not seen."""
    hub.folder = tmp_path
    page = visit()
    page.click("#tab-calibrate")
    page.fill("#ball", "5")
    page.click("#guide-start")
    until(lambda: page.evaluate("Boolean(gelform.facts.guides[0]?.places.length)"))
    until(lambda: yellow_pixels(picture(page, "#guide-pane .shown")) > 50)
    until(lambda: page.inner_text("#steps .now") == "Press")
    fit = "document.getElementById('guide-fit').disabled === !gelform.facts.guides[0].can_fit"
    until(lambda: page.evaluate(fit))  # facts come before they are drawn
    until(lambda: count(page) >= LEAST)
    until(lambda: page.evaluate(fit))
    page.click("#guide-fit")
    until(lambda: page.inner_text("#steps .now") == "Fit")
    until(lambda: page.is_visible("#verdict"))
    until(lambda: page.locator(".checks tr").count() > 3)
    until(lambda: yellow_pixels(picture(page, "#guide-pane .shown")) > 50)  # the places that the report names
    assert not list(library.glob("*"))
    with page.expect_popup() as opened:
        page.click("#guide-report")
    with contextlib.closing(opened.value) as report:
        report.wait_for_load_state()
        assert page.inner_text("#verdict") in report.inner_text("body")
        assert report.evaluate("document.styleSheets.length") == 1, "its own style is not refused"
        assert report.evaluate("[...document.images].every((image) => image.naturalWidth > 0)")
    page.click("#guide-more")
    until(lambda: page.inner_text("#steps .now") == "Press")
    before = count(page)
    level = "gelform.facts.guides[0].coverage.level"
    until(lambda: page.inner_text("#coverage-level") == page.evaluate(level))
    until(lambda: count(page) > before)
    until(lambda: page.evaluate(fit))
    page.click("#guide-fit")
    until(lambda: page.is_visible("#verdict"))
    page.click("#guide-use")
    until(lambda: page.is_visible("#page-live"))
    (kept,) = library.iterdir()
    until(lambda: page.evaluate("gelform.facts.stations[0].calibration") == kept.name)
    saved = max(tmp_path.glob("calibration-*/calibration.npz"))
    assert station.setup.calibration.digest == gelform.load_calibration(saved).digest
    until(lambda: not hub.guides)
    pressed = held(station, 100, 70, 0.45)
    # By the fewest presses that can be fitted.
    assert pressed.numbers.peak == pytest.approx(0.45, abs=0.2)
    until(lambda: page.evaluate("gelform.frame.header.serial") >= pressed.serial)
    assert page.evaluate("gelform.frame.header.peak") == pytest.approx(pressed.numbers.peak, abs=0.1)


MAKE = "simulated-three-edges"


@pytest.fixture
def uncalibrated():
    """A hub with a simulated sensor that only a starter knows."""
    hub = start(rate_hz=20, sensor=MAKE)
    yield hub
    hub.close()


def test_one_button_gives_depth_and_a_banner_that_stays(visit, serving_of, uncalibrated, calibration):
    page = visit(serving_of(uncalibrated).url)
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
    uncalibrated.end_guide(uncalibrated.stations[0])
    uncalibrated.stations[0].setup = Setup(calibration, "mine")
    until(lambda: not page.is_visible("#starter"))


def test_a_sensor_that_is_not_known_is_chosen_and_a_wrong_one_is_said(visit, serving_of, uncalibrated):
    uncalibrated.stations[0].sensor = ""
    page = visit(serving_of(uncalibrated).url)
    until(lambda: page.is_visible("#starter-sensor"))
    until(lambda: page.is_disabled("#starter-take"))
    page.select_option("#starter-sensor", "gelsight-mini")
    page.click("#starter-take")
    until(lambda: "background of a GelSight Mini" in page.inner_text("#starter ul"))
    page.select_option("#starter-sensor", MAKE)
    page.click("#starter-take")
    until(lambda: page.is_visible("#starter-calibrate"))
