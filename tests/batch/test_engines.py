"""Several processes, or Ray, give the bytes of one process; a killed one is reported or repeated; errors are sentences."""

import os
import signal
import sys
import threading
import time

import pytest

from gelform.batch import BatchSettings, run_batch
from gelform.batch.engines import Engine, WorkerLostError, done_parts
from gelform.batch.inputs.listing import listing_of
from gelform.batch.inputs.plan import plan_of
from gelform.batch.records import read_record
from gelform.batch.work import Job
from gelform.errors import DataError

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
    assert any(read_record(killed.output, part.number) for part in parts)
    one, two = visible(tmp_path / "one"), visible(tmp_path / "two")
    assert {name: one[name] for name in two} == two


def test_refused(tree, cal, tmp_path, monkeypatch):
    for wrong, said in (
        ({"name": "dask"}, "Expected an engine among pool, ray, got 'dask'"),
        ({"workers": 0}, "at least one worker"),
        ({"address": "auto"}, "an address with the engine ray, got one with pool"),
    ):
        with pytest.raises(ValueError, match=said):
            Engine(**wrong)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(DataError, match=r"gelform\[ray\]"):
        run_batch(tree, cal, tmp_path / "out", PARTS, engine=RAY)


PARTS = BatchSettings(part_frames=2)
RAY = Engine("ray", 2)


@pytest.fixture(scope="module")
def ray():
    ray = pytest.importorskip("ray", reason="the extra ray is not installed")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


@pytest.mark.slow
def test_the_same_bytes_as_without(ray, broken_tree, cal, tmp_path, visible):
    here = run_batch(broken_tree, cal, tmp_path / "a", PARTS, table="csv")
    there = run_batch(broken_tree, cal, tmp_path / "b", PARTS, table="csv", engine=RAY)
    assert (there.frames, there.errors, there.complete) == (here.frames, 4, True)
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


@pytest.mark.slow
def test_a_worker_that_is_killed_is_done_again(ray, tree, cal, tmp_path, visible):
    @ray.remote
    def number():
        return os.getpid()

    numbers = set(ray.get([number.remote() for _ in range(8)]))

    def kill():
        time.sleep(0.3)
        for one in numbers:
            os.kill(one, signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    single = BatchSettings(part_frames=1)
    assert run_batch(tree, cal, tmp_path / "b", single, table="csv", engine=RAY).complete
    killer.join()
    run_batch(tree, cal, tmp_path / "a", single, table="csv")
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


@pytest.mark.slow
def test_an_output_that_cannot_be_written_is_our_error(ray, tree, cal, tmp_path):
    (tmp_path / "out/frames/frame1.npz").mkdir(parents=True)
    run = {"settings": PARTS, "engine": RAY}
    (tmp_path / "out/frames").rename(tmp_path / "kept")
    assert run_batch(tree, cal, tmp_path / "out", **run).complete
    (tmp_path / "out/frames/frame1.npz").unlink()
    (tmp_path / "out/frames/frame1.npz").mkdir()
    with pytest.raises(DataError, match="got the folder"):
        run_batch(tree, cal, tmp_path / "out", **run)
