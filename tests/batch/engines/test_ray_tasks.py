"""Ray writes the bytes of a run without it; a worker that is killed is done again; errors are ours."""

import os
import signal
import threading
import time

import pytest

from gelform.batch import BatchSettings, Engine, run_batch
from gelform.errors import DataError

PARTS = BatchSettings(part_frames=2)
RAY = Engine("ray", 2)


@pytest.fixture(scope="module")
def ray():
    ray = pytest.importorskip("ray", reason="the extra ray is not installed")
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR")
    yield ray
    ray.shutdown()


def test_the_same_bytes_as_without(ray, broken_tree, cal, tmp_path, visible):
    here = run_batch(broken_tree, cal, tmp_path / "a", PARTS, table="csv")
    there = run_batch(broken_tree, cal, tmp_path / "b", PARTS, table="csv", engine=RAY)
    assert (there.frames, there.errors, there.complete) == (here.frames, 4, True)
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


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
    assert run_batch(
        tree, cal, tmp_path / "b", BatchSettings(part_frames=1), table="csv", engine=RAY
    ).complete
    killer.join()
    run_batch(tree, cal, tmp_path / "a", BatchSettings(part_frames=1), table="csv")
    assert visible(tmp_path / "a") == visible(tmp_path / "b")


def test_an_output_that_cannot_be_written_is_our_error(ray, tree, cal, tmp_path):
    (tmp_path / "out/frames/frame1.npz").mkdir(parents=True)
    run = {"settings": PARTS, "engine": RAY}
    (tmp_path / "out/frames").rename(tmp_path / "kept")
    assert run_batch(tree, cal, tmp_path / "out", **run).complete
    (tmp_path / "out/frames/frame1.npz").unlink()
    (tmp_path / "out/frames/frame1.npz").mkdir()
    with pytest.raises(DataError, match="got the folder"):
        run_batch(tree, cal, tmp_path / "out", **run)


def test_without_ray_the_extra_is_named(tree, cal, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "ray", None)
    with pytest.raises(DataError, match=r"gelform\[ray\]"):
        run_batch(tree, cal, tmp_path / "out", PARTS, engine=RAY)
