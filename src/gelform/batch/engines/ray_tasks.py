"""Parts as tasks of Ray, on this machine or on a cluster whose machines see the same files under the same paths."""

from __future__ import annotations

import secrets
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Any

from gelform.batch.engines.processes import KEPT
from gelform.batch.extras import needed
from gelform.batch.inputs.plan import Part
from gelform.batch.work import Job, Worker
from gelform.errors import GelformError
from gelform.processes import WorkerLostError

TRIES_AGAIN = 5  # of a part whose worker or machine is lost; it writes the same bytes each time
WAITING_PER_CPU = 2  # so that a worker never waits for the driver, and no million tasks wait in memory
MEMORY_BYTES = 600 << 20  # of a task, which Ray sets aside

_prepared: tuple[str, Worker] | None = None


def done_parts_on_ray(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[tuple[Part, int, int], None, None]:
    """Do parts as Ray's tasks, of one CPU each (see `DoneParts`).

    Parameters
    ----------
    workers : CPUs of a Ray that is started here and ended with the run
    address : of one that runs already

    Raises
    ------
    WorkerLostError
        A part's worker was lost six times, or Ray cannot be reached.
    DataError
        Ray is not installed; an output cannot be written.
    """
    ray = needed("ray", "ray", "The engine ray")
    with _connected(ray, workers, address):
        do = ray.remote(num_cpus=1, memory=MEMORY_BYTES, max_retries=TRIES_AGAIN)(_do)
        run, shared, todo = secrets.token_hex(8), ray.put(job), iter(parts)
        most = WAITING_PER_CPU * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting: dict[Any, Part] = {}
        try:
            while True:
                for part in todo:
                    waiting[do.remote(run, shared, part)] = part
                    if len(waiting) >= most:
                        break
                if not waiting:
                    return
                (done,), _ = ray.wait(list(waiting), num_returns=1)
                yield waiting.pop(done), *_result(ray, done)
        finally:
            for one in waiting:
                ray.cancel(one)
            ray.wait(list(waiting), num_returns=len(waiting), timeout=10) if waiting else None


@contextmanager
def _connected(ray: Any, workers: int, address: str | None) -> Any:
    """Connected to Ray; one that was there before stays connected."""
    if ray.is_initialized():
        yield
        return
    local = {"num_cpus": workers, "include_dashboard": False} if address is None else {"address": address}
    try:
        ray.init(log_to_driver=False, logging_level="ERROR", **local)
    except Exception as problem:  # Ray raises Exception itself where one of its own processes does not start
        what = "start Ray here" if address is None else f"reach Ray at {address}"
        said = str(problem).rstrip(".")
        raise WorkerLostError(f"Cannot {what}: {said}. Look at: ray status.") from problem
    try:
        yield
    finally:
        ray.shutdown()


def _result(ray: Any, done: Any) -> tuple[int, int]:
    """What a task gave; an error of ours is raised as it was there."""
    try:
        counts: tuple[int, int] = ray.get(done)
        return counts
    except ray.exceptions.RayTaskError as problem:
        if isinstance(problem.cause, GelformError):
            raise problem.cause from None
        raise
    except (
        ray.exceptions.WorkerCrashedError,
        ray.exceptions.NodeDiedError,
        ray.exceptions.OutOfMemoryError,
    ) as problem:
        raise WorkerLostError(
            f"A part's worker was lost {TRIES_AGAIN + 1} times, perhaps for want of memory: {problem} {KEPT} Run "
            "the same command again."
        ) from problem


def _do(run: str, job: Job, part: Part) -> tuple[int, int]:
    """A part, in a worker process of Ray; the Reconstructor is prepared once in each."""
    global _prepared
    if _prepared is None or _prepared[0] != run:
        import cv2

        cv2.setNumThreads(1)
        _prepared = run, Worker(job)
    record = _prepared[1].do(part)
    return len(record.rows), record.errors
