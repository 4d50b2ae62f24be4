"""The work on one part, a pure function, and its engines: this process, a pool of processes, or Ray.

Parts may end in any order. Ray's machines must see the same files under the same paths.
"""

from __future__ import annotations

import pickle
import secrets
import tempfile
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import as_completed
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from multiprocessing.sharedctypes import RawValue
from pathlib import Path
from typing import Any

import cv2
from numpy.typing import NDArray

from gelform import Calibration, Frame, Reconstructor
from gelform.batch.inputs import (
    Part,
    background_of_file,
    background_of_film,
    frames_of_part,
    image_of_calibration,
)
from gelform.batch.outputs.files import BatchSettings, PartTarget, PartWriter, facts_of
from gelform.batch.outputs.writers import WRITERS
from gelform.batch.records import COLUMNS, PartRecord, write_record
from gelform.errors import GelformError, needed, reason
from gelform.foundations.checks import check_choice
from gelform.foundations.processes import WorkerLostError, interrupt_held, worker_processes


class Stopped(Exception):
    """The run ends between two frames."""


@dataclass(frozen=True)
class Job:
    """The data that all parts share; plain, so that it can be sent to another process."""

    calibration: Calibration
    background: NDArray[Any] | None
    output: Path
    settings: BatchSettings
    background_files: Mapping[str, Path] = field(default_factory=dict)


class Worker:
    """Does parts one after the other; prepares the Reconstructor once, or once per film with its own background."""

    def __init__(self, job: Job) -> None:
        self.job = job
        self._prepared_for: tuple[str | None, ...] = ()
        self._reconstruct: Any = None

    def do(self, part: Part, stop: Callable[[], bool] = bool) -> PartRecord:
        """Write the outputs of a part, then its record, with the same bytes each time; Stopped if `stop()` returns True."""
        job, calibration, digest, rows = self.job, self.job.calibration, part.input_digest(), []
        facts = {"mm_per_px": calibration.mm_per_px, "calibration_digest": calibration.digest}
        target = PartTarget(job.output, part, job.settings, calibration.image_shape, facts)
        with WRITERS[job.settings.form].writer(target) as writer:
            for index, frame in frames_of_part(part, calibration.most_pixels):
                if stop():
                    raise Stopped
                rows.append(self._row(part, index, frame, writer))
        record = PartRecord(digest, tuple(rows), tuple(writer.files))
        write_record(job.output, part.number, record)
        return record

    def _row(
        self, part: Part, index: int, frame: Frame | BaseException, writer: PartWriter
    ) -> dict[str, Any]:
        """Write a frame's output; return its row for the table and the record."""
        row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
        row |= {"sequence": part.film.name, "frame": part.name_of(index), "index": index}
        error, prepared = "", None
        if isinstance(frame, Frame):
            times = {"time_s": frame.time_s, "wall_time_ns": frame.wall_time_ns} if part.film.is_timed else {}
            row |= times
            try:
                image = image_of_calibration(frame, self.job.calibration)
                result = self._prepared(part).from_image(image).changed(index=frame.index, **times)
                prepared, numbers = writer.prepared(result), facts_of(result)
                row |= numbers
            except (GelformError, MemoryError) as problem:
                error = reason(problem)
            except Exception as problem:  # a bug with one frame must not end a run of a million
                error = f"bug of gelform: {type(problem).__name__}: {problem}"
        else:
            error = reason(frame)
        row["error"] = " ".join(error.split())
        return row | writer.add(part.name_of(index), index, prepared)

    def _prepared(self, part: Part) -> Reconstructor:
        """The Reconstructor of a part's film; a refused background raises its error again."""
        job, name = self.job, part.film.name
        own = name if job.settings.background_frames or job.background_files else None
        if self._prepared_for != (own,):
            background = job.background
            try:
                if job.settings.background_frames:
                    background = background_of_film(part, job.settings.background_frames, job.calibration)
                elif job.background_files:
                    background = background_of_file(job.background_files[name], job.calibration)
                self._reconstruct = Reconstructor(
                    job.calibration, background=background, solver=job.settings.solver
                )
            except GelformError as problem:
                self._reconstruct = problem
            self._prepared_for = (own,)  # not after a lack of memory, which may be over at the next frame
        if isinstance(self._reconstruct, GelformError):
            raise self._reconstruct
        return self._reconstruct


