"""Things that are no arrays: objects of a kind, lists, paths."""

from __future__ import annotations

import os
from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
MAX_PATH, MAX_NAME = 4096, 255


def check_is(value: Any, kind: type[T], name: str) -> T:
    """Return what is of a kind, such as a View or a Reconstruction."""
    if not isinstance(value, kind):
        raise TypeError(f"Expected {name} as {kind.__name__}, got {type(value).__name__}.")
    return value


def check_list(values: Any, name: str, kind: type[Any] | None = None) -> list[Any]:
    """Return a list of what a sequence or an array holds; `kind` is that of each."""
    is_array = isinstance(values, np.ndarray) and values.ndim > 0
    if isinstance(values, (str, bytes)) or not (is_array or isinstance(values, Sequence)):
        raise TypeError(f"Expected {name} as a list, got {type(values).__name__}.")
    return [one if kind is None else check_is(one, kind, f"each of {name}") for one in values]


def check_path(path: Any, what: str = "a path") -> Path:
    """Return a path that a file system can have: text that is neither empty nor too long, without a zero byte."""
    if not isinstance(path, (str, PathLike)):
        raise TypeError(f"Expected {what} as text or a Path, got {type(path).__name__}.")
    text = os.fspath(path)
    if not isinstance(text, str):
        raise TypeError(f"Expected {what} as text or a Path, got {type(text).__name__}.")
    longest = max(map(len, text.split(os.sep)))
    if not text or "\0" in text or len(text) > MAX_PATH or longest > MAX_NAME:
        raise ValueError(f"Expected {what}, got {text[:60]!r}, which no file can be called.")
    return Path(text)
