"""Processes that share work: they end with the one that started them, and together when one of them is lost."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from typing import Any

import cv2

from gelform.errors import GelformError


class WorkerLostError(GelformError):
    """A worker process was killed."""


def _nothing() -> None:
    """Needs no preparation."""


@contextmanager
def worker_processes(
    count: int, prepare: Callable[..., None] = _nothing, *args: Any, kept: str = ""
) -> Iterator[ProcessPoolExecutor]:
    """A pool of new processes, of one thread of OpenCV each; an exception in the block cancels what has not begun.

    Parameters
    ----------
    count : of processes
    prepare : called with `args` in each of them first; small ones: a pipe holds 64 kB, and starting a process that is
        killed before it reads the rest would never end
    kept : what the error says of the work that was done until then, a sentence

    Raises
    ------
    WorkerLostError
        One was killed.
    """
    context = get_context("spawn")  # a fork would take the locks and the threads with it
    lost, lose = context.Pipe(duplex=False)
    with lost, lose, ProcessPoolExecutor(count, context, _begin, (lost, prepare, args)) as pool:
        try:
            yield pool
        except (BrokenProcessPool, OSError) as problem:
            if isinstance(problem, OSError) and not _is_broken(pool):
                raise
            lose.close()  # the pool forgets a process that was starting when it broke, and would wait for it for ever
            said = ("A worker process was killed, perhaps for want of memory.", kept)
            again = "Run the same command again, with fewer --workers."
            raise WorkerLostError(" ".join(one for one in (*said, again) if one)) from problem
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _is_broken(pool: ProcessPoolExecutor) -> bool:
    """Whether a worker was lost: while a pool finds that out, its `submit` fails with an OSError of a closed pipe."""
    try:
        pool.submit(_nothing)
    except BrokenProcessPool:
        return True
    return False


@contextmanager
def interrupt_held() -> Iterator[None]:
    """Ctrl-C reaches all processes, but is for the one that starts them: those started here never see it.

    It waits until the block ends. Where a system cannot hold it (Windows), only a worker's first moments see it.
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
