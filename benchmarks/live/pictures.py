"""The pictures of docs/live.md: `gelform live` on the simulated sensor in a headless Chromium.

Playwright drives the Chromium that GELFORM_CHROMIUM names, or the one on PATH.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.image.view import Frame
from gelform.sensors import simulated_sensor_named
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.simulated import IMAGE_RATE_HZ, program
from gelform.simulate import Screw, simulate_ball_presses, simulate_pose
from live.guided import wait_for
from live.server import CHROMIUM, COMPUTED_S, FLAGS, Live

DESKTOP, GUIDE, LARGE, PHONE = (1360, 1010), (1360, 900), (1300, 1145), (390, 844)
QUALITY = 88
HELD_AT = 12
TRIES = 50  # of a picture of what moves
DEEP = "gelform.frame.header.peak > 0.3"
SCRUB = "document.getElementById('scrub')"
SEEK = f"{SCRUB}.value = {HELD_AT}; {SCRUB}.dispatchEvent(new Event('input'))"


@contextmanager
def served(folder: str, *words: str) -> Iterator[Any]:
    """`gelform live` and a browser; opens its page at a size (width, height), in light or dark colors."""
    from playwright.sync_api import sync_playwright

    live = Live(folder, *words)
    try:
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)

            def opened(size: tuple[int, int], theme: str = "light") -> Any:
                viewport = {"width": size[0], "height": size[1]}
                page = browser.new_page(viewport=viewport, color_scheme=theme)
                page.goto(live.url)
                wait_for(page, "window.gelform?.frame")
                return page

            yield opened
            browser.close()
    finally:
        live.close()


def keep(page: Any, path: Path, condition: str = "true") -> None:
    """What the page shows, as JPEG; while a condition holds, before and after the picture is taken."""
    for _ in range(TRIES):
        wait_for(page, condition)
        shot = page.screenshot()
        if page.evaluate(f"Boolean({condition})"):
            break
    else:
        raise TimeoutError(f"Expected {condition} while a picture is taken: the machine is too busy.")
    image = cv2.imdecode(np.frombuffer(shot, np.uint8), cv2.IMREAD_COLOR)
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    print(path)


def of_the_sensor(folder: Path) -> None:
    """The page in use, on a desktop and on a phone, and the guide in the middle of its presses."""
    with tempfile.TemporaryDirectory() as work, served(work) as opened:
        time.sleep(COMPUTED_S)  # until all objects are computed
        for name, size, theme in (
            ("desktop-light", DESKTOP, "light"),
            ("desktop-dark", DESKTOP, "dark"),
            ("phone-dark", PHONE, "dark"),
        ):
            page = opened(size, theme)
            page.wait_for_timeout(3000)  # rates and curves have begun
            keep(page, folder / f"{name}.jpg", DEEP)
            page.close()
        page = opened(GUIDE)
        page.click("#tab-calibrate")
        page.fill("#ball", "5")
        page.click("#guide-start")
        wait_for(page, "gelform.facts.guides[0]?.count >= 7 && gelform.facts.guides[0].places.length")
        page.wait_for_timeout(400)
        keep(page, folder / "calibrate.jpg")


def of_a_recording(folder: Path) -> None:
    """A recording held at a frame."""
    sensor = simulated_sensor_named("three-edges")
    touches = [
        touch for images in program(sensor) for touch in images if touch and isinstance(touch.indenter, Screw)
    ]
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        made = simulate_ball_presses(
            sensor, ball_diameters_mm=[5.0], count=12, rng=np.random.default_rng(12), oversample=1
        )
        gelform.calibrate(presses_from_simulated(made)).save(work / "twelve-presses.npz")
        recording = McapRecording(work / "screw.mcap", RecordingFacts(sensor.name, None, {}, IMAGE_RATE_HZ))
        rng = np.random.default_rng(0)
        for k, touch in enumerate(dict.fromkeys(touches)):
            image = simulate_pose(sensor, touch.indenter, touch.pose, rng=rng).image
            recording.write(Frame(image, k / IMAGE_RATE_HZ, k, k))
        recording.close()
        with served(name, str(work / "screw.mcap"), "-c", str(work / "twelve-presses.npz")) as opened:
            page = opened(LARGE)
            page.click("#step-back")  # holds
            page.evaluate(SEEK)
            wait_for(page, f"gelform.frame.header.replay?.[0] === {HELD_AT}")
            page.wait_for_timeout(1000)
            keep(page, folder / "replay.jpg")


def take_pictures(folder: Path) -> None:
    """Take all pictures, as JPEG files in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    of_the_sensor(folder)
    of_a_recording(folder)
