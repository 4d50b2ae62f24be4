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


def test_the_path_and_the_turn_of_letters(visit, hub):
    touch(hub, 0)
    page = visit()
    until(lambda: page.evaluate("gelform.frame?.header.peak > 0.2"))
    assert page.evaluate("gelform.frame.header.motion") is None
    assert page.is_hidden("#motion-card")
    page.click("#motion-on")
    until(lambda: hub.stations[0].moved is not None)
    until(lambda: "cannot tell yet" in page.inner_text("#motion"))
    assert page.evaluate("gelform.frame.header.motion.shift_mm") is None
    for step in range(1, STEPS):
        touch(hub, step)
    until(lambda: re.search(r"x 1\.3\d ± ", page.inner_text("#motion")))
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
