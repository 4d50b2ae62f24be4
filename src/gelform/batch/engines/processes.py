"""Parts done here or by several processes, in whatever order they end."""

from __future__ import annotations

import os
import pickle
import signal
import tempfile
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from pathlib import Path
from typing import Any

from gelform.batch.inputs.plan import Part
from gelform.batch.records import PartRecord
from gelform.batch.work import Job, Stopped, Worker
from gelform.errors import GelformError

_worker: Worker | None = None
_stop: Any = None


class WorkerLostError(GelformError):
    """A worker process was killed; what it had finished is kept."""


def done_parts(
    job: Job, parts: Sequence[Part], workers: int, address: str | None = None
) -> Generator[tuple[Part, int, int], None, None]:
    """Do parts here, or in several processes of this machine (see `DoneParts`).

    Parameters
    ----------
    workers : processes; 1: this one
    address : not used, this machine has none

    Raises
    ------
    WorkerLostError
        A worker was killed.
    DataError
        An output cannot be written.
    """
    if workers == 1:
        worker = Worker(job)
        for part in parts:
            yield part, *_counts(worker.do(part))
        return
    context = get_context("spawn")  # a fork would take the locks and the threads with it
    stop = context.RawValue("b", 0)  # without a lock, which a killed worker would hold for ever
    with tempfile.TemporaryDirectory(prefix="gelform-batch-") as folder:
        # By a file: a pipe holds 64 kB, and starting a worker that is killed before it reads the rest would never end.
        shared = Path(folder) / "job"
        shared.write_bytes(pickle.dumps(job))
        with ProcessPoolExecutor(workers, context, _start, (shared, stop)) as pool:
            try:
                waiting = {pool.submit(_do, part): part for part in parts}
                for future in as_completed(waiting):
                    yield waiting.pop(future), *future.result()
            except BrokenProcessPool as problem:
                raise WorkerLostError(
                    "A worker process was killed, perhaps for want of memory. What is done is kept: run the same "
                    "command again, with fewer --workers."
                ) from problem
            finally:
                stop.value = 1
                pool.shutdown(wait=True, cancel_futures=True)


def _counts(record: PartRecord) -> tuple[int, int]:
    return len(record.rows), record.errors


def _start(shared: Path, stop: Any) -> None:
    """Prepare a worker process: it ends with its parent, and leaves Ctrl-C to it."""
    global _worker, _stop
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    import cv2

    cv2.setNumThreads(1)
    _worker, _stop = Worker(pickle.loads(shared.read_bytes())), stop


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _do(part: Part) -> tuple[int, int]:
    assert _worker is not None
    try:
        return _counts(_worker.do(part, lambda: bool(_stop.value)))
    except Stopped:
        return 0, 0
