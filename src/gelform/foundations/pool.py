"""Work arrays, lent to one thread at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import numpy as np

Work = TypeVar("Work")
MOST_KEPT = 31 << 20  # bytes; glibc learns nothing from larger blocks


def keep_freed_memory(size: int) -> None:
    """Let the C library keep about twice `size` bytes of freed memory instead of returning it to the system at once.

    Returned memory costs a page fault for every 4 KB when the next frame needs it again: a fifth of the time of a
    plain frame. glibc keeps twice the largest block that it has seen freed, up to 32 MB; other libraries ignore it.
    """
    block = np.empty(min(size, MOST_KEPT), dtype=np.uint8)
    del block  # never written to, so it takes no memory


class Pool(Generic[Work]):
    """Lends objects from `make` and lends returned ones again, so that frames after the first allocate nothing."""

    def __init__(self, make: Callable[[], Work]) -> None:
        self._make = make
        self._free: list[Work] = []

    @contextmanager
    def one(self) -> Iterator[Work]:
        """Work arrays that no other thread holds; list.pop and list.append are atomic, so no lock is needed.

        After an exception in the block they are discarded, because their content may have caused it.
        """
        try:
            work = self._free.pop()
        except IndexError:
            work = self._make()
        yield work
        self._free.append(work)
