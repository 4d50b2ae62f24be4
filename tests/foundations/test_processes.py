"""Processes that are killed, or whose starter is: nobody waits for ever, nobody is left."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import subprocess
import sys
import time

import pytest

from gelform.foundations.processes import WorkerLostError, worker_processes

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks for processes in /proc")
DRIVER = """
import sys, time
from gelform.foundations.processes import worker_processes
if __name__ == "__main__":
    with worker_processes(2) as pool:
        jobs = [pool.submit(time.sleep, 0) for _ in range(8)]
        print(*pool._processes, flush=True)
        time.sleep(60)
"""


def raise_named(name):
    raise ValueError(name)


def test_work_is_done_and_its_own_errors_come_through():
    with worker_processes(2) as pool:
        assert list(pool.map(abs, range(-5, 0))) == [5, 4, 3, 2, 1]
        with pytest.raises(ValueError, match="mine"):
            pool.submit(raise_named, "mine").result()


def test_a_full_disk_is_no_lost_worker():
    with pytest.raises(OSError, match="No space left"), worker_processes(2):
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.slow
@pytest.mark.parametrize("wait_s", [0, 0.02, 0.3])
def test_one_that_is_killed_ends_the_others_too(wait_s):
    """Also while the pool starts them, which Python's own then forgets."""
    before = set(multiprocessing.active_children())

    def kill_one():
        with worker_processes(2) as pool:
            jobs = [pool.submit(time.sleep, 0.2)]
            first = next(iter(set(multiprocessing.active_children()) - before))
            time.sleep(wait_s)
            os.kill(first.pid, signal.SIGKILL)
            jobs += [pool.submit(time.sleep, 0.2) for _ in range(7)]
            for job in jobs:
                job.result()

    with pytest.raises(WorkerLostError, match=r"of memory\. Run the same command again, with fewer"):
        kill_one()
    assert set(multiprocessing.active_children()) <= before


@pytest.mark.slow
def test_they_end_with_the_one_that_started_them():
    with subprocess.Popen([sys.executable, "-c", DRIVER], stdout=subprocess.PIPE, text=True) as driver:
        numbers = [int(word) for word in driver.stdout.readline().split()]
        driver.kill()
    assert len(numbers) == 2
    deadline = time.monotonic() + 20
    while any(os.path.exists(f"/proc/{number}/exe") for number in numbers):
        assert time.monotonic() < deadline, "a worker outlived its driver"
        time.sleep(0.01)
