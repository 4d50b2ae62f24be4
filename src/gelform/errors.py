"""Errors that gelform raises in addition to ValueError and TypeError."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any


class GelformError(Exception):
    """Base of all of gelform's own errors; the command line prints them as one line."""


class CalibrationError(GelformError):
    """A calibration cannot be made, read, or used on this image."""


class SensorError(GelformError):
    """A camera or a sensor profile does not answer as expected."""


class SourceLostError(SensorError):
    """A source of frames is gone, stands still or sends something that is no frame; opening it again may help."""


class ConvergenceError(GelformError):
    """A solver did not reach its tolerance; the message names the cause and a remedy."""


class StaleError(SensorError):
    """A stream has no result that is new enough."""


class DataError(GelformError):
    """A file or folder is missing, unreadable, incomplete or altered, or already exists."""


@contextmanager
def cannot(act: str, remedy: str = "", error: type[GelformError] = DataError) -> Iterator[None]:
    """Raise the error where the system refuses what is inside: "Cannot write a.npz: No space left on device."."""
    try:
        yield
    except OSError as problem:
        raise error(f"Cannot {act}: {problem.strerror or problem}.{remedy and ' ' + remedy}") from problem


def needed(module: str, extra: str, what: str) -> Any:
    """Import a module of an extra where it is used; `what` names the feature that needs it, such as "HDF5".

    DataError: it is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError as missing:
        raise DataError(
            f'{what} needs the extra {extra}: pip install "gelform[{extra}]", or ".[{extra}]" in a checkout.'
        ) from missing


def reason(problem: BaseException) -> str:
    """Why one frame of many gives no result; its lack of memory has no message of its own."""
    return "Not enough memory for this frame." if isinstance(problem, MemoryError) else str(problem)


def said(problem: BaseException) -> str:
    """The message of another library's error about a file, in one line."""
    if isinstance(problem, UnicodeDecodeError):
        return f"byte {problem.start} of a text is no character"
    return str(problem).splitlines()[0] if str(problem) else type(problem).__name__
