"""Several processes give what one gives; one that is killed is said, and what is done is kept."""

import os
import signal

import pytest

from gelform.batch.engines import WorkerLostError
from gelform.batch.engines.processes import done_parts
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import plan_of
from gelform.batch.records import read_record
from gelform.batch.settings import BatchSettings
from gelform.batch.work import Job

pytestmark = pytest.mark.skipif(os.name != "posix", reason="kills a process")


def children():
    """Processes that this one started, by the system's own list."""
    listed = f"/proc/self/task/{os.getpid()}/children"
    if not os.path.exists(listed):
        pytest.skip("this system does not list a process's children")
    with open(listed) as file:
        return {int(number) for number in file.read().split()}


def command_of(number):
    with open(f"/proc/{number}/cmdline", "rb") as file:
        return file.read()


@pytest.mark.slow
def test_two_processes_and_one_of_them_killed(tree, cal, tmp_path, visible):
    parts = plan_of(listing_of(tree), 1)
    alone = Job(cal, None, tmp_path / "one", BatchSettings())
    assert [counts for _, *counts in done_parts(alone, parts, 1)] == [[1, 0]] * len(parts)
    killed = Job(cal, None, tmp_path / "two", BatchSettings())
    before = children()
    done = done_parts(killed, parts * 50, 2)  # the same again and again: longer than the kill takes
    next(done)
    workers = [one for one in children() - before if b"spawn_main" in command_of(one)]
    assert len(workers) == 2
    os.kill(workers[0], signal.SIGKILL)
    with pytest.raises(WorkerLostError, match="What is done is kept, and not done again"):
        list(done)
    kept = [
        part
        for part in parts
        if (tmp_path / "two" / "parts").exists() and read_record(killed.output, part.number)
    ]
    assert kept
    two = visible(tmp_path / "two")
    one = visible(tmp_path / "one")
    assert {name: one[name] for name in two} == two
