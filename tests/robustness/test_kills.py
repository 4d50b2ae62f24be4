"""Killed at any moment: what is under its name is whole, and what was there stays.

`GELFORM_ROBUSTNESS_FACTOR=5` asks for the 20 kills of each command that the guarantees speak of.

Full and read-only disks, no home: one sentence before the work, and nothing that stays.

Calls of the command line with odd arguments and damaged inputs: each ends well, or in a sentence; none in a bug.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np
import pytest

import gelform
from gelform.cli import main
from gelform.cli.app import command_names
from hostile.calls import inputs_in, is_fault, known_faults, made_calls
from hostile.commands import LIBRARY, SERVERS, WRITE_NOTHING, commands, make_work, prepare
from hostile.outcome import FACTOR
from made.sources import small_disk

COMMANDS = ("calibrate", "import", "reconstruct", "simulate")
KILLS = 2 if FACTOR < 5 else 20
MARK_KILLS_1 = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return make_work(tmp_path_factory.mktemp("work"))


def start(arguments, before=lambda: None):
    """The command in a forked process, which says nothing."""
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        before()
        main([str(one) for one in arguments])
    except SystemExit as stopped:
        status = stopped.code or 0
    finally:
        os._exit(status if isinstance(status, int) else 70)


def assert_whole(out):
    """Every file under a name of its own can be read; what is half-written, or beside half-written, has a hidden one."""
    for path in sorted(out.rglob("*")):
        if any(part.startswith(".") for part in path.relative_to(out).parts):
            continue
        if path.suffix == ".png":
            gelform.read_image(path)
        if path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as file:
                assert [file[name].shape for name in file.files]  # each read to its end
            if "truth" not in path.parts:
                (gelform.load_result if path.parent.name == "results" else gelform.load_calibration)(path)


@pytest.mark.slow
@MARK_KILLS_1
@pytest.mark.parametrize("name", COMMANDS)
def test_killed_at_random_moments(work, tmp_path, name):
    rng = np.random.default_rng(11)
    begin = time.monotonic()
    assert os.waitpid(start(commands(work, tmp_path / "whole")[name], (tmp_path / "whole").mkdir), 0)[1] == 0
    usual = time.monotonic() - begin
    for kill in range(KILLS):
        out = tmp_path / f"killed{kill}"
        out.mkdir()
        child = start(commands(work, out)[name])
        time.sleep(rng.uniform(0, usual))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        assert_whole(out)


@pytest.mark.slow
@MARK_KILLS_1
@pytest.mark.parametrize("step", ["fsync", "replace"])
@pytest.mark.parametrize("there_before", [False, True])
def test_killed_at_each_step_of_writing(work, tmp_path, step, there_before):
    """The old file or nothing: never half of the new one."""
    target = tmp_path / "imported.npz"
    arguments = commands(work, tmp_path)["import"]
    if there_before:
        assert os.waitpid(start(arguments), 0)[1] == 0
        before = target.read_bytes()
        arguments = [*arguments, "--overwrite"]

    def kill_there():
        setattr(os, step, lambda *_: os.kill(os.getpid(), signal.SIGKILL))

    _, status = os.waitpid(start(arguments, kill_there), 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    assert (target.read_bytes() == before) if there_before else not target.exists()
    assert os.waitpid(start(arguments), 0)[1] == 0  # what is left over is in nobody's way
    gelform.load_calibration(target)


MARK_DISKS_1 = pytest.mark.skipif(sys.platform != "linux", reason="mounts a tmpfs")
WRITERS = tuple(name for name in command_names() if name not in (*WRITE_NOTHING, *LIBRARY, *SERVERS))


@pytest.mark.slow
@MARK_DISKS_1
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


@pytest.mark.slow
@MARK_DISKS_1
@pytest.mark.parametrize(("name", "kilobytes"), [*((name, 0) for name in WRITERS), *FILLS_UP])
def test_a_full_disk_is_one_sentence_and_nothing_stays(work, tmp_path, capfd, name, kilobytes):
    with disk(tmp_path / "disk", kilobytes) as out:
        before = contents(out)
        assert "No space left on device" in said_by(commands(work, out)[name], capfd)
        assert contents(out) == before


@pytest.mark.slow
@MARK_DISKS_1
def test_a_report_that_does_not_fit_leaves_the_calibration_and_says_so(work, tmp_path, capfd):
    with disk(tmp_path / "disk", 220) as out:
        said = said_by([*commands(work, out)["calibrate"], "--quiet"], capfd)
        assert "cal.npz, but not" in said
        assert contents(out).keys() == {"sensor.toml", "filler", "cal.npz"}
        assert not list(out.rglob(".*"))


@pytest.mark.slow
@MARK_DISKS_1
@pytest.mark.parametrize("name", WRITERS)
def test_a_read_only_disk_is_one_sentence(work, tmp_path, capfd, name):
    with disk(tmp_path / "disk", 500) as out:
        subprocess.run(["mount", "-o", "remount,ro", out], check=True)
        assert "Read-only file system" in said_by(commands(work, out)[name], capfd)


@pytest.mark.slow
@MARK_DISKS_1
def test_no_home_and_no_cache_are_no_matter(work, tmp_path):
    """Pictures are drawn all the same, and nothing is said of it."""
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"), "/dev/null/none")
    command = [*commands(work, tmp_path)["reconstruct"], "--format", "npz,png", "--quiet"]
    program = [sys.executable, "-m", "gelform", *map(str, command)]
    done = subprocess.run(program, capture_output=True, text=True, env={**os.environ, **nowhere})
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list((tmp_path / "results").glob("*.png"))) == 3


CALLS = round(30 * FACTOR)


@pytest.mark.slow
def test_no_call_ends_in_a_bug(tmp_path, monkeypatch, capfd):
    (tmp_path / "inputs").mkdir()
    template, faults = inputs_in(tmp_path / "inputs" / "work"), []
    known = len(list(known_faults(template, tmp_path)))
    template = inputs_in(tmp_path / "whole")
    for call, here in made_calls(template, tmp_path, known + CALLS, seed=1):
        for name in ("HOME", "XDG_DATA_HOME", "XDG_CACHE_HOME"):
            monkeypatch.setenv(name, str(here / "home"))
        monkeypatch.chdir(here)
        with pytest.raises(SystemExit) as stopped:
            main(call)
        said = capfd.readouterr()
        if is_fault(stopped.value.code or 0, said.out + said.err):
            faults.append(f"{shlex.join(call)[:300]}: {said.err[-300:]}")
        monkeypatch.chdir(tmp_path)
    assert faults == []
