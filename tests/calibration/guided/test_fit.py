"""The calibration of guided presses, its files and its figures."""

import pytest

import gelform
from gelform.calibration.guided import fit


@pytest.fixture
def made(presses, calibration, monkeypatch, tmp_path):
    """Makes the guided calibration of the shared presses; calibration itself was done once for all."""
    monkeypatch.setattr(fit, "calibrate", lambda *_, **__: calibration)
    return lambda: fit.calibrate_guided(presses, tmp_path)


def test_its_folder_has_the_calibration_and_the_library_once_it_is_kept(made, library, presses):
    found = made()
    assert "<html" in found.report_file.read_text(encoding="utf-8")
    assert len(gelform.read_presses(found.folder).presses) == len(presses.presses)
    assert not list(library.glob("*"))
    path, said = found.keep()
    assert [path] == list(library.iterdir())
    assert "The library has it too" in said
    kept = path
    saved = gelform.load_calibration(found.folder / "calibration.npz")
    assert saved.digest == gelform.load_calibration(kept).digest == found.calibration.digest


def test_its_figures_are_those_of_the_report(made, library, presses):
    found = made()
    assert found.report["accepted"] + len(found.report["rejected"]) == len(presses.presses)
    assert found.report["level"] in ("good", "fair", "poor")
    (seen,) = [check["value"] for check in found.report["checks"] if "slope directions" in check["label"]]
    assert seen == pytest.approx(100 * found.covered.fraction), "one figure"
    assert 1 <= len(found.places) <= 3
    page = found.report_file.read_text(encoding="utf-8")
    assert all(f"{place.x_px:.0f}, {place.y_px:.0f}" in page for place in found.places), "its places 1, 2, 3"


def test_a_library_that_cannot_be_written_is_said(made, library):
    library.write_text("a file where the folder should be")
    found = made()
    path, said = found.keep()
    assert path == found.folder / "calibration.npz"
    assert "The library does not have it: Expected a folder for the library" in said
