"""A client of the live page without a browser: it counts pictures and their ages."""

from __future__ import annotations

import json
import threading
import time
from typing import Any

from websockets.sync.client import ClientConnection, connect

from gelform.live.shown import read_message
from live.server import Live

WATCH = {"do": "watch", "planes": ["depth", "flags", "image"], "encoding": "raw"}


def connected(live: Live) -> ClientConnection:
    """A connection as a page has it; it asks for no answers of its own, which a busy machine gives late."""
    address = live.address
    return connect(
        f"ws://{address}/ws", origin=f"http://{address}", max_size=None, proxy=None, ping_interval=None
    )


class Viewer(threading.Thread):
    """A client of one sensor: a credit for each picture, at most `most_hz` per second; a stalled one stops reading."""

    def __init__(self, live: Live, *, most_hz: float = 1e9, stalled: bool = False, station: int = 0) -> None:
        super().__init__(daemon=True)
        self.watch = {**WATCH, "stations": [station]}
        self.live, self.most_hz, self.stalled = live, most_hz, stalled
        self.pictures, self.ages_ms, self.state = 0, [], {}
        self.results: list[float] = []  # times of all results that the server announced, displayed or not
        self.first_s: float | None = None
        self.stop = threading.Event()

    def run(self) -> None:
        with connected(self.live) as socket:
            socket.send(json.dumps(self.watch))
            for _ in range(2):
                socket.send(json.dumps({"do": "credit"}))
            while not self.stop.is_set():
                if self.stalled:
                    time.sleep(0.1)
                    continue
                self._take(socket.recv(timeout=60), socket)

    def _take(self, data: Any, socket: Any) -> None:
        if isinstance(data, str):
            content = json.loads(data)
            self.state = content if content["kind"] == "state" else self.state
            return
        header, planes = read_message(data)
        self.pictures += 1
        self.results += [row[0] for row in header["numbers"]]
        self.ages_ms.append(1e3 * (time.monotonic() - header["time_s"]))
        if "depth" in planes and self.first_s is None:
            self.first_s = time.monotonic() - self.live.started
        self.stop.wait(1 / self.most_hz)
        socket.send(json.dumps({"do": "credit"}))
