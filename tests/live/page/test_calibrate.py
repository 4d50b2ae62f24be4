"""The whole guided calibration in a real browser: from the ball to a calibration in use, with suggested presses."""

import contextlib

import numpy as np
import pytest

import gelform
from gelform.calibration.guided.guide import LEAST
from live_waiting import held, until

pytestmark = pytest.mark.slow

YELLOW = np.array([255, 209, 102])  # of the circle where to press


def yellow_pixels(image):
    """How many pixels (H, W, 3), BGR, have the color of the target."""
    return int((np.abs(image[..., ::-1].astype(int) - YELLOW).max(axis=-1) < 30).sum())


def count(page):
    return page.evaluate("gelform.facts.guides[0]?.count ?? 0")


def test_the_guide_leads_from_the_ball_to_a_calibration_in_use(visit, hub, tmp_path, library, picture):
    """The simulated sensor is pressed by the guide; what was made reads the depth of a press that it has not seen."""
    hub.folder, station = tmp_path, hub.stations[0]
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
    until(
        lambda: page.inner_text("#coverage-level") == page.evaluate("gelform.facts.guides[0].coverage.level")
    )
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
