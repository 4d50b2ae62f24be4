"""The open pages; each has a name, so that a reloaded page is recognized."""

from __future__ import annotations

import re
import threading
import time
from collections import Counter
from collections.abc import Callable

# Seconds for which a page without a connection counts as open: a page that was reloaded or lost its network is back by
# then (it gives up a silent connection after 5 s, and tries again at least every 4 s).
GRACE_S = 10.0
NAME = re.compile(r"[0-9a-z-]{8,64}")


class Pages:
    """Connections of pages by the page's name; methods may be called in any thread.

    Parameters
    ----------
    clock : replaceable, to run faster or slower than real time
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._connections: Counter[str] = Counter()
        self._left_s: dict[str, float] = {}

    def came(self, name: str) -> None:
        """Note that a page has connected."""
        with self._lock:
            self._connections[name] += 1

    def left(self, name: str) -> None:
        """Note that a connection of a page has ended."""
        with self._lock:
            now = self._clock()
            self._left_s = {one: at_s for one, at_s in self._left_s.items() if now - at_s < GRACE_S}
            self._connections[name] -= 1
            if self._connections[name] <= 0:
                del self._connections[name]
                self._left_s[name] = now

    def is_open(self, name: str) -> bool:
        """Whether a page is connected, or was a moment ago and may be reloading."""
        with self._lock:
            if name in self._connections:
                return True
            left_s = self._left_s.get(name)
            return left_s is not None and self._clock() - left_s < GRACE_S

    @property
    def any_connected(self) -> bool:
        """Whether any page is connected now."""
        return bool(self._connections)


def page_named(given: str) -> str:
    """The name that a page states; "" for an invalid one, and such a page has no identity."""
    return given if NAME.fullmatch(given) else ""
