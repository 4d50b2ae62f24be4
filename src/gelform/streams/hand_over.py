"""Between two threads: the newest value wins, and nobody waits for a slow reader."""

from __future__ import annotations

from threading import Condition
from typing import Generic, TypeVar

Value = TypeVar("Value")


class HandOver(Generic[Value]):
    """Keeps the newest value for any number of readers, who each remember the number of what they read last.

    Parameters
    ----------
    every : values are not replaced before someone has read them: for recordings, of which no frame is to be lost
    """

    def __init__(self, *, every: bool = False) -> None:
        self._every = every
        self._changed = Condition()
        self._value: Value | None = None
        self._number = self._expected = -1
        self._read = True
        self._ended = False
        self._error: BaseException | None = None

    def expect(self, number: int) -> None:
        """Say that the value of this number is being made: who asks now gets it, instead of an older one."""
        with self._changed:
            self._expected = number

    def put(self, number: int, value: Value) -> None:
        """Make this the newest value; numbers grow from 0."""
        with self._changed:
            if self._every:
                self._changed.wait_for(lambda: self._read or self._ended)
            self._number, self._value, self._read = number, value, False
            self._changed.notify_all()

    def newest(self, after: int = -1, timeout_s: float | None = None) -> Value | None:
        """The newest value, whose number is larger than `after`; None at the end, or when the time is over.

        Where a newer one was being made when it was asked for, it is waited for: a value that has lain here gets older,
        and is given only where the time is over before the newer one came.

        Raises
        ------
        BaseException
            What ended the thread that puts values, once there is no value left that the reader has not had.
        """
        with self._changed:
            least = max(after + 1, self._expected)
            self._changed.wait_for(lambda: self._number >= least or self._ended, timeout_s)
            if self._number > after:
                self._read = True
                self._changed.notify_all()
                return self._value
            if self._error is not None:
                raise self._error
            return None

    def end(self, error: BaseException | None = None) -> None:
        """Nothing more comes; with `error`, because of it. Wakes everybody; the first end counts."""
        with self._changed:
            if not self._ended:
                self._ended, self._error = True, error
            self._changed.notify_all()

    @property
    def ended(self) -> bool:
        """Whether nothing more comes."""
        return self._ended

    @property
    def error(self) -> BaseException | None:
        """What ended it, or None."""
        return self._error
