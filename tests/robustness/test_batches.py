"""A batch killed at any moment, or out of disk: the same command gives the bytes of an undisturbed run.

`GELFORM_ROBUSTNESS_FACTOR=5` asks for 20 kills of the driver and 20 of a worker.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.errors import DataError
from hostile.outcome import FACTOR
from live_waiting import until
from made.small_gel import Touch, calibration, image_of, save
from made.sources import small_disk

IMAGES, PART_FRAMES = 24, 3
KILLS = 2 if FACTOR < 5 else 20
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="kills processes, mounts a tmpfs"),
]
DRIVER = """
import sys
from gelform.batch import BatchSettings, Engine, run_batch
if __name__ == "__main__":
    source, calibration, output, workers = sys.argv[1:]
    run_batch(source, calibration, output, BatchSettings(part_frames={part_frames}), engine=Engine("pool", int(workers)))
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    """Images in two folders with two that are no images among them, a calibration, an undisturbed run and its seconds."""
    folder = tmp_path_factory.mktemp("work")
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


def go_on(work, output):
    return run_batch(work / "in", work / "cal.npz", output, BatchSettings(part_frames=PART_FRAMES))


def visible(folder):
    paths = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def started(work, output, workers, driver=None):
    command = [sys.executable, driver or work / "driver.py", work / "in", work / "cal.npz", output, workers]
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


def assert_only_whole_files(work, output):
    """What is under its name is what an undisturbed run has there."""
    whole = visible(work / "whole")
    for name, content in visible(output).items():
        assert content == whole[name], name


def assert_goes_on(work, output):
    summary = go_on(work, output)
    assert (summary.complete, summary.errors) == (True, 2)
    assert visible(output) == visible(work / "whole")
    assert not list(output.rglob(".gelform-*.tmp"))
    assert verify_output(output) == (IMAGES, 2, [])


def forked(work, output):
    """The run in a forked process, which says nothing."""
    child = os.fork()
    if child == 0:
        try:
            go_on(work, output)
        finally:
            os._exit(0)
    return child


def test_the_driver_killed_at_random_moments(work, tmp_path):
    rng = np.random.default_rng(16)
    for kill in range(KILLS):
        output = tmp_path / str(kill)
        begin = time.monotonic()
        go_on(work, tmp_path / f"usual{kill}")
        usual_s = time.monotonic() - begin
        child = forked(work, output)
        time.sleep(rng.uniform(0, usual_s))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        output.mkdir(exist_ok=True)
        assert_only_whole_files(work, output)
        assert_goes_on(work, output)


@pytest.mark.parametrize("who", ["worker", "driver"])
def test_one_of_a_pool_killed_at_random_moments(work, tmp_path, who):
    """Workers end with their driver: nobody writes after it, but for the frame that is at the disk."""
    rng = np.random.default_rng(17)
    for kill in range(KILLS // 2):
        output = tmp_path / str(kill)
        process = started(work, output, 2)
        wait_for_parts(process, output, int(rng.integers(1, 5)))
        workers = workers_of(process) if process.poll() is None else []
        time.sleep(rng.uniform(0, 0.03))
        for number in workers[:1] if who == "worker" else [process.pid]:
            if Path(f"/proc/{number}").exists():
                os.kill(number, signal.SIGKILL)
        process.wait(60)
        for number in workers:  # none outlives its driver
            until(lambda number=number: not Path(f"/proc/{number}/cmdline").exists())
        assert_only_whole_files(work, output)
        assert_goes_on(work, output)


def test_a_worker_killed_while_it_starts(work, tmp_path):
    """The driver ends all the same, though what it hands over (a background, too) is larger than a pipe holds."""
    save(work / "rest.png", image_of(None))
    rest = f"background={str(work / 'rest.png')!r}, engine="
    driver = tmp_path / "driver.py"
    driver.write_text((work / "driver.py").read_text().replace("engine=", rest))
    process = started(work, tmp_path / "out", 2, driver)
    workers = until(lambda: workers_of(process))
    os.kill(workers[0], signal.SIGKILL)
    assert process.wait(60) != 0
    assert started(work, tmp_path / "out", 2, driver).wait(60) == 0
    assert verify_output(tmp_path / "out") == (IMAGES, 2, [])


def test_a_disk_that_fills_up_is_said_and_the_run_goes_on_when_there_is_room(work, tmp_path):
    with small_disk(tmp_path / "disk", 2048) as disk:
        (disk / "filler").write_bytes(bytes(1_800_000))
        with pytest.raises(DataError, match="No space left on device"):
            go_on(work, disk / "out")
        assert_only_whole_files(work, disk / "out")
        assert any((disk / "out" / "frames").rglob("*.npz"))
        (disk / "filler").unlink()
        assert_goes_on(work, disk / "out")
