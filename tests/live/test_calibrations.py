"""The list of calibrations: names are made here, and nothing else is opened."""

import pytest

from gelform.errors import CalibrationError, GelformError
from gelform.live.calibrations import Calibrations, Origin


@pytest.fixture
def calibrations_folder(tmp_path, calibration):
    calibration.save(tmp_path / "mine.npz")
    (tmp_path / "other.npz").write_bytes(b"no calibration")
    (tmp_path / "deep").mkdir()
    calibration.save(tmp_path / "deep" / "mine.npz")
    return tmp_path


def test_a_folders_calibrations_are_offered_and_nothing_else(calibrations_folder, calibration):
    known = Calibrations(folder=calibrations_folder)
    assert known.names == ["mine.npz"]
    assert known["mine.npz"].digest == calibration.digest


def test_files_that_are_called_alike_keep_apart(calibrations_folder):
    known = Calibrations(
        [calibrations_folder / "mine.npz", calibrations_folder / "deep" / "mine.npz"], calibrations_folder
    )
    assert known.names == ["mine.npz", "deep/mine.npz"]
    assert known.origin_of("deep/mine.npz").path == calibrations_folder / "deep" / "mine.npz"


def test_what_was_made_here_gets_a_free_name(calibration):
    known, origin = Calibrations(), Origin("made()")
    assert known.add("mine", calibration, origin) == "mine"
    assert known.add("mine", calibration, origin) == "mine (2)"
    assert known["mine (2)"] is calibration
    assert known.add_once("mine", calibration, origin) == "mine"
    assert len(known.names) == 2


@pytest.mark.parametrize("name", ["", "../mine.npz", "deep/mine.npz", "/etc/passwd", "mine.npz\0"])
def test_a_path_is_no_name(calibrations_folder, name):
    with pytest.raises(GelformError, match="Choose one of the list"):
        Calibrations(folder=calibrations_folder)[name]


def test_a_file_that_cannot_be_read_is_said(calibrations_folder):
    known = Calibrations([calibrations_folder / "other.npz"])
    with pytest.raises(CalibrationError):
        known["other.npz"]
