"""Killed at any moment: what is under its name is whole, and what was there stays.

`GELFORM_ROBUSTNESS_FACTOR=5` asks for the 20 kills of each command that the guarantees speak of.
"""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest

import gelform
from gelform.cli import main
from hostile.budget import FACTOR
from hostile.commands import commands, make_work

COMMANDS = ("calibrate", "import", "reconstruct", "simulate")
KILLS = 2 if FACTOR < 5 else 20
pytestmark = [pytest.mark.slow, pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")]


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
