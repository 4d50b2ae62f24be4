"""A recording in a real browser: opened from the list, scrubbed, stepped, looped, shared, downloaded.

The page without WebGL, with a graphics processor, and after the machine slept: the socket is dropped.

Several sensors on one page, several pages on one sensor, devices and settings, in a real browser.

The motion on the page: off at first; then the path and the axes over the maps, and the numbers.

The whole guided calibration in a real browser: from the ball to a calibration in use, with suggested presses.

From an uncalibrated sensor to depth in mm, in a real browser: one button, and a banner that stays.
"""

import contextlib
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

import gelform
from gelform import Frame, SensorError, open_source
from gelform.calibration.guide import LEAST
from gelform.calibration.starters import load_starter
from gelform.live.actions import start
from gelform.live.hub import Hub
from gelform.live.lists import Devices
from gelform.live.station import Setup
from gelform.sensors.cameras import Camera
from gelform.sensors.films import open_film
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.record import attached_calibration
from gelform.sensors.simulated import PosedObject, SimulatedSource
from gelform.simulate import Pose, text_relief
from live_waiting import held, until
from made.sources import recorded
from stream.ffmpeg_camera import FfmpegCamera, why_absent

pytestmark = pytest.mark.slow

COUNT = 9


@pytest.fixture
def recording(simulated, tmp_path):
    """A recording of nine presses."""
    images = [press.image for press in simulated.presses[:COUNT]]
    frames = [Frame(image, k / 10, 10**18 + k, k) for k, image in enumerate(images)]
    return recorded(tmp_path / "session.mcap", frames, RecordingFacts("ring", "S7", {}, 10.0))


@pytest.fixture
def replay(page, hub, station, recording, tmp_path):
    """The page on the recording, held."""
    hub.folder = tmp_path
    hub.recordings.add(recording)
    until(lambda: page.locator("#files .open").count() == 1)
    page.click("#files .open")
    until(lambda: page.is_visible("#replay"))
    until(lambda: page.evaluate("gelform.facts.stations[0].replay?.count") == COUNT)
    page.click("#step-back")  # holds, whether it plays or has just come to its end
    until(lambda: not station.source.playing)
    return page


def number(page):
    return page.evaluate("gelform.frame?.header.replay?.[0]")


def test_it_is_scrubbed_stepped_played_and_looped(replay, station, recording, calibration):
    seek = "(() => { const s = document.getElementById('scrub'); s.value = 4; s.dispatchEvent(new Event('input')) })()"
    replay.evaluate(seek)
    until(lambda: number(replay) == 4)
    until(lambda: replay.inner_text("#replay-at").startswith("5 / 9, 0:00.40"))
    wanted = gelform.Reconstructor(calibration)(open_film(recording)[4]).depth_mm
    peak = pytest.approx(wanted.max(), abs=1e-5)
    until(lambda: replay.evaluate("gelform.frame.header.peak") == peak)
    shown = f"{wanted.max():.3f}"  # no later frame draws it
    until(lambda: replay.inner_text("#number-peak .value").startswith(shown))
    replay.click("#step-back")
    until(lambda: number(replay) == 3)
    replay.keyboard.press(".")
    until(lambda: number(replay) == 4)
    replay.select_option("#speed", "8")
    replay.click("#loop")
    until(lambda: station.source.facts()["loop"])
    replay.click("#play")
    until(lambda: station.source.playing)
    until(lambda: replay.inner_text("#play") == "Pause")
    before = station.newest.serial
    until(lambda: station.newest.serial > before + COUNT, 60)  # round the end
    replay.click("#play")
    until(lambda: not station.source.playing)
    until(lambda: replay.inner_text("#play") == "Play")
    replay.evaluate("document.activeElement.blur()")  # a focused button takes the space
    replay.keyboard.press(" ")
    until(lambda: station.source.playing)


def test_one_file_is_shared_and_downloaded(replay, calibration):
    replay.click("#share")
    shared = replay.locator("#files a[title^='Download shared']")
    until(lambda: shared.count() == 1)
    with replay.expect_download() as download:
        shared.click()
    saved = download.value.path()
    fetched = saved.with_name("fetched.mcap")
    saved.rename(fetched)
    assert attached_calibration(fetched).digest == calibration.digest
    assert len(open_film(fetched).times_s) == COUNT
    replay.click("#files-back")
    until(lambda: replay.is_hidden("#replay"))


NO_WEBGL = """
const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return /webgl/.test(kind) ? null : get.call(this, kind, ...more);
};
"""


@pytest.fixture
def visit_pressed(visit, station):
    """Opens the page with the ball pressed; `before` is a script that runs in it first."""

    def go(before):
        station.source.press_at(120, 60, 0.5, held_s=600)
        page = visit(before=before)
        until(lambda: page.evaluate("gelform.frame?.header.peak > 0.4"))
        return page

    return go


