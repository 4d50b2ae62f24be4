"""From the first frame to a calibration in use: the simulated sensor is pressed at the suggested places."""

import numpy as np
import pytest

import gelform
from gelform.errors import GelformError
from gelform.live import actions
from live_waiting import until


def test_a_press_is_made_where_the_guide_asks_and_counts(hub, tmp_path):
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    guide = hub.guides[0].guide
    until(lambda: guide.target, 30)
    x, y = guide.target.x_px, guide.target.y_px
    until(lambda: guide.count >= 1, 30)
    assert guide.facts()["accepted"][0][:2] == pytest.approx((x, y), abs=4)
    hub.end_guide(0)
    assert not hub.guides
    assert not hub.stations[0].taps


def test_it_fits_writes_reports_and_is_used(hub, tmp_path, library, presses, calibration, monkeypatch):
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    session = hub.guides[0]
    with pytest.raises(GelformError, match="no calibration to use"):
        actions.guide_use(hub, 0)
    monkeypatch.setattr(session.guide, "presses", lambda: presses)
    monkeypatch.setattr(
        "gelform.live.guide.session.calibrate", lambda *_, **__: calibration
    )  # made once for all
    session.fit(lambda *_: None)
    report = session.guide.report
    assert session.guide.step == "report"
    assert report["accepted"] + len(report["rejected"]) == len(presses.presses)
    assert report["level"] in ("good", "fair", "poor")
    (seen,) = [check["value"] for check in report["checks"] if "slope directions" in check["label"]]
    assert seen == pytest.approx(100 * session.guide.facts()["coverage"]["share"]), "one figure"
    folder = tmp_path / session.name
    assert "<html" in (folder / "report.html").read_text(encoding="utf-8")
    assert len(gelform.read_presses(folder).presses) == len(presses.presses)
    actions.guide_use(hub, 0)
    used = hub.stations[0].setup.calibration
    assert used.digest == gelform.load_calibration(folder / "calibration.npz").digest
    (kept,) = library.iterdir()
    assert gelform.load_calibration(kept).digest == used.digest
    assert hub.stations[0].setup.name == kept.name
    assert "The library has it too" in hub.notices[-1][2]
    assert np.isfinite(used.held_out["normal_free_deg"])


def test_a_library_that_cannot_be_written_is_said(hub, tmp_path, library, presses, calibration, monkeypatch):
    library.write_text("a file where the folder should be")
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    session = hub.guides[0]
    monkeypatch.setattr(session.guide, "presses", lambda: presses)
    monkeypatch.setattr("gelform.live.guide.session.calibrate", lambda *_, **__: calibration)
    session.fit(lambda *_: None)
    actions.guide_use(hub, 0)
    assert hub.stations[0].setup.name == "calibration.npz"
    assert "The library does not have it: Cannot make the folder" in hub.notices[-1][2]


def test_a_fit_that_does_not_succeed_asks_for_more(hub, tmp_path):
    hub.folder = tmp_path
    actions.guide_start(hub, 0, 5.0, "", 0.0)
    session = hub.guides[0]
    with pytest.raises(GelformError):
        session.fit(lambda *_: None)
    assert session.guide.step == "background"
    until(lambda: session.guide.step == "press", 30)
