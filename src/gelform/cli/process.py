"""The command as a process: signals, streams of any encoding or none, one writer per file."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

from gelform.errors import DataError


@contextmanager
def as_process() -> Iterator[None]:
    """Streams that take any text, SIGTERM that ends as Ctrl-C does, output that is flushed or said to be lost."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # None where it is closed
            stream.reconfigure(errors="backslashreplace")
    on_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGTERM, _interrupt) if on_main else None
    try:
        yield
        _flush()
    except SystemExit:
        _flush()
        raise
    except OSError as problem:  # of the output itself: a command reports its own
        _lose_output(problem)
    finally:
        if on_main:
            signal.signal(signal.SIGTERM, before)


def _interrupt(*_: Any) -> NoReturn:
    raise KeyboardInterrupt


def _flush() -> None:
    """Write what standard output still holds; where nobody reads it (`| head`), drop it without a word."""
    if sys.stdout is None or sys.stdout.closed:
        return
    try:
        sys.stdout.flush()
    except OSError as problem:
        _lose_output(problem)


def _lose_output(problem: OSError) -> None:
    """Say why the output is lost, unless its reader has gone; Python would try again as it exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    if not isinstance(problem, BrokenPipeError):
        sys.stderr.write(f"gelform: error: cannot write the output: {problem.strerror}.\n")
        sys.exit(1)


@contextmanager
def only_writer(path: Path) -> Iterator[None]:
    """Hold a file's name while it is made; the system lets go of it whatever becomes of the process.

    Raises
    ------
    DataError
        Another process is making the same file, or the folder cannot be written to.
    """
    try:
        import fcntl
    except ImportError:  # Windows: `written_file` alone keeps two writers apart, when they end
        yield
        return
    lock = path.with_name(f".{path.name}.lock")
    try:
        handle = lock.open("w")
    except OSError as problem:
        raise DataError(f"Cannot write into {path.parent}: {problem.strerror or problem}.") from problem
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as problem:
            raise DataError(
                f"Another gelform is making {path} now. Wait for it, or choose another name."
            ) from problem
        try:
            yield
        finally:
            lock.unlink(missing_ok=True)
