"""What the buttons do, on a running simulated sensor."""

import numpy as np
import pytest

from gelform.errors import GelformError
from gelform.live import actions
from gelform.simulate import simulate_background
from live_waiting import until


def test_the_background_is_the_sensors(hub, sensor):
    actions.take_background(hub, 0)
    taken = hub.stations[0].setup.background
    assert (
        np.abs(taken - simulate_background(sensor, None)).mean() < 0.6
    )  # noise of 2 levels, averaged over 15
    assert "Background taken" in hub.notices[-1][2]
    actions.own_background(hub, 0)
    assert hub.stations[0].setup.background is None


def test_zero_is_set_and_taken_back(hub):
    station = hub.stations[0]
    station.source.press_at(88, 66, 0.4, held_s=600)
    until(lambda: station.newest.measures.peak > 0.3)
    actions.set_zero(hub, 0)
    until(lambda: station.newest.measures.peak < 0.1)
    actions.set_zero(hub, 0)
    until(lambda: station.newest.measures.peak > 0.3)


def test_a_press_is_where_it_was_asked_for(hub, result):
    station = hub.stations[0]
    actions.press(hub, 0, 120.0, 40.0)
    deep = until(lambda: station.newest if station.newest.measures.peak > 0.35 else None)
    assert abs(deep.measures.x_px - 120) < 4
    assert abs(deep.measures.y_px - 40) < 4


def test_solver_calibration_and_comparison(hub, calibration):
    actions.use_solver(hub, 0, "dct")
    until(lambda: hub.stations[0].newest.result.solver == "dct")
    name = hub.calibrations.add("again", calibration, hub.calibrations.origin_of("mine"))
    actions.use_calibration(hub, 0, name)
    assert hub.stations[0].setup.name == "again"
    actions.compare_with(hub, 0, "mine")
    until(lambda: hub.stations[0].newest.other is not None)
    actions.compare_with(hub, 0, "")
    assert hub.stations[0].setup.other is None


@pytest.mark.parametrize(
    ("act", "arguments"),
    [
        (actions.use_solver, ("nonsense",)),
        (actions.use_calibration, ("../secret.npz",)),
        (actions.code, ("nonsense", 0, 0)),
    ],
)
def test_names_that_are_not_in_the_lists_are_refused(hub, act, arguments):
    before = hub.stations[0].setup
    with pytest.raises(GelformError):
        act(hub, 0, *arguments)
    assert hub.stations[0].setup is before


def test_without_a_calibration_buttons_say_what_to_do(hub):
    from gelform.live.setup import Setup

    hub.stations[0].setup = Setup()
    for act in (actions.take_background, actions.set_zero):
        with pytest.raises(GelformError, match="no calibration yet"):
            act(hub, 0)


def test_a_snapshot_has_a_number_and_files(hub):
    answer = actions.snapshot(hub, 0)
    assert answer["files"] == ["result.npz", "frame.png", "depth.png", "points.ply"]
    assert hub.snapshots.file(answer["number"], "frame.png")[0].endswith("frame.png")
