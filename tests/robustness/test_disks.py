"""Full and read-only disks, no home: one sentence before the work, and nothing that stays."""

from __future__ import annotations

import os
import subprocess
import sys
from contextlib import contextmanager

import pytest

from gelform.cli import main
from gelform.cli.app import command_names
from hostile.commands import LIBRARY, SERVERS, WRITE_NOTHING, commands, make_work, prepare
from made.small_disk import small_disk

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")]
WRITERS = tuple(name for name in command_names() if name not in (*WRITE_NOTHING, *LIBRARY, *SERVERS))


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return make_work(tmp_path_factory.mktemp("work"))


def test_every_command_that_writes_is_tried(work):
    """A new one needs its arguments in hostile/commands.py."""
    assert set(WRITERS) == set(commands(work, work))


@contextmanager
def disk(folder, kilobytes):
    """A file system of 1 MB with something to edit, filled but for so many kilobytes."""
    with small_disk(folder, 1024):
        prepare(folder)
        (folder / "filler").write_bytes(bytes((1024 - kilobytes) * 1024 - 4096))
        yield folder


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def said_by(arguments, capfd):
    """What a command that fails says, which is one line."""
    with pytest.raises(SystemExit) as stopped:
        main([str(one) for one in arguments])
    said = capfd.readouterr().err
    assert stopped.value.code == 1
    assert said.startswith("gelform: error: ")
    assert said.count("\n") == 1
    return said


FILLS_UP = [("reconstruct", 60), ("simulate", 40), ("import", 40), ("compare", 40)]


@pytest.mark.parametrize(("name", "kilobytes"), [*((name, 0) for name in WRITERS), *FILLS_UP])
def test_a_full_disk_is_one_sentence_and_nothing_stays(work, tmp_path, capfd, name, kilobytes):
    with disk(tmp_path / "disk", kilobytes) as out:
        before = contents(out)
        assert "No space left on device" in said_by(commands(work, out)[name], capfd)
        assert contents(out) == before


def test_a_report_that_does_not_fit_leaves_the_calibration_and_says_so(work, tmp_path, capfd):
    with disk(tmp_path / "disk", 220) as out:
        said = said_by([*commands(work, out)["calibrate"], "--quiet"], capfd)
        assert "cal.npz, but not" in said
        assert contents(out).keys() == {"sensor.toml", "filler", "cal.npz"}
        assert not list(out.rglob(".*"))


@pytest.mark.parametrize("name", WRITERS)
def test_a_read_only_disk_is_one_sentence(work, tmp_path, capfd, name):
    with disk(tmp_path / "disk", 500) as out:
        subprocess.run(["mount", "-o", "remount,ro", out], check=True)
        assert "Read-only file system" in said_by(commands(work, out)[name], capfd)


def test_no_home_and_no_cache_are_no_matter(work, tmp_path):
    """Pictures are drawn all the same, and nothing is said of it."""
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"), "/dev/null/none")
    command = [*commands(work, tmp_path)["reconstruct"], "--format", "npz,png", "--quiet"]
    program = [sys.executable, "-m", "gelform", *map(str, command)]
    done = subprocess.run(program, capture_output=True, text=True, env={**os.environ, **nowhere})
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list((tmp_path / "results").glob("*.png"))) == 3
