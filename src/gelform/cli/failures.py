"""How a command fails: one line and status 1 for a mistake in what the user gave, status 70 for a bug of gelform's.

A mistake is a GelformError, an OSError of a file, or a ValueError that a command has turned round with `mistakes_in`.
Any other exception is a bug and says so.
"""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

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
    """What a message says, on one line."""
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
