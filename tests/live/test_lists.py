"""The lists of calibrations and recordings: names are made here, and nothing else can be opened."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.errors import CalibrationError, GelformError
from gelform.live.lists import Calibrations, Recordings
from gelform.live.web.commands import text


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


def test_what_was_made_here_gets_a_free_name(calibration):
    known, another = Calibrations(), replace(calibration, serial="S9")
    assert known.add("mine", calibration) == "mine"
    assert known.add("mine", another) == "mine (2)"
    assert known["mine (2)"] is another
    assert known.add("mine", calibration) == "mine"
    assert len(known.names) == 2
    known.put("mine", another)
    assert known["mine"] is another


def test_paths_and_files_that_cannot_be_read_are_refused(calibrations_folder):
    for name in ("", "../mine.npz", "deep/mine.npz", "/etc/passwd", "mine.npz\0"):
        with pytest.raises(GelformError, match="Choose one in the list"):
            Calibrations(folder=calibrations_folder)[name]
    with pytest.raises(CalibrationError):
        Calibrations([calibrations_folder / "other.npz"])["other.npz"]


def test_given_and_found_ones_are_listed_once(forms, tmp_path):
    listed = Recordings([forms["mcap"], forms["images"]], forms["mcap"].parent)
    names = [one["name"] for one in listed.facts()]
    assert names == ["a.mcap", "d", "c.avi"]
    assert listed.path("a.mcap") == forms["mcap"]
    assert [one["bytes"] for one in listed.facts()[:2]] == [forms["mcap"].stat().st_size, None]
    copy = tmp_path / "a.mcap"
    copy.write_bytes(b"")
    assert Recordings([forms["mcap"], copy]).path("a.mcap (2)") == copy


def test_folders_are_not_fetched_and_what_is_gone_is_said(forms, tmp_path):
    gone = tmp_path / "gone.mcap"
    gone.write_bytes(b"x")
    listed = Recordings([forms["images"], gone])
    gone.unlink()
    for number in (0, 1, 2, -1):
        with pytest.raises(GelformError, match="Share"):
            listed.file(number)
    assert listed.facts()[1]["bytes"] is None


@pytest.fixture
def odd_folder(forms, tmp_path, calibration):
    """Names that are no text or steer; links to itself, out of the folder and inside it; a pipe; a folder."""
    folder = tmp_path / "folder"
    (folder / "inner.mcap").mkdir(parents=True)
    recording = forms["mcap"].read_bytes()
    for name in (
        b"a\nb.mcap",
        b"no\xfftext.mcap",
        b"\xe2\x80\xaeb.mcap",
        b"x" * 240 + b".mcap",
        b"plain.mcap",
    ):
        Path(os.fsdecode(os.fsencode(folder) + b"/" + name)).write_bytes(recording)
    (tmp_path / "secret.mcap").write_bytes(recording)
    calibration.save(tmp_path / "secret.npz")
    calibration.save(folder / "own.npz")
    for name, target in (
        ("out.mcap", tmp_path / "secret.mcap"),
        ("out.npz", tmp_path / "secret.npz"),
        ("self.mcap", folder / "self.mcap"),
        ("self.npz", folder / "self.npz"),
        ("gone.mcap", folder / "none.mcap"),
        ("device.mcap", Path("/dev/zero")),
    ):
        (folder / name).symlink_to(target)
    os.mkfifo(folder / "pipe.mcap")
    return folder


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes, pipes and links")
def test_only_a_folders_own_files_are_listed_by_names_that_can_be_shown(odd_folder):
    names = [one["name"] for one in Recordings((), odd_folder).facts()]
    assert "plain.mcap" in names
    assert {r"a\nb.mcap", r"no\udcfftext.mcap", r"\u202eb.mcap"} < set(names)
    assert len(names) == 5
    for name in names:
        assert text(name) == name
        assert name.encode()
    assert Calibrations(folder=odd_folder).names == ["own.npz"]


@pytest.mark.skipif(sys.platform != "linux", reason="names of bytes, pipes and links")
def test_a_file_that_became_a_link_out_of_the_folder_is_not_opened(odd_folder, tmp_path):
    listed = Recordings((), odd_folder)
    number = [one["name"] for one in listed.facts()].index("plain.mcap")
    assert listed.path("plain.mcap") == listed.file(number) == odd_folder / "plain.mcap"
    (odd_folder / "plain.mcap").unlink()
    (odd_folder / "plain.mcap").symlink_to(tmp_path / "secret.mcap")
    with pytest.raises(GelformError, match="no recording"):
        listed.path("plain.mcap")
    with pytest.raises(GelformError, match="no such file"):
        listed.file(number)


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(st.text(max_size=30) | st.sampled_from(["../a.mcap", "/etc/passwd", "a.mcap/..", "b/frames.csv"]))
def test_no_other_name_opens_anything(forms, name):
    listed = Recordings([forms["mcap"]])
    if name != "a.mcap":
        with pytest.raises(GelformError, match="no recording"):
            listed.path(name)
