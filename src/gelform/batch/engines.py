"""The engines of a batch: this process, a pool of processes on this machine, or Ray. Parts may end in any order.

Ray's machines must see the same files under the same paths.
"""

from __future__ import annotations

import pickle
import secrets
import tempfile
from collections.abc import Generator, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.sharedctypes import RawValue
from pathlib import Path
from typing import Any, Protocol

import cv2

from gelform.batch.inputs.plan import Part
from gelform.batch.records import PartRecord
from gelform.batch.work import Job, Stopped, Worker
from gelform.errors import GelformError, needed
from gelform.foundations.checks import check_choice
from gelform.foundations.processes import WorkerLostError, interrupt_held, worker_processes

NOTHING_LOST = "What is done is kept, and not done again."
TRIES_AGAIN = 5  # repetitions of a part whose worker or machine is lost; its bytes are the same
WAITING_PER_CPU = 2  # queued tasks: a worker never waits, and memory holds no million tasks
MEMORY_BYTES = 600 << 20  # memory of a task that Ray reserves

_worker: Worker | None = None
_stop: Any = None
_run: str | None = None  # the Ray run that the worker was made for


class DoneParts(Protocol):
    """Does parts; yields each finished part with its numbers of frames and of errors.

    Closing the iterator ends the work between two frames; unfinished parts leave no record. Raises WorkerLostError if
    workers were killed, and DataError if an output cannot be written.
    """

    def __call__(
        self, job: Job, parts: Sequence[Part], workers: int, address: str | None = None
    ) -> Generator[tuple[Part, int, int], None, None]: ...


def done_parts(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[tuple[Part, int, int], None, None]:
    """Do parts in this process, or in several on this machine; takes no address (see `DoneParts`)."""
    if workers == 1:
        worker = Worker(job)
        for part in parts:
            yield part, *_counts(worker.do(part))
        return
    stop = RawValue("b", 0)  # without a lock, which a killed worker would hold forever
    with tempfile.TemporaryDirectory(prefix="gelform-batch-") as folder:
        shared = Path(folder) / "job"  # a file, because it may be large
        shared.write_bytes(pickle.dumps(job))
        with worker_processes(workers, _prepare, shared, stop, kept=NOTHING_LOST) as pool:
            try:
                with interrupt_held():
                    waiting = {pool.submit(_do, part): part for part in parts}
                for future in as_completed(waiting):
                    yield waiting.pop(future), *future.result()
            finally:
                stop.value = 1


def done_parts_on_ray(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[tuple[Part, int, int], None, None]:
    """Do parts as Ray tasks with one CPU each (see `DoneParts`); without an address, start Ray here."""
    ray = needed("ray", "ray", "The engine ray")
    with _connected(ray, workers, address):
        do = ray.remote(num_cpus=1, memory=MEMORY_BYTES, max_retries=TRIES_AGAIN)(_do_on_ray)
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


ENGINES: dict[str, DoneParts] = {"pool": done_parts, "ray": done_parts_on_ray}


@dataclass(frozen=True)
class Engine:
    """The engine, and the number of parts at once.

    Attributes
    ----------
    name : one of ENGINES
    workers : processes of the pool; CPUs of Ray if `address` is None
    address : address of a running Ray cluster, such as "auto" or "ray://head:10001"

    Raises
    ------
    ValueError
        The name is unknown, workers is below 1, or the pool got an address.
    """

    name: str = "pool"
    workers: int = 1
    address: str | None = None

    def __post_init__(self) -> None:
        check_choice(self.name, ENGINES, "an engine")
        if self.workers < 1:
            raise ValueError(f"Expected at least one worker, got {self.workers}.")
        if self.address is not None and self.name != "ray":
            raise ValueError(f"Expected an address with the engine ray, got one with {self.name}.")

    def done(self, job: Job, parts: Sequence[Part]) -> Generator[tuple[Part, int, int], None, None]:
        """Do parts (see `DoneParts`)."""
        workers = min(self.workers, max(1, len(parts)))
        return ENGINES[self.name](job, parts, workers, self.address)


def _counts(record: PartRecord) -> tuple[int, int]:
    return len(record.rows), record.errors


def _prepare(shared: Path, stop: Any) -> None:
    """Prepare a worker process for its first part."""
    global _worker, _stop
    _worker, _stop = Worker(pickle.loads(shared.read_bytes())), stop


def _do(part: Part) -> tuple[int, int]:
    assert _worker is not None
    try:
        return _counts(_worker.do(part, lambda: bool(_stop.value)))
    except Stopped:
        return 0, 0


def _do_on_ray(run: str, job: Job, part: Part) -> tuple[int, int]:
    """Do a part in a worker process of Ray; each worker prepares the Reconstructor once."""
    global _worker, _run
    if _worker is None or _run != run:
        cv2.setNumThreads(1)
        _worker, _run = Worker(job), run
    return _counts(_worker.do(part))


@contextmanager
def _connected(ray: Any, workers: int, address: str | None) -> Any:
    """Connect to Ray; an existing connection stays open."""
    if ray.is_initialized():
        yield
        return
    local = {"num_cpus": workers, "include_dashboard": False} if address is None else {"address": address}
    try:
        ray.init(log_to_driver=False, logging_level="ERROR", **local)
    except Exception as problem:  # Ray raises a plain Exception if one of its own processes does not start
        what = "start Ray here" if address is None else f"reach Ray at {address}"
        said = str(problem).rstrip(".")
        raise WorkerLostError(f"Cannot {what}: {said}. Look at: ray status.") from problem
    try:
        yield
    finally:
        ray.shutdown()


def _result(ray: Any, done: Any) -> tuple[int, int]:
    """The result of a task; its errors are raised here unchanged."""
    lost = ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError
    try:
        counts: tuple[int, int] = ray.get(done)
        return counts
    except ray.exceptions.RayTaskError as problem:
        if isinstance(problem.cause, GelformError):
            raise problem.cause from None
        raise
    except lost as problem:
        raise WorkerLostError(
            f"A part's worker was lost {TRIES_AGAIN + 1} times, perhaps for want of memory: {problem} {NOTHING_LOST} Run "
            "the same command again."
        ) from problem
