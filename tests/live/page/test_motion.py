"""The motion on the page: off at first; then the path and the axes over the maps, and the numbers."""

import re

import numpy as np
import pytest

from gelform.sensors.simulated.source import Touch
from gelform.simulate import Pose, text_relief
from live_waiting import until

pytestmark = pytest.mark.slow

LETTERS = text_relief("gel", height_mm=5.0)
STEPS = 8


def touch(hub, step):
    """Hold the letters at a step of their way, and wait for it to be shown."""
    station = hub.stations[0]
    source = station.source
    held = Touch(LETTERS, Pose(0.35, (0.2 * step - 1, 0.1 * step - 0.5), spin_deg=0.7 * step))
    source._levels_now = lambda _: source._levels_of_touch(held)
    before = station.newest.serial
    until(lambda: station.newest.serial > before + 4)


def test_words_for_a_motion_that_is_awaited_small_or_partly_unseen(visit, hub):
    """As the server sends it: nothing touches, a ball rolls where nothing shows it, and what rounds to zero has no sign."""
    hub.stations[0].source.press_at(88, 66, 0.5, held_s=600)
    page = visit()
    page.click("#motion-on")
    until(lambda: page.is_visible("#motion-card"))
    until(
        lambda: "cannot be seen" in page.inner_text("#motion-card") or "hardly" in page.inner_text("#motion"),
        20,
    )
    hub.stations[0].source.lift()
    hub.stations[0].source.rest()
    until(lambda: page.inner_text("#motion") == "Waiting for a touch.", 20)
    assert not page.is_visible("#motion-more")
    script = """motion => {
        gelform.frame.header.motion = motion;
        document.dispatchEvent(new Event("laidout"));
    }"""
    page.click("#pause")
    until(lambda: page.evaluate("gelform.facts.stations[0].paused"))
    ball = [
        "turns about the ball's center at (0.1, -0.4, -2.6) mm",
        "turns about the ball's center at (0.1, -0.3, -2.6) mm",
    ]
    known = {"state": "found", "why": "", "blind": ball, "path": [], "axes": None}
    numbers = {
        "shift_mm": [-0.001, 0.3],
        "shift_sigma_mm": [0.01, 0.01],
        "turn_deg": None,
        "turn_sigma_deg": None,
    }
    page.evaluate(script, known | numbers)
    until(
        lambda: (
            page.inner_text("#motion")
            == "Since the touch: moved 0.30 mm down, how far it turned is not known."
        )
    )
    assert page.inner_text("#motion-blind") == "Turns about the ball's center cannot be seen."
    page.click("#motion-more summary")
    assert page.inner_text("#motion-numbers") == "x 0.00 ± 0.01 mm, y 0.30 ± 0.01 mm, turn not known"


def test_the_path_and_the_turn_of_letters(visit, hub):
    touch(hub, 0)
    page = visit()
    until(lambda: page.evaluate("gelform.frame?.header.peak > 0.2"))
    assert page.evaluate("gelform.frame.header.motion") is None
    assert page.is_hidden("#motion-card")
    page.click("#motion-on")
    until(lambda: hub.stations[0].moved is not None)
    until(lambda: page.inner_text("#motion") == "The object has hardly moved.", 20)
    assert page.evaluate("gelform.frame.header.motion.shift_mm") is None
    for step in range(1, STEPS):
        touch(hub, step)
    said = r"Since the touch: moved 1\.3\d mm right and 0\.[67]\d mm down, turned [45]\.\d° clockwise\."
    until(lambda: re.fullmatch(said, page.inner_text("#motion")), 20)
    assert not page.is_visible("#motion-numbers")
    page.click("#motion-more summary")
    until(lambda: re.search(r"x 1\.3\d ± ", page.inner_text("#motion-numbers")), 20)
    motion = page.evaluate("gelform.frame.header.motion")
    # The letters turned about their own middle by 4.9 degrees: 0.88 mm below it, the contact's moved by 0.08 mm less.
    np.testing.assert_allclose(motion["shift_mm"], (1.324, 0.7), atol=0.02)
    assert motion["turn_deg"] == pytest.approx(4.9, abs=1)
    page.click("#pause")
    script = """() => {
        const { shown } = gelform.panes[0], { width, height } = shown, found = [[], []];
        const { data } = shown.getContext("2d").getImageData(0, 0, width, height);
        for (let k = 0; k < width * height; k++) {
            if (data[4 * k] !== 255 || data[4 * k + 1] !== 225 || data[4 * k + 2] !== 77) continue;
            found[0].push(((k % width) / width) * 176);
            found[1].push((Math.floor(k / width) / height) * 132);
        }
        return found;
    }"""
    columns, rows = page.evaluate(script)
    path = np.array(motion["path"])
    np.testing.assert_allclose((min(columns), min(rows)), path.min(axis=0), atol=4)
    np.testing.assert_allclose((max(columns), max(rows)), path.max(axis=0), atol=4)
    page.click("#pause")
    page.click("#motion-on")
    until(lambda: hub.stations[0].moved is None)
    until(lambda: page.is_hidden("#motion-card"))
