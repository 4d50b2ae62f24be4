"""Work arrays, lent to one thread at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

Work = TypeVar("Work")


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
