"""Pictures that one page gets while three others click on *Background* at a sensor whose picture is held."""

from __future__ import annotations

import json
import time
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from live.server import Live, running
from live.viewer import Viewer, connected

CLIENTS, CLICKS_EACH = 3, 8
SPAN_S, SETTLE_S = 20.0, 5.0
BACKGROUND = {"do": "background", "station": 0}
MOST_HZ = 10.0  # pictures per second of the page that looks on, so that a busy machine gives them all


def while_clicked() -> dict[str, Any]:
    """Pictures of the sensor beside it in 20 s: undisturbed, and with 24 clicks; answers to the clicks, and the slowest."""
    with running("simulated", "simulated") as (live, _):
        viewer = Viewer(live, most_hz=MOST_HZ, station=1)
        viewer.start()
        while viewer.first_s is None:
            time.sleep(0.01)
        time.sleep(SETTLE_S)
        before = viewer.pictures
        time.sleep(SPAN_S)
        undisturbed = viewer.pictures - before
        before, began_s = viewer.pictures, time.monotonic()
        answers, slowest_s = _click(live)
        time.sleep(max(0.0, SPAN_S - (time.monotonic() - began_s)))
        found = {
            "clicks": CLIENTS * CLICKS_EACH,
            "undisturbed": undisturbed,
            "pictures": viewer.pictures - before,
            "answers": answers,
            "slowest_answer_s": slowest_s,
        }
        viewer.stop.set()
        viewer.join(25)
    return found


def _click(live: Live) -> tuple[int, float]:
    """Hold the first sensor and click on its *Background*; the number of answers in time, and seconds to the last."""
    _answers(live, {"do": "pause", "station": 0, "paused": True}, 1)
    with ThreadPoolExecutor(CLIENTS) as pages:
        counts = pages.map(lambda _: _answers(live, BACKGROUND, CLICKS_EACH), range(CLIENTS))
        found = list(counts)
    return sum(count for count, _ in found), max(seconds for _, seconds in found)


def _answers(live: Live, command: dict[str, Any], clicks: int) -> tuple[int, float]:
    """How many answers to a page's clicks came in time, and seconds to the last one."""
    with connected(live) as socket:
        for _ in range(clicks):
            socket.send(json.dumps(command))
        began_s, came, last_s = time.monotonic(), 0, SPAN_S
        while came < clicks and (left_s := began_s + SPAN_S - time.monotonic()) > 0:
            try:
                data = socket.recv(timeout=left_s)
            except TimeoutError:
                break
            content = json.loads(data) if isinstance(data, str) else {}
            if content.get("kind") == "done" and content.get("do") == command["do"]:
                came, last_s = came + 1, time.monotonic() - began_s
    return came, last_s