NOTHING_LOST = "What is done is kept, and not done again."
TRIES_AGAIN = 5  # repetitions of a part whose worker or machine is lost; its bytes are the same
Counts = tuple[int, int]  # frames of a part, and those with an error

_worker: Worker | None = None
_stop: Any = None
_run: str | None = None  # the Ray run that the worker was made for


def done_parts(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[Counts, None, None]:
    """Do parts in this process, or in several on this machine, without an address (see `ENGINES`)."""
    if workers == 1:
        worker = Worker(job)
        for part in parts:
            yield worker.do(part).counts
        return
    stop = RawValue("b", 0)  # without a lock, which a killed worker would hold forever
    with tempfile.TemporaryDirectory(prefix="gelform-batch-") as folder:
        shared = Path(folder) / "job"  # a file, because it may be large
        shared.write_bytes(pickle.dumps(job))
        with worker_processes(workers, _prepare, shared, stop, kept=NOTHING_LOST) as pool:
            try:
                with interrupt_held():
                    waiting = [pool.submit(_do, part) for part in parts]
                for future in as_completed(waiting):
                    yield future.result()
            finally:
                stop.value = 1


def done_parts_on_ray(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[Counts, None, None]:
    """Do parts as Ray tasks with one CPU each (see `ENGINES`); without an address, start Ray here."""
    ray = needed("ray", "ray", "The engine ray")
    with _connected(ray, workers, address):
        # It reserves memory for each task.
        do = ray.remote(num_cpus=1, memory=600 << 20, max_retries=TRIES_AGAIN)(_do_on_ray)
        run, shared, todo = secrets.token_hex(8), ray.put(job), iter(parts)
        # Two tasks for each CPU are queued: a worker never waits, and memory holds no million tasks.
        most = 2 * max(1, int(ray.cluster_resources().get("CPU", 1)))
        waiting: list[Any] = []
        try:
            while True:
                for part in islice(todo, most - len(waiting)):
                    waiting.append(do.remote(run, shared, part))
                if not waiting:
                    return
                (done,), waiting = ray.wait(waiting, num_returns=1)
                yield _result(ray, done)
        finally:
            for one in waiting:
                ray.cancel(one)
            ray.wait(waiting, num_returns=len(waiting), timeout=10) if waiting else None


# Does parts, at most so many at once; gives the counts of each as it is finished. Closing the generator ends the work
# between two frames; unfinished parts leave no record. Raises WorkerLostError if workers were killed, and DataError if an
# output cannot be written.
ENGINES: dict[str, Callable[..., Generator[Counts, None, None]]] = {
    "pool": done_parts,
    "ray": done_parts_on_ray,
}


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

    def done(self, job: Job, parts: Sequence[Part]) -> Generator[Counts, None, None]:
        """Do parts (see `ENGINES`)."""
        workers = min(self.workers, max(1, len(parts)))
        return ENGINES[self.name](job, parts, workers, self.address)


def _prepare(shared: Path, stop: Any) -> None:
    """Prepare a worker process for its first part."""
    global _worker, _stop
    _worker, _stop = Worker(pickle.loads(shared.read_bytes())), stop


def _do(part: Part) -> Counts:
    assert _worker is not None
    try:
        return _worker.do(part, lambda: bool(_stop.value)).counts
    except Stopped:
        return 0, 0


def _do_on_ray(run: str, job: Job, part: Part) -> Counts:
    """Do a part in a worker process of Ray; each worker prepares the Reconstructor once."""
    global _worker, _run
    if _worker is None or _run != run:
        cv2.setNumThreads(1)
        _worker, _run = Worker(job), run
    return _worker.do(part).counts


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


def _result(ray: Any, done: Any) -> Counts:
    """The result of a task; its errors are raised here unchanged."""
    lost = ray.exceptions.WorkerCrashedError, ray.exceptions.NodeDiedError, ray.exceptions.OutOfMemoryError
    try:
        counts: Counts = ray.get(done)
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
