"""From the hub to a sink, in a thread of its own: the newest wins, and a slow sink harms nobody."""

from __future__ import annotations

import threading
from typing import Protocol

from gelform.live.hub import Hub
from gelform.live.shown import Shown


class Sink(Protocol):
    """Another program that shows results."""

    def show(self, name: str, shown: Shown) -> None:
        """Show one frame of a sensor, called in the feeder's thread; `name` is a path of letters, digits and _."""

    def close(self) -> None:
        """Show nothing any more."""


class Feeder:
    """Gives a sink the newest frame of each station; those that come while it is busy are passed over.

    What a sink raises ends it and becomes a notice of the hub; the page goes on.

    Parameters
    ----------
    hub : of the stations
    sink : closed with the feeder
    name : of the sink, for the notice
    """

    def __init__(self, hub: Hub, sink: Sink, name: str) -> None:
        self._hub, self._sink, self._name = hub, sink, name
        self._newer, self._stop = threading.Event(), threading.Event()
        self._shown: dict[int, int] = {}
        self._thread = threading.Thread(target=self._run, name=f"sink {name}", daemon=True)
        hub.listen(self._newer.set)
        self._thread.start()

    def close(self) -> None:
        """Stop, and close the sink."""
        self._stop.set()
        self._newer.set()
        self._thread.join(3.0)

    def _run(self) -> None:
        try:
            while not self._stop.is_set():
                self._newer.wait()
                self._newer.clear()
                self._show_newest()
        except (
            Exception
        ) as problem:  # of another program's library: whatever it is, the page goes on without it
            self._hub.notice(f"{self._name} ended: {type(problem).__name__}: {problem}", "error")
        finally:
            self._sink.close()

    def _show_newest(self) -> None:
        for station in self._hub.stations:
            shown = station.newest
            if shown is not None and shown.serial != self._shown.get(station.number):
                self._shown[station.number] = shown.serial
                self._sink.show(f"sensor_{station.number}", shown)
