"""A station without a calibration asks for the gel at rest; then a starter reads it, and is reported as one."""

import pytest

from gelform.calibration.starters import load_starter
from gelform.errors import GelformError
from gelform.live import actions
from gelform.live.hub import Hub
from gelform.live.start import Options, start
from gelform.live.station import Station
from live_waiting import until
from made.sources import ImageSource

MAKE = "simulated-three-edges"


@pytest.fixture
def never(unpressed):
    """A hub whose one station is a camera that was never calibrated; its `source.images` are what it shows."""
    made, source = Hub(), ImageSource(unpressed[0.0], rate_hz=40)
    source.serial = "S1"
    station = Station(0, "camera", lambda: source, made.changed)
    made.stations.append(station)
    station.start()
    until(lambda: station.newest)
    yield made, source
    made.close()


def show(never, images):
    """Let the camera show other images, and wait until those that were on their way are through."""
    hub, source = never
    source.images = images
    after = hub.stations[0].newest.serial + 4
    until(lambda: hub.stations[0].newest.serial >= after)


def said(hub):
    return hub.facts()["stations"][0]["starter"]


def test_the_untouched_gel_is_asked_for_and_depth_follows(never, unpressed):
    hub, _ = never
    station = hub.stations[0]
    assert said(hub) == {"state": "ask", "sensor": "", "make": "", "said": []}
    with pytest.raises(GelformError, match="Choose the sensor in the list"):
        actions.take_starter(hub, 0, "")
    station.sensor = MAKE
    assert said(hub)["sensor"] == said(hub)["make"] == MAKE
    actions.take_starter(hub, 0, "")
    show(never, unpressed[0.4])
    until(lambda: station.newest.numbers and station.newest.numbers.peak > 0.3)
    assert said(hub)["state"] == "used"
    assert said(hub)["percent"] == pytest.approx(100 * load_starter(MAKE).spread)
    assert "starter" in [name for name, *_ in station.newest.header()["health"]]
    assert station.setup.calibration.serial == "S1"
    assert hub.calibrations.names == [station.setup.name]


def test_something_that_moves_is_said_and_it_is_taken_again(never, unpressed):
    hub, _ = never
    show(never, [*unpressed[0.0], *unpressed[0.4]])
    actions.take_starter(hub, 0, MAKE)
    assert said(hub)["state"] == "ask"
    assert "Something moves" in said(hub)["said"][0]
    show(never, unpressed[0.0])
    actions.take_starter(hub, 0, MAKE)
    assert said(hub)["said"] == []
    first = hub.stations[0].setup.calibration
    show(never, [image // 2 for image in unpressed[0.0]])
    actions.take_background(hub, 0)  # the lamps are half as bright: the starter is brought to them
    second = hub.stations[0].setup.calibration
    assert second.background.mean() < 0.6 * first.background.mean()
    assert len(hub.calibrations.names) == 1
    actions.undo_background(hub, 0)
    assert hub.stations[0].setup.calibration is first is hub.calibrations[hub.stations[0].setup.name]


def test_a_pressed_gel_is_no_background(never, unpressed):
    hub, _ = never
    show(never, unpressed[0.4])
    actions.take_starter(hub, 0, MAKE)
    assert said(hub)["state"] == "ask"
    assert "Something touches the gel" in said(hub)["said"][0]


def test_another_make_is_said(never):
    hub, _ = never
    actions.take_starter(hub, 0, "digit")
    assert "background of a DIGIT" in said(hub)["said"][0]
    actions.take_starter(hub, 0, "gelsight-mini")
    assert "background of a GelSight Mini" in said(hub)["said"][0]
    assert said(hub)["state"] == "ask"


def test_a_scratched_gel_is_said_beside_the_depth(never, unpressed):
    hub, _ = never
    scratched = [image.copy() for image in unpressed[0.0]]
    for image in scratched:
        image[100:112] //= 8
    show(never, scratched)
    actions.take_starter(hub, 0, MAKE)
    assert any("scratched" in one for one in said(hub)["said"])


def test_the_guide_takes_its_scale(never):
    hub, _ = never
    actions.take_starter(hub, 0, MAKE)
    actions.guide_start(hub, 0, 5.0, MAKE, 0.5)
    asked = hub.guides[0].guide.asked
    assert asked.mm_per_px == load_starter(MAKE).calibration.mm_per_px
    assert (asked.sensor_name, asked.serial) == (MAKE, "S1")


def test_a_make_that_was_named_is_asked_for_instead_of_calibrated():
    hub = start(Options(rate_hz=30, sensor=MAKE))
    try:
        assert not hub.work
        assert said(hub)["sensor"] == MAKE
        until(lambda: hub.stations[0].newest)
        actions.take_starter(hub, 0, "")  # the simulated sensor rests meanwhile
        assert said(hub)["state"] == "used"
        until(lambda: hub.stations[0].newest.result)
    finally:
        hub.close()
