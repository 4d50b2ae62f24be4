"""Single keys from the terminal, without Enter."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from gelform.errors import DataError

POLL_S = 0.05


@contextmanager
def single_keys(purpose: str) -> Iterator[Callable[[float], str | None]]:
    """Gives a function that waits for a key, at most so many seconds; None where none was pressed, "" at the end.

    The terminal's own settings come back with the end of the block.

    Parameters
    ----------
    purpose : of the keys, for the message

    Raises
    ------
    DataError
        Standard input is no terminal.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise DataError(
            f"{purpose} takes keys from a terminal, and standard input is none. Run it in a terminal."
        )
    with _of_windows() if sys.platform == "win32" else _of_terminal() as read:
        yield read


@contextmanager
def _of_terminal() -> Iterator[Callable[[float], str | None]]:
    import select
    import termios
    import tty

    handle = sys.stdin.fileno()
    before = termios.tcgetattr(handle)

    def read(timeout_s: float) -> str | None:
        ready = select.select([handle], [], [], timeout_s)[0]
        return os.read(handle, 1).decode("latin-1") if ready else None

    try:
        tty.setcbreak(handle)  # Ctrl-C still interrupts
        yield read
    finally:
        termios.tcsetattr(handle, termios.TCSADRAIN, before)


@contextmanager
def _of_windows() -> Iterator[Callable[[float], str | None]]:
    import msvcrt

    def read(timeout_s: float) -> str | None:
        until = time.monotonic() + timeout_s
        while time.monotonic() < until:
            if msvcrt.kbhit():  # type: ignore[attr-defined]
                return str(msvcrt.getwch())  # type: ignore[attr-defined]
            time.sleep(POLL_S)
        return None

    yield read
