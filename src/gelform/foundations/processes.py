"""Worker processes: they end with the process that started them, and all together when one is lost."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnContext, SpawnProcess
from typing import Any

import cv2

from gelform.errors import GelformError


class WorkerLostError(GelformError):
    """A worker process was killed."""


def _nothing() -> None:
    """Prepare nothing."""


@contextmanager
def worker_processes(
    count: int, prepare: Callable[..., None] = _nothing, *args: Any, kept: str = ""
) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes with one thread of OpenCV each; an exception in the block cancels all pending work.

    Each first calls `prepare` with `args`. Keep args small: a pipe holds 64 kB, and starting a process that is killed before
    it reads the rest would never end.

    WorkerLostError: a worker was killed; `kept` is a sentence for it about the work that is already done.
    """
    context = _Recorded()
    lost, lose = context.Pipe(duplex=False)
    with lost, lose, ProcessPoolExecutor(count, context, _begin, (lost, prepare, args)) as pool:
        try:
            yield pool
        except (BrokenProcessPool, OSError, ValueError) as problem:
            if not (isinstance(problem, BrokenProcessPool) or _is_broken(pool)):
                raise
            lose.close()  # a broken pool forgets a process that was starting, and would wait for it forever
            said = ("A worker process was killed, perhaps for want of memory.", kept)
            again = "Run the same command again, with fewer --workers."
            raise WorkerLostError(" ".join(one for one in (*said, again) if one)) from problem
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
            lose.close()  # ends those that the pool forgot
            for process in context.started:
                if process.pid is not None:  # it did start
                    process.join()


class _Recorded(SpawnContext):
    """New processes, since a fork would copy the locks and threads too; all are recorded.

    A pool that breaks while it starts another process does not wait for that one.
    """

    def __init__(self) -> None:
        super().__init__()
        self.started: list[SpawnProcess] = []

    def Process(self, *args: Any, **kwargs: Any) -> SpawnProcess:  # type: ignore[override]  # a class there
        process = SpawnProcess(*args, **kwargs)
        self.started.append(process)
        return process


def _is_broken(pool: ProcessPoolExecutor) -> bool:
    """Whether the pool noticed a lost worker; while it does, `submit` fails with an error of a closed pipe."""
    try:
        pool.submit(_nothing)
    except BrokenProcessPool:
        return True
    return False


@contextmanager
def interrupt_held() -> Iterator[None]:
    """Hold Ctrl-C, which reaches all processes, for the one that starts them; its workers never see it.

    It waits until the block ends. On a system that cannot hold it (Windows), only a worker's first moments see it.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin(lost: Connection, prepare: Callable[..., None], args: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_others, args=(lost,), daemon=True).start()
    cv2.setNumThreads(1)
    prepare(*args)


def _end_with_others(lost: Connection) -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel, lost])
        os._exit(1)
