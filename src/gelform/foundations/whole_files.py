"""Whole files in memory, after a look at their size: a sparse file of a terabyte takes no room on a disk."""

from __future__ import annotations

import os
from pathlib import Path

from gelform.errors import DataError, GelformError
from gelform.foundations.checks import check_path

MAX_TEXT_BYTES = 2**24  # of settings, of facts about a data set
MAX_ARRAY_BYTES = 2**28  # of an array in another program's file, or of a table as text


def bytes_of(
    path: str | os.PathLike[str], what: str, max_bytes: float, error: type[GelformError] = DataError
) -> bytes:
    """The content of a file of at most `max_bytes`; `what` describes it in errors.

    error: there is no such file, it is a folder, a pipe or a device, larger than that, or cannot be read.
    """
    path = present_file(path, what, max_bytes, error)
    try:
        return path.read_bytes()
    except OSError as problem:
        raise error(f"Cannot read {path}: {problem.strerror or problem}.") from problem
    except MemoryError:
        raise error(f"Not enough memory to read {path}.") from None


def present_file(
    path: str | os.PathLike[str],
    what: str,
    max_bytes: float = MAX_ARRAY_BYTES,
    error: type[GelformError] = DataError,
) -> Path:
    """The path of a file that exists and is not too large; the error says that `what` was expected."""
    path = check_path(path)
    try:
        if path.is_dir():
            raise error(f"Expected a file, got the folder {path}.")
        if path.exists() and not path.is_file():  # reading a pipe or a device could block forever
            raise error(
                f"Expected a file, got a pipe or a device: {path}. Save what it gives as a file first."
            )
        size = path.stat().st_size
    except FileNotFoundError:
        raise error(f"No file {path}: expected {what}. Check the path.") from None
    except OSError as problem:
        raise error(f"Cannot read {path}: {problem.strerror or problem}.") from problem
    if size > max_bytes:
        raise error(
            f"Expected {what} of at most {max_bytes / 1e6:.4g} MB, got {path} of {size / 1e6:.4g} MB. It is damaged, or "
            "another file."
        )
    return path
