"""Killed at any moment: what is under its name is whole, and what was there stays.

`GELFORM_ROBUSTNESS_FACTOR=5` asks for the 20 kills of each command that the guarantees speak of.

Full and read-only disks, no home: one sentence before the work, and nothing that stays.

Calls of the command line with odd arguments and damaged inputs: each ends well, or in a sentence; none in a bug.

A batch killed at any moment, or out of disk: the same command gives the bytes of an undisturbed run.
"""

from __future__ import annotations

import os
import shlex
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.cli import main
from gelform.cli.app import command_names
from gelform.errors import DataError
from hostile.calls import inputs_in, is_fault, known_faults, made_calls
from hostile.commands import LIBRARY, SERVERS, WRITE_NOTHING, commands, make_work, prepare
from hostile.outcome import FACTOR
from live_waiting import until
from made.files import visible
from made.small_gel import Touch, calibration, image_of, save
from made.sources import small_disk

COMMANDS = ("calibrate", "import", "reconstruct", "simulate")
KILLS = 2 if FACTOR < 5 else 20
CAN_FORK = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")
ON_LINUX = pytest.mark.skipif(sys.platform != "linux", reason="kills processes, mounts a tmpfs")
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return make_work(tmp_path_factory.mktemp("work"))


def forked(do):
    """Do something in a forked process, which says nothing."""
    child = os.fork()
    if child:
        return child
    status = 70
    try:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        do()
    except SystemExit as stopped:
        status = stopped.code or 0
    finally:
        os._exit(status if isinstance(status, int) else 70)


def start(arguments, before=lambda: None):
    """The command in a forked process."""
    return forked(lambda: (before(), main([str(one) for one in arguments])))


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


@CAN_FORK
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


@CAN_FORK
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
        for name in (step, "link") if step == "replace" else (step,):  # a new name is a link
            setattr(os, name, lambda *_: os.kill(os.getpid(), signal.SIGKILL))

    _, status = os.waitpid(start(arguments, kill_there), 0)
    assert os.WTERMSIG(status) == signal.SIGKILL
    assert (target.read_bytes() == before) if there_before else not target.exists()
    assert os.waitpid(start(arguments), 0)[1] == 0  # what is left over is in nobody's way
    gelform.load_calibration(target)


WRITERS = tuple(name for name in command_names() if name not in (*WRITE_NOTHING, *LIBRARY, *SERVERS))


@ON_LINUX
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


@ON_LINUX
@pytest.mark.parametrize(("name", "kilobytes"), [*((name, 0) for name in WRITERS), *FILLS_UP])
def test_a_full_disk_is_one_sentence_and_nothing_stays(work, tmp_path, capfd, name, kilobytes):
    with disk(tmp_path / "disk", kilobytes) as out:
        before = contents(out)
        assert "No space left on device" in said_by(commands(work, out)[name], capfd)
        assert contents(out) == before


@ON_LINUX
def test_a_report_that_does_not_fit_leaves_the_calibration_and_says_so(work, tmp_path, capfd):
    with disk(tmp_path / "disk", 220) as out:
        said = said_by([*commands(work, out)["calibrate"], "--quiet"], capfd)
        assert "cal.npz, but not" in said
        assert contents(out).keys() == {"sensor.toml", "filler", "cal.npz"}
        assert not list(out.rglob(".*"))


@ON_LINUX
@pytest.mark.parametrize("name", WRITERS)
def test_a_read_only_disk_is_one_sentence(work, tmp_path, capfd, name):
    with disk(tmp_path / "disk", 500) as out:
        subprocess.run(["mount", "-o", "remount,ro", out], check=True)
        assert "Read-only file system" in said_by(commands(work, out)[name], capfd)


@ON_LINUX
def test_no_home_and_no_cache_are_no_matter(work, tmp_path):
    """Pictures are drawn all the same, and nothing is said of it."""
    nowhere = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "MPLCONFIGDIR"), "/dev/null/none")
    command = [*commands(work, tmp_path)["reconstruct"], "--format", "npz,png", "--quiet"]
    program = [sys.executable, "-m", "gelform", *map(str, command)]
    done = subprocess.run(program, capture_output=True, text=True, env={**os.environ, **nowhere})
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert len(list((tmp_path / "results").glob("*.png"))) == 3


CALLS = round(30 * FACTOR)


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


IMAGES, PART_FRAMES = 24, 3
DRIVER = """
import sys
from gelform.batch import BatchSettings, Engine, run_batch
if __name__ == "__main__":
    source, calibration, output, workers = sys.argv[1:]
    run_batch(source, calibration, output, BatchSettings(part_frames={part_frames}), engine=Engine("pool", int(workers)))
"""


