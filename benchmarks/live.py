"""The live page: first picture, rates and age in a browser, four clients of which one stalls, memory, the page's weight.

    python benchmarks/live.py                 # about two minutes; needs Chromium and Playwright for the browser's figures
    python benchmarks/live.py --seconds 5     # quick

`gelform live` runs as a user starts it; its clients are a headless Chromium (WebGL2 in software) and websockets. A figure
that could not be taken is left out, and said. Writes results/live.json with the machine's load.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

from websockets.sync.client import connect

from gelform.live.web.app import page_files
from gelform.live.wire import read_message
from report import write

FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run"]
WATCH = {"do": "watch", "stations": [0], "planes": ["depth", "flags", "image"], "encoding": "raw"}


class Live:
    """`gelform live` as a process of its own."""

    def __init__(self) -> None:
        self.started = time.monotonic()
        command = [sys.executable, "-m", "gelform", "live", "--quiet"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        self.url = self.process.stdout.readline().strip()
        self.address = self.url.removeprefix("http://").rstrip("/")

    def resident_mb(self) -> float:
        """Memory of the process, where the system tells it."""
        status = Path(f"/proc/{self.process.pid}/status").read_text(encoding="ascii")
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024

    def close(self) -> None:
        self.process.terminate()
        self.process.wait(10)


class Viewer(threading.Thread):
    """A client that gives a credit for each picture, at most so many a second; stalled: it never reads on."""

    def __init__(self, live: Live, *, most_hz: float = 1e9, stalled: bool = False) -> None:
        super().__init__(daemon=True)
        self.live, self.most_hz, self.stalled = live, most_hz, stalled
        self.pictures, self.ages_ms, self.state = 0, [], {}
        self.first_s: float | None = None
        self.stop = threading.Event()

    def run(self) -> None:
        with connect(
            f"ws://{self.live.address}/ws", origin=f"http://{self.live.address}", max_size=None
        ) as s:
            s.send(json.dumps(WATCH))
            for _ in range(2):
                s.send(json.dumps({"do": "credit"}))
            while not self.stop.is_set():
                if self.stalled:
                    time.sleep(0.1)
                    continue
                self._take(s.recv(timeout=20), s)

    def _take(self, data: Any, socket: Any) -> None:
        if isinstance(data, str):
            content = json.loads(data)
            self.state = content if content["kind"] == "state" else self.state
            return
        header, planes = read_message(data)
        self.pictures += 1
        self.ages_ms.append(1e3 * (time.monotonic() - header["time_s"]))
        if "depth" in planes and self.first_s is None:
            self.first_s = time.monotonic() - self.live.started
        self.stop.wait(1 / self.most_hz)
        socket.send(json.dumps({"do": "credit"}))


def clients(live: Live, seconds: float) -> dict[str, Any]:
    """Four clients, one stalled, one at 2 Hz: what each gets, the server's rate, its memory at both ends."""
    quick, other, slow, stalled = (
        Viewer(live),
        Viewer(live),
        Viewer(live, most_hz=2),
        Viewer(live, stalled=True),
    )
    for one in (quick, other, slow, stalled):
        one.start()
    time.sleep(3)
    before, memory = [one.pictures for one in (quick, other, slow)], live.resident_mb()
    time.sleep(seconds)
    shown = [(one.pictures - b) / seconds for one, b in zip((quick, other, slow), before)]
    station = quick.state["stations"][0]
    found = {
        "first_depth_s": quick.first_s,
        "reconstructed_hz": station["rate_hz"],
        "reconstruction_ms": station["took_ms"],
        "shown_hz": dict(zip(("first", "second", "two_hz"), shown)),
        "age_at_client_ms": statistics.median(quick.ages_ms[-200:]),
        "memory_mb": [memory, live.resident_mb()],
    }
    for one in (quick, other, slow, stalled):
        one.stop.set()
    for one in (quick, other, slow, stalled):
        one.join(25)
    return found


def browser(live: Live, seconds: float) -> dict[str, Any]:
    """One headless Chromium: pictures a second, capture to screen, requests to other hosts."""
    from playwright.sync_api import sync_playwright

    hosts = set()
    with sync_playwright() as running, tempfile.TemporaryDirectory() as profile:
        context = running.chromium.launch_persistent_context(
            profile, executable_path=shutil.which("chromium"), headless=True, args=FLAGS
        )
        page = context.pages[0]
        page.on("request", lambda request: hosts.add(request.url.split("/")[2]))
        page.goto(live.url)
        page.wait_for_timeout(3000)
        drawn, serial = "gelform.look.ages.length", "gelform.frame.header.serial"
        page.evaluate("gelform.look.ages = []")
        first, began = page.evaluate(serial), time.monotonic()
        rates = []
        while time.monotonic() - began < seconds:
            page.wait_for_timeout(1000)
            rates.append(page.evaluate("gelform.look.drawnHz"))
        took = time.monotonic() - began
        found = {
            "reconstructed_hz": (page.evaluate(serial) - first) / took,
            "drawn_hz": statistics.median(rates),
            "capture_to_screen_ms": statistics.median(page.evaluate("gelform.look.ages")),
            "pictures": page.evaluate(drawn),
            "other_hosts": sorted(hosts - {live.address}),
            "renderer": page.evaluate("gelform.look.renderer"),
        }
        context.close()
    return found


def main() -> None:
    """Measure and write down."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=30.0)
    seconds = parser.parse_args().seconds
    figures: dict[str, Any] = {
        "page_kb": sum(map(len, page_files().values())) / 1e3,
        "load_before": os.getloadavg()[0],
        "seconds": seconds,
    }
    live = Live()
    try:
        figures["clients"] = clients(live, seconds)
        if shutil.which("chromium") is None:
            print("no Chromium: the browser's figures are left out")
        else:
            figures["browser"] = browser(live, seconds)
    finally:
        live.close()
    write("live", figures)
    print(json.dumps(figures, indent=1))


if __name__ == "__main__":
    main()