def test_without_webgl_the_surface_is_a_shaded_relief(visit_pressed, is_drawn):
    page = visit_pressed(NO_WEBGL)
    assert "no WebGL2" in page.evaluate("gelform.look.renderer")
    until(lambda: is_drawn(page))
    page.click("#reset-view")  # does nothing there, without an error


GRAPHICS = """
const get = WebGL2RenderingContext.prototype.getParameter, RENDERER = 0x9246;
WebGL2RenderingContext.prototype.getParameter = function (name) {
  return name === RENDERER ? "a graphics processor" : get.call(this, name);
};
"""


def test_with_a_graphics_processor_every_pixel_is_a_vertex_and_every_frame_is_drawn(visit_pressed, is_drawn):
    """The processor computes it here too, under another name."""
    page = visit_pressed(GRAPHICS)
    assert page.evaluate("gelform.look.renderer") == "WebGL2"
    assert page.evaluate("gelform.connection.ahead") == 2
    until(lambda: page.evaluate("gelform.surface.grid") == [176, 132])
    whole = "gelform.surface.canvas.width === Math.round(gelform.surface.canvas.clientWidth)"
    until(lambda: page.evaluate(whole))
    until(lambda: is_drawn(page))


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="needs signals that stop a process")
def test_after_sleep_the_page_comes_back_by_itself(visit):
    """The server's process stands still as a sleeping machine's does: nothing is closed, nothing comes."""
    command = [sys.executable, "-m", "gelform", "live", "--quiet", "--rate", "20"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            page = visit(server.stdout.readline().strip())
            until(lambda: page.evaluate("Boolean(gelform.frame)"))
            os.kill(server.pid, signal.SIGSTOP)
            until(lambda: not page.evaluate("gelform.connection.open"))
            until(lambda: "does not answer" in page.inner_text("#banner"))
            os.kill(server.pid, signal.SIGCONT)
            until(lambda: page.evaluate("gelform.connection.open"))
            serial = page.evaluate("gelform.frame.header.serial")
            until(lambda: page.evaluate("gelform.frame.header.serial") > serial)
            until(lambda: page.is_hidden("#banner"))
        finally:
            server.kill()


@pytest.fixture
def two(hub, sensor, calibration, show):
    """The hub with a second sensor, pressed; its exposure can be set."""

    def opened():
        source = SimulatedSource(sensor, seed=1)
        source.rest()
        source.settings["exposure"] = 50.0
        source.set_controls = lambda wanted: source.settings.update(wanted) or source.settings
        return source

    show(opened, hub, Setup(calibration, "mine")).source.press_at(60, 70, 0.45, held_s=600)
    return hub


def test_two_sensors_stand_side_by_side_and_one_is_chosen(two, visit, is_drawn):
    page = visit()
    until(lambda: page.evaluate("gelform.stages.length") == 2)
    until(lambda: page.evaluate("gelform.stages[1].frame?.header.peak > 0.4"))
    until(lambda: page.evaluate("gelform.stages[0].frame?.header.peak < 0.1"))
    first, second = (page.locator(one).bounding_box() for one in ("#surface", "#surface-1"))
    assert first["y"] == second["y"]
    assert second["x"] >= first["x"] + first["width"]
    until(lambda: is_drawn(page, "#surface-1"))
    until(lambda: page.evaluate("Object.keys(gelform.stages[1].frame.planes)") == ["depth"])
    page.click(".chooser >> nth=1")
    until(lambda: page.evaluate("gelform.frame.header.station === 1 && gelform.frame.has('image')"))
    until(lambda: page.locator(".chooser >> nth=1").get_attribute("aria-pressed") == "true")
    drawn = "() => document.getElementById('{}').toDataURL()"
    until(lambda: page.inner_text(".whose >> nth=0") == "of sensor 2")
    until(lambda: page.inner_text("#profile-at").startswith(tuple(f"at ({x}, 7" for x in range(58, 63))))
    page.locator(".pane .map >> nth=0").click(position={"x": 20, "y": 20})
    until(lambda: page.get_attribute("#follow", "aria-pressed") == "false")
    peaks = page.evaluate("gelform.series.peak")
    assert max(peaks) > 0.4 > 0.1 > page.evaluate("Math.max(...gelform.stages[0].series.peak)")
    curves = page.evaluate(drawn.format("time"))
    page.click(".chooser >> nth=0")
    until(lambda: page.inner_text(".whose >> nth=1") == "of sensor 1")
    # The point was chosen on the other one.
    until(lambda: page.get_attribute("#follow", "aria-pressed") == "true")
    until(lambda: page.inner_text("#profile-at").startswith("at (88, 66)"))  # the middle: nothing touches it
    until(lambda: page.evaluate(drawn.format("time")) != curves)
    page.click(".chooser >> nth=1")
    until(lambda: page.get_attribute("#follow", "aria-pressed") == "false")
    page.fill("#set-exposure", "70")
    page.press("#set-exposure", "Enter")
    until(lambda: two.stations[1].source.settings["exposure"] == 70)
    until(lambda: page.inner_text("#now-exposure") == "now 70")
    page.keyboard.press("Tab")
    until(lambda: page.locator("#devices tr").count() == 2)


@pytest.mark.skipif(why_absent() is not None, reason=str(why_absent()))
def test_a_camera_of_the_list_is_shown_from_the_page_and_left_again(hub, station, visit):
    with FfmpegCamera() as camera:
        listed = [Camera("Bench camera", "/dev/video7", "S7")]
        hub.devices = Devices(hub.stations, lambda: listed, lambda *_: open_source(camera.url))
        page = visit()
        page.click("#devices button.show")
        until(lambda: not station.facts()["simulated"])
        until(lambda: "No calibration yet" in page.inner_text("#stages"))
        until(lambda: page.locator("#devices button.show").count() == 0)
        until(lambda: "none in the list has its serial" in page.inner_text("#toasts"))
        page.click("#devices-back")
        until(lambda: station.facts()["simulated"])
        until(lambda: page.is_hidden("#devices-back"))
        until(lambda: page.evaluate("gelform.facts.stations[0].calibration") == "mine")


def test_what_is_in_the_way_of_a_camera_is_said_on_the_page(visit, serving_of, show):
    """The sentence that `open_source` gives for a camera that another program has."""

    def busy():
        said = "DIGIT (serial D1, /dev/video0) is in use by python (process 7). Close the other program."
        raise SensorError(said)

    hub = Hub()
    show(busy, hub, waits=False)
    page = visit(serving_of(hub).url)
    until(lambda: page.is_visible("#banner"))
    until(lambda: "process 7" in page.inner_text("#banner"))
    until(lambda: "Any number of pages may show one camera" in page.inner_text("#banner"))


LETTERS = text_relief("gel", height_mm=5.0)
STEPS = 8


def touch(station, step):
    """Hold the letters at a step of their way, and wait for it to be shown."""
    source = station.source
    held = PosedObject(LETTERS, Pose(0.35, (0.2 * step - 1, 0.1 * step - 0.5), spin_deg=0.7 * step))
    source._levels_now = lambda _: source._levels_of_touch(held)
    before = station.newest.serial
    until(lambda: station.newest.serial > before + 4)


def test_words_for_a_motion_that_is_awaited_small_or_partly_unseen(visit, station):
    """As the server sends it: nothing touches, a ball rolls where nothing shows it, and what rounds to zero has no sign."""
    station.source.press_at(88, 66, 0.5, held_s=600)
    page = visit()
    page.click("#motion-on")
    until(lambda: page.is_visible("#motion-card"))
    until(lambda: re.search("cannot be seen|hardly", page.inner_text("#motion-card")), 20)
    station.source.lift()
    station.source.rest()
    until(lambda: page.inner_text("#motion") == "Waiting for a touch.", 20)
    assert not page.is_visible("#motion-more")
    script = """motion => {
        gelform.frame.header.motion = motion;
        document.dispatchEvent(new Event("laidout"));
    }"""
    page.click("#pause")
    until(lambda: page.evaluate("gelform.facts.stations[0].paused"))
    until(lambda: page.evaluate("gelform.frame.header.serial") == station.newest.serial)
    ball = [f"turns about the ball's center at (0.1, {y}, -2.6) mm" for y in (-0.4, -0.3)]
    motion = {"state": "found", "why": "", "blind": ball, "path": [], "axes": None}
    motion |= {"shift_mm": [-0.001, 0.3], "shift_sigma_mm": [0.01, 0.01]}
    motion |= {"turn_deg": None, "turn_sigma_deg": None}
    said = "Since the touch: moved 0.30 mm down, how far it turned is not known."
    page.evaluate(script, motion)
    until(lambda: page.inner_text("#motion") == said)
    assert page.inner_text("#motion-blind") == "Turns about the ball's center cannot be seen."
    page.click("#motion-more summary")
    assert page.inner_text("#motion-numbers") == "x 0.00 ± 0.01 mm, y 0.30 ± 0.01 mm, turn not known"


def test_the_path_and_the_turn_of_letters(visit, station):
    touch(station, 0)
    page = visit()
    until(lambda: page.evaluate("gelform.frame?.header.peak > 0.2"))
    assert page.evaluate("gelform.frame.header.motion") is None
    assert page.is_hidden("#motion-card")
    page.click("#motion-on")
    until(lambda: station.moved is not None)
    until(lambda: page.inner_text("#motion") == "The object has hardly moved.", 20)
    assert page.evaluate("gelform.frame.header.motion.shift_mm") is None
    for step in range(1, STEPS):
        touch(station, step)
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
    until(lambda: station.moved is None)
    until(lambda: page.is_hidden("#motion-card"))


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
