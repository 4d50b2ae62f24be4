"""Work arrays, lent to one thread at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import numpy as np

Work = TypeVar("Work")
MOST_KEPT = 31 << 20  # glibc learns nothing from larger blocks


def keep_freed_memory(size: int) -> None:
    """Let the C library keep about twice `size` bytes that were freed, instead of handing them back at once.

    Memory that was handed back costs a page fault for every 4 KB when the next frame asks for it again: a fifth of a
    plain frame. glibc keeps twice the largest block that it has seen freed, up to 32 MB; others take no notice.
    """
    block = np.empty(min(size, MOST_KEPT), dtype=np.uint8)
    del block  # never written to: it takes no memory


class Pool(Generic[Work]):
    """Lends what `make` makes and lends again what came back: frames after the first allocate nothing."""

    def __init__(self, make: Callable[[], Work]) -> None:
        self._make = make
        self._free: list[Work] = []

    @contextmanager
    def one(self) -> Iterator[Work]:
        """Work arrays that nobody else holds. list.pop and list.append are atomic: no lock is needed.

        Where an exception leaves the block, they are forgotten: they may hold whatever made it fail.
        """
        try:
            work = self._free.pop()
        except IndexError:
            work = self._make()
        yield work
        self._free.append(work)
