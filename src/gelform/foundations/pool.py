"""Work arrays, lent to one thread at a time, and values that are computed on first use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import RLock
from typing import Any, Generic, TypeVar

import numpy as np

Work = TypeVar("Work")
Value = TypeVar("Value")
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


class once(Generic[Value]):
    """A value that is computed on first use: of a call without arguments, or, as a decorator, of a property.

    Those who share `once(make)` call it; threads can at once, and `make` goes with the first. Values that follow from the
    same things have one lock, which is held meanwhile. Threads that are the first to ask an object for a property compute it
    each and get the same; before Python 3.12, `functools.cached_property` has one lock for all objects.
    """

    def __init__(self, make: Callable[..., Value], lock: RLock | None = None) -> None:
        self._make: Callable[..., Value] | None = make
        self._lock, self.__doc__ = lock or RLock(), make.__doc__
        self._value: Any = None

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    def __get__(self, owner: Any, kind: type | None = None) -> Value:
        """The property's value, which hides this descriptor from then on."""
        if owner is None:
            return self  # type: ignore[return-value]
        assert self._make is not None
        found: Value = vars(owner).setdefault(self._name, self._make(owner))
        return found

    def __call__(self) -> Value:
        """The value."""
        with self._lock:
            if self._make is not None:
                self._value, self._make = self._make(), None
            found: Value = self._value
            return found
