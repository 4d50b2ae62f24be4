"""The command as a process: how it fails, signals, streams of any encoding or none, one writer per file.

A mistake in what the user gave is one line and status 1, a bug of gelform's status 70. A mistake is a GelformError, an
OSError of a file, or a ValueError that a command has turned round with `mistakes_in`. Any other exception is a bug.
"""

from __future__ import annotations

import os
import re
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import typer
from typer.core import TyperGroup

from gelform.errors import DataError, GelformError

MISTAKE, BUG, INTERRUPTED = 1, 70, 130
DEBUG = "--debug"
_USAGE: Any = typer.BadParameter.__bases__[0]  # click's UsageError, wherever typer keeps its click


@contextmanager
def mistakes_in(what: object) -> Iterator[None]:
    """Turn a ValueError or TypeError about something that the user gave into a DataError that names it.

    For the call that reads or checks that one thing, and no more: what fails further in is a bug.
    """
    try:
        yield
    except (ValueError, TypeError) as problem:
        raise DataError(f"{what}: {problem}") from problem


class ReportedFailures(TyperGroup):
    """The group of all commands; reports what they raise, without a traceback unless `--debug` is given."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command that was asked for."""
        try:
            return super().invoke(ctx)
        except (typer.Exit, typer.Abort, _USAGE, BrokenPipeError):
            raise
        except (Exception, KeyboardInterrupt) as problem:
            if ctx.params.get("debug"):
                traceback.print_exc()
            sys.exit(_report(problem))


def _report(problem: BaseException) -> int:
    """Say what went wrong; gives the exit status."""
    if isinstance(problem, KeyboardInterrupt):
        return _said("interrupted.", INTERRUPTED)
    if isinstance(problem, MemoryError):
        return _said("error: not enough memory for this. Use smaller images, or fewer at a time.", MISTAKE)
    if isinstance(problem, OSError):
        return _said(f"error: {_sentence(problem)}", MISTAKE)
    if isinstance(problem, GelformError):
        return _said(f"error: {problem}", MISTAKE)
    where = _place(problem)
    return _said(
        f"bug: {type(problem).__name__}: {problem} ({where}). This is a mistake in gelform, not in what you gave: please "
        f"report it, with what the same command shows as `gelform {DEBUG} ...`.",
        BUG,
    )


def _said(text: str, status: int) -> int:
    typer.echo(f"gelform: {in_options(one_line(text))}", err=True)
    return status


def one_line(text: object) -> str:
    """A message on one line."""
    return " ".join(str(text).split())


def in_options(text: str) -> str:
    """A library's message as a command says it: "give mm_per_px= (--mm-per-px)" names the option alone."""
    return re.sub(r"\b\w+=\w* \((--[a-z-]+)\)", r"\1", text)


def _sentence(problem: OSError) -> str:
    """The system's words without its number: "Permission denied: /root/x.npz"."""
    named = f": {problem.filename}" if problem.filename is not None else ""
    return f"{problem.strerror}{named}." if problem.strerror else str(problem)


def _place(problem: BaseException) -> str:
    """File and line of gelform's own in which the exception came up."""
    frames = traceback.extract_tb(problem.__traceback__)
    package = os.path.dirname(os.path.dirname(__file__))
    own = [frame for frame in frames if frame.filename.startswith(package)] or list(frames)
    return f"{os.path.relpath(own[-1].filename, package)}, line {own[-1].lineno}" if own else "place unknown"


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
