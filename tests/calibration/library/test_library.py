"""The library of calibrations: where it is, its names, several who add at once, damaged files."""

import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from gelform.calibration.library.library import (
    add_calibration,
    entries,
    file_name,
    library_folder,
    matching,
    remove_calibration,
)
from gelform.calibration_file import load_calibration
from gelform.errors import DataError
from made.small_gel import calibration

OLD = replace(calibration(), serial="S1", gel_id="gel/1", created_utc="2026-01-02T03:04:05+00:00")
NEW = replace(OLD, gel_id="2", created_utc="2026-11-12T13:14:15+00:00")


def test_a_variable_names_another_folder(monkeypatch, tmp_path):
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path))
    assert library_folder() == tmp_path
    monkeypatch.setenv("GELFORM_CALIBRATIONS", "relative")
    with pytest.raises(DataError, match="GELFORM_CALIBRATIONS, got relative"):
        library_folder()
    monkeypatch.delenv("GELFORM_CALIBRATIONS")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path))
    assert library_folder().parts[-2:] == ("gelform", "calibrations")


@pytest.mark.skipif(sys.platform != "linux", reason="a home of Linux")
def test_a_home_that_is_no_absolute_path_is_none(monkeypatch):
    for given, said in (
        ("~/here", "an absolute path"),
        ("~nobody-of-that-name/here", "an absolute path"),
        ("", "a home"),
    ):
        monkeypatch.setenv("GELFORM_CALIBRATIONS", given)
        monkeypatch.setenv("HOME", "relative")
        monkeypatch.setattr(
            "gelform.calibration.library.library.user_data_path", lambda *_, **__: Path("relative")
        )
        with pytest.raises(DataError, match=f"Expected {said}"):
            library_folder()


@pytest.mark.skipif(sys.platform != "linux", reason="a user without an entry")
def test_a_user_without_a_home_must_name_a_folder(monkeypatch):
    for name in ("GELFORM_CALIBRATIONS", "XDG_DATA_HOME", "HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", lambda _: {}["no entry"])
    with pytest.raises(DataError, match=r"Expected a home folder .* Name a folder in GELFORM_CALIBRATIONS"):
        library_folder()


def test_names_are_readable_and_no_two_alike(library):
    path, new = add_calibration(OLD)
    assert new
    assert path.parent == library
    assert path.name == f"known-gel_S1_gel-1_20260102T0304_{OLD.digest[:10]}.npz"
    assert file_name(replace(OLD, serial=None, gel_id=None)).startswith("known-gel_no-serial_no-gel_")
    assert file_name(replace(OLD, serial="../" * 99)).count("/") == 0
    assert load_calibration(path).digest == OLD.digest


def test_the_newest_comes_first_and_the_same_is_one(library):
    for one in (NEW, OLD):
        add_calibration(one)
    again, new = add_calibration(load_calibration(entries()[1].path))
    assert (again, new) == (entries()[1].path, False)
    assert [entry.gel_id for entry in entries()] == ["2", "gel/1"]
    os.rename(again, library / "mine.npz")  # a name of one's own
    assert add_calibration(OLD) == (library / "mine.npz", False)
    assert len(entries()) == 2
    assert entries()[0].held_out == NEW.held_out


def test_a_damaged_file_is_listed_stays_and_is_in_nobody_s_way(library):
    path, _ = add_calibration(OLD)
    path.write_bytes(path.read_bytes()[:500])
    (library / "text.npz").write_text("no archive")
    (damaged,) = [entry for entry in entries() if entry.path == path]
    assert "truncated or damaged" in damaged.problem
    second, new = add_calibration(OLD)
    assert new
    assert second.name == path.stem + "_2.npz"
    assert path.stat().st_size == 500
    assert [bool(entry.problem) for entry in entries()] == [False, True, True]


def test_entries_are_found_by_serial_gel_name_and_digest(library):
    for one in (OLD, NEW):
        add_calibration(one)
    assert [entry.gel_id for entry in matching("S1")] == ["2", "gel/1"]
    (entry,) = matching("S1", "gel/1")
    assert matching(entry.path.name) == matching(OLD.digest[:6]) == [entry]
    for word, gel in (("S2", None), ("S1", "3"), (OLD.digest[:3], None)):
        with pytest.raises(DataError, match="There: known-gel_S1_2"):
            matching(word, gel)
    remove_calibration(entry)
    assert [one.gel_id for one in entries()] == ["2"]


@pytest.mark.slow
def test_two_processes_add_at_once(library):
    program = (
        "import sys, time\nfrom dataclasses import replace\nfrom made.small_gel import calibration\n"
        "from gelform.calibration.library.library import add_calibration\n"
        "time.sleep(max(0, float(sys.argv[1]) - time.time()))\n"
        "for k in range(20): add_calibration(replace(calibration(), serial=f'S{k}'))"
    )
    start = str(time.time() + 3)
    paths = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    env = {**os.environ, "PYTHONPATH": paths}
    both = [subprocess.Popen([sys.executable, "-c", program, start], env=env) for _ in range(2)]
    assert [one.wait() for one in both] == [0, 0]
    assert sorted(entry.serial for entry in entries()) == sorted(f"S{k}" for k in range(20))
    assert not [path for path in library.iterdir() if path.suffix != ".npz"]


def test_a_folder_that_cannot_be_made_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(DataError, match="Cannot make the folder"):
        add_calibration(OLD, tmp_path / "file" / "library")
    assert entries(tmp_path / "nowhere") == []
