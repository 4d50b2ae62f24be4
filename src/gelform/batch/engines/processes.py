"""Parts done here or by several processes, in whatever order they end."""

from __future__ import annotations

import pickle
import tempfile
from collections.abc import Generator, Sequence
from concurrent.futures import as_completed
from multiprocessing.sharedctypes import RawValue
from pathlib import Path
from typing import Any

from gelform.batch.inputs.plan import Part
from gelform.batch.records import PartRecord
from gelform.batch.work import Job, Stopped, Worker
from gelform.processes import interrupt_held, worker_processes

KEPT = "What is done is kept, and not done again."

_worker: Worker | None = None
_stop: Any = None


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
    stop = RawValue("b", 0)  # without a lock, which a killed worker would hold for ever
    with tempfile.TemporaryDirectory(prefix="gelform-batch-") as folder:
        shared = Path(folder) / "job"  # a file, since it may be large
        shared.write_bytes(pickle.dumps(job))
        with worker_processes(workers, _prepare, shared, stop, kept=KEPT) as pool:
            try:
                with interrupt_held():
                    waiting = {pool.submit(_do, part): part for part in parts}
                for future in as_completed(waiting):
                    yield waiting.pop(future), *future.result()
            finally:
                stop.value = 1


def _counts(record: PartRecord) -> tuple[int, int]:
    return len(record.rows), record.errors


def _prepare(shared: Path, stop: Any) -> None:
    """What a worker process needs before its first part."""
    global _worker, _stop
    _worker, _stop = Worker(pickle.loads(shared.read_bytes())), stop


def _do(part: Part) -> tuple[int, int]:
    assert _worker is not None
    try:
        return _counts(_worker.do(part, lambda: bool(_stop.value)))
    except Stopped:
        return 0, 0