@pytest.fixture(scope="module")
def data_set(tmp_path_factory):
    """Images in two folders with two that are no images among them, a calibration, an undisturbed run and its seconds."""
    folder = tmp_path_factory.mktemp("data_set")
    for k in range(IMAGES):
        path = folder / "in" / str(k % 2) / f"{k}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        save(path, image_of(Touch(x_px=20 + k, seed=k)))
    (folder / "in" / "0" / "cut.png").write_bytes(path.read_bytes()[:500])
    (folder / "in" / "1" / "empty.png").write_bytes(b"")
    calibration().save(folder / "cal.npz")
    (folder / "driver.py").write_text(DRIVER.format(part_frames=PART_FRAMES))
    go_on(folder, folder / "whole")
    return folder


def go_on(data_set, output):
    return run_batch(data_set / "in", data_set / "cal.npz", output, BatchSettings(part_frames=PART_FRAMES))


def started(data_set, output, workers, driver=None):
    command = [
        sys.executable,
        driver or data_set / "driver.py",
        data_set / "in",
        data_set / "cal.npz",
        output,
        workers,
    ]
    return subprocess.Popen(list(map(str, command)), stderr=subprocess.DEVNULL)


def workers_of(process):
    """The processes that do parts."""
    listed = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    found = []
    for number in listed.read_text().split():
        try:
            command = Path(f"/proc/{number}/cmdline").read_bytes()
        except OSError:  # it has ended
            continue
        found += [int(number)] if b"spawn_main" in command else []
    return found


def wait_for_parts(process, output, count):
    """Until so many parts are done, or the run has ended."""
    while process.poll() is None and len(list(output.glob("parts/*/*.json"))) < count:
        time.sleep(0.002)


def assert_only_whole_files(data_set, output):
    """What is under its name is what an undisturbed run has there."""
    whole = visible(data_set / "whole")
    for name, content in visible(output).items():
        assert content == whole[name], name


def assert_goes_on(data_set, output):
    summary = go_on(data_set, output)
    assert (summary.complete, summary.errors) == (True, 2)
    assert visible(output) == visible(data_set / "whole")
    assert not list(output.rglob(".gelform-*.tmp"))
    assert verify_output(output) == (IMAGES, 2, [])


@ON_LINUX
def test_the_driver_killed_at_random_moments(data_set, tmp_path):
    rng = np.random.default_rng(16)
    for kill in range(KILLS):
        output = tmp_path / str(kill)
        begin = time.monotonic()
        go_on(data_set, tmp_path / f"usual{kill}")
        usual_s = time.monotonic() - begin
        child = forked(lambda output=output: go_on(data_set, output))
        time.sleep(rng.uniform(0, usual_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        output.mkdir(exist_ok=True)
        assert_only_whole_files(data_set, output)
        assert_goes_on(data_set, output)


@ON_LINUX
@pytest.mark.parametrize("who", ["worker", "driver"])
def test_one_of_a_pool_killed_at_random_moments(data_set, tmp_path, who):
    """Workers end with their driver: nobody writes after it, but for the frame that is at the disk."""
    rng = np.random.default_rng(17)
    for kill in range(KILLS // 2):
        output = tmp_path / str(kill)
        process = started(data_set, output, 2)
        wait_for_parts(process, output, int(rng.integers(1, 5)))
        workers = workers_of(process) if process.poll() is None else []
        time.sleep(rng.uniform(0, 0.03))
        for number in workers[:1] if who == "worker" else [process.pid]:
            if Path(f"/proc/{number}").exists():
                os.kill(number, signal.SIGKILL)
        process.wait(60)
        for number in workers:  # none outlives its driver
            until(lambda number=number: not Path(f"/proc/{number}/cmdline").exists())
        assert_only_whole_files(data_set, output)
        assert_goes_on(data_set, output)


@ON_LINUX
def test_a_worker_killed_while_it_starts(data_set, tmp_path):
    """The driver ends all the same, though what it hands over (a background, too) is larger than a pipe holds."""
    save(data_set / "rest.png", image_of(None))
    rest = f"background={str(data_set / 'rest.png')!r}, engine="
    driver = tmp_path / "driver.py"
    driver.write_text((data_set / "driver.py").read_text().replace("engine=", rest))
    process = started(data_set, tmp_path / "out", 2, driver)
    workers = until(lambda: workers_of(process))
    os.kill(workers[0], signal.SIGKILL)
    assert process.wait(60) != 0
    assert started(data_set, tmp_path / "out", 2, driver).wait(60) == 0
    assert verify_output(tmp_path / "out") == (IMAGES, 2, [])


@ON_LINUX
def test_a_disk_that_fills_up_is_said_and_the_run_goes_on_when_there_is_room(data_set, tmp_path):
    with small_disk(tmp_path / "disk", 2048) as disk:
        (disk / "filler").write_bytes(bytes(1_800_000))
        with pytest.raises(DataError, match="No space left on device"):
            go_on(data_set, disk / "out")
        assert_only_whole_files(data_set, disk / "out")
        assert any((disk / "out" / "frames").rglob("*.npz"))
        (disk / "filler").unlink()
        assert_goes_on(data_set, disk / "out")
