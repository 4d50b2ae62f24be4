"""Several sensors on one page, several pages on one sensor, devices and settings, in a real browser."""

import numpy as np
import pytest

from gelform.live.devices import Devices
from gelform.live.hub import Hub
from gelform.live.station import Setup, Station
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.simulated.source import SimulatedSource
from gelform.sensors.source import open_source
from live_waiting import until
from stream.ffmpeg_camera import FfmpegCamera, why_absent

pytestmark = pytest.mark.slow


@pytest.fixture
def two(hub, sensor, calibration):
    """The hub with a second sensor, pressed; its exposure can be set."""

    def opened():
        source = SimulatedSource(sensor, seed=1)
        source.rest()
        source.settings["exposure"] = 50.0
        source.set_controls = lambda wanted: source.settings.update(wanted) or source.settings
        return source

    station = Station(1, "right", opened, hub.changed)
    station.setup = Setup().with_calibration(calibration, "mine")
    hub.stations.append(station)
    station.start()
    until(lambda: station.newest)
    station.source.press_at(60, 70, 0.45, held_s=600)
    return hub


def test_two_sensors_stand_side_by_side_and_one_is_chosen(two, visit, picture):
    page = visit()
    until(lambda: page.evaluate("gelform.stages.length") == 2)
    until(lambda: page.evaluate("gelform.stages[1].frame?.header.peak > 0.4"))
    until(lambda: page.evaluate("gelform.stages[0].frame?.header.peak < 0.1"))
    first, second = (page.locator(one).bounding_box() for one in ("#surface", "#surface-1"))
    assert first["y"] == second["y"]
    assert second["x"] >= first["x"] + first["width"]
    until(lambda: len(np.unique(picture(page, "#surface-1").reshape(-1, 3) // 16, axis=0)) > 20)
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
    until(
        lambda: page.get_attribute("#follow", "aria-pressed") == "true"
    )  # the point was chosen on the other one
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
def test_a_camera_of_the_list_is_shown_from_the_page_and_left_again(hub, visit):
    with FfmpegCamera() as camera:
        listed = [Camera("Bench camera", "/dev/video7", "S7")]
        hub.devices = Devices(hub.stations, lambda: listed, lambda *_: open_source(camera.url))
        page = visit()
        page.click("#devices button.show")
        until(lambda: not hub.stations[0].facts()["simulated"])
        until(lambda: "No calibration yet" in page.inner_text("#stages"))
        until(lambda: page.locator("#devices button.show").count() == 0)
        until(lambda: "none in the list has its serial" in page.inner_text("#toasts"))
        page.click("#devices-back")
        until(lambda: hub.stations[0].facts()["simulated"])
        until(lambda: page.is_hidden("#devices-back"))
        until(lambda: page.evaluate("gelform.facts.stations[0].calibration") == "mine")


def test_what_is_in_the_way_of_a_camera_is_said_on_the_page(visit, serving_of):
    """The sentence that `open_source` gives for a camera that another program has."""
    from gelform.errors import SensorError

    def busy():
        raise SensorError(
            "DIGIT (serial D1, /dev/video0) is in use by python (process 7). Close the other program."
        )

    hub = Hub()
    hub.stations.append(Station(0, "D1", busy, hub.changed))
    hub.stations[0].start()
    page = visit(serving_of(hub).url)
    until(lambda: page.is_visible("#banner"))
    until(lambda: "process 7" in page.inner_text("#banner"))
    until(lambda: "Any number of pages may show one camera" in page.inner_text("#banner"))
