"""Who may write to an output: one whole run, or several shards of it at once."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

from gelform.errors import DataError

LOCK = ".gelform-batch.lock"


@contextmanager
def only_run(output: Path, shard: tuple[int, int] = (1, 1)) -> Iterator[bool]:
    """Hold an output folder while it is written; gives whether nobody else writes to it.

    A run of all parts holds it alone; shards hold it together, each its own number. The system lets go whatever
    becomes of the process.

    Raises
    ------
    DataError
        Another process writes to it.
    """
    try:
        import fcntl
    except ImportError:  # Windows: files are replaced in one step all the same
        yield True
        return
    alone = shard[1] == 1
    with ExitStack() as held:
        whole = _opened(output / LOCK, held)
        _take(
            whole,
            fcntl.LOCK_EX if alone else fcntl.LOCK_SH,
            f"Another run of gelform batch writes to {output}",
        )
        if not alone:
            own = _opened(output / f"{LOCK}-{shard[0]}-of-{shard[1]}", held)
            _take(own, fcntl.LOCK_EX, f"Shard {shard[0]}/{shard[1]} of {output} is running")
        yield alone


def _opened(path: Path, held: ExitStack) -> IO[str]:
    try:
        return held.enter_context(path.open("w"))
    except OSError as problem:
        raise DataError(
            f"Cannot write into {path.parent}: {problem.strerror}. Give another output."
        ) from problem


def _take(handle: IO[str], kind: int, said: str) -> None:
    import fcntl

    try:
        fcntl.flock(handle, kind | fcntl.LOCK_NB)
    except BlockingIOError as problem:
        raise DataError(f"{said} now. Wait for it, or give another output folder.") from problem
    except OSError as problem:  # a file system without locks
        raise DataError(
            f"Cannot lock {handle.name}: {problem.strerror}. Give an output folder on a file system with locks."
        ) from problem
