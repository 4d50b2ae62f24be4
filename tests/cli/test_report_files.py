"""The files of a report: all or none, whatever the disk does."""

import errno

import pytest

from gelform.cli import report_files
from gelform.errors import DataError


def test_a_folder_that_holds_a_report_is_refused(tmp_path):
    report_files.check_report_folder(tmp_path / "deep" / "report", overwrite=False)
    (tmp_path / "deep" / "report" / "circles.csv").touch()
    report_files.check_report_folder(tmp_path / "deep" / "report", overwrite=True)
    with pytest.raises(DataError, match=r"circles\.csv is already there.*--overwrite"):
        report_files.check_report_folder(tmp_path / "deep" / "report", overwrite=False)


def test_a_full_disk_leaves_none_of_them(tmp_path, monkeypatch):
    """The disk is full when the second file is brought to it: the first must not stay."""
    calls = []

    def full(handle):
        calls.append(handle)
        if len(calls) == 2:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(report_files.os, "fsync", full)
    files = {tmp_path / name: b"text" for name in report_files.REPORT_FILES}
    with pytest.raises(DataError, match="No space left"):
        report_files._write_all(files, overwrite=False)
    assert list(tmp_path.iterdir()) == []
    monkeypatch.undo()
    report_files._write_all(files, overwrite=False)
    assert {path.name for path in tmp_path.iterdir()} == set(report_files.REPORT_FILES)
