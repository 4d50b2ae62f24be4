"""Slow fixtures are made once per run; the workers of pytest-xdist share them as files."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

Made = TypeVar("Made")


@dataclass(frozen=True)
class MadeOnce:
    """Keeps what was made in a folder of the run, which all its workers see."""

    folder: Path

    def __call__(self, name: str, make: Callable[[Path], Made]) -> Made:
        """What `make` gives; it gets a path of its own for files. Who comes second waits and reads."""
        kept = self.folder / f"{name}.pickle"
        with _locked(self.folder / f"{name}.lock"):
            if not kept.exists():
                kept.write_bytes(pickle.dumps(make(self.folder / name)))
        return pickle.loads(kept.read_bytes())


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    import fcntl

    with path.open("w") as handle:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
