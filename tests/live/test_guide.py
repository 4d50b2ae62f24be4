"""From the first frame to a calibration in use: the simulated sensor is pressed at the suggested places."""

import pytest

from gelform.errors import GelformError
from gelform.live import actions
from gelform.live.lists import Calibrations
from live_waiting import until


def test_a_press_is_made_where_the_guide_asks_and_counts(hub, tmp_path):
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    guide = hub.guides[0].guide
    until(lambda: guide.target)
    x, y = guide.target.x_px, guide.target.y_px
    until(lambda: guide.count >= 1)
    assert guide.facts()["accepted"][0][:2] == pytest.approx((x, y), abs=4)
    hub.end_guide(0)
    assert not hub.guides
    assert not hub.stations[0].taps


def test_what_was_fitted_is_reported_and_used(hub, tmp_path, library, presses, calibration, monkeypatch):
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    session = hub.guides[0]
    with pytest.raises(GelformError, match="no calibration to use"):
        actions.guide_use(hub, 0)
    monkeypatch.setattr(session.guide, "presses", lambda: presses)
    monkeypatch.setattr("gelform.calibration.guided.fit.calibrate", lambda *_, **__: calibration)
    session.guide.fit(hub.folder)
    assert session.guide.step == "report"
    assert session.guide.facts()["report"]["folder"] == session.guide.made.folder.name
    assert not list(library.glob("*"))
    actions.guide_use(hub, 0)
    assert hub.stations[0].setup.calibration.digest == calibration.digest
    (kept,) = library.iterdir()
    assert hub.stations[0].setup.name == kept.name
    assert "The library has it too" in hub.notices[-1][2]


def test_what_is_not_used_is_used_nowhere(hub, tmp_path, library, presses, calibration, monkeypatch):
    hub.folder, before = tmp_path, hub.stations[0].setup
    monkeypatch.setattr("gelform.calibration.guided.fit.calibrate", lambda *_, **__: calibration)
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    guide = hub.guides[0].guide
    monkeypatch.setattr(guide, "presses", lambda: presses)
    guide.fit(hub.folder)
    folder = guide.made.folder
    listed = hub.calibrations.names
    actions.guide_stop(hub, 0)
    assert not hub.guides
    assert not list(library.glob("*"))
    assert hub.stations[0].setup is before
    assert hub.calibrations.names == listed
    assert Calibrations(folder=tmp_path, library=library).names == [], "nor after a restart"
    assert folder.name in hub.notices[-1][2]
    assert (folder / "presses.csv").exists()


@pytest.mark.slow
def test_after_the_report_more_presses_are_made_at_its_places(
    hub, tmp_path, presses, calibration, monkeypatch
):
    hub.folder = tmp_path
    monkeypatch.setattr("gelform.calibration.guided.fit.calibrate", lambda *_, **__: calibration)
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    guide = hub.guides[0].guide
    until(lambda: guide.step == "press")
    with pytest.raises(GelformError, match="no report yet"):
        actions.guide_more(hub, 0)
    guide.wanted = 0
    monkeypatch.setattr(guide, "presses", lambda: presses)
    guide.fit(hub.folder)
    count, marked = guide.count, guide.places
    assert marked == guide.made.places
    actions.guide_more(hub, 0)
    assert (guide.step, guide.made, guide.places, guide.wanted) == (
        "press",
        None,
        marked,
        count + len(marked),
    )
    with pytest.raises(GelformError, match="Press Fit now first"):
        actions.guide_use(hub, 0)
    until(lambda: guide.count > count)
    assert guide.facts()["accepted"][count][:2] == pytest.approx((marked[0].x_px, marked[0].y_px), abs=4)


def test_a_fit_that_does_not_succeed_asks_for_more(hub, tmp_path):
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    session = hub.guides[0]
    with pytest.raises(GelformError):
        session.guide.fit(hub.folder)
    assert session.guide.step == "background"
    until(lambda: session.guide.step == "press")
