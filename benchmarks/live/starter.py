"""Time from the start of `gelform live` to depth on the screen, for an uncalibrated camera of a known make.

The camera is an address that sends JPEG pictures of a simulated unit: at rest, and pressed by a ball once the page has taken
the background.
"""

from __future__ import annotations

import contextlib
import os
import statistics
import tempfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import cv2
import numpy as np

from gelform.simulate import LAYOUTS, Ball, Pose, simulate_pose
from live.guided import wait_for
from live.server import CHROMIUM, FLAGS, Live

MAKE, LAYOUT = "simulated-three-edges", "three-edges"
RATE_HZ, IMAGES, QUALITY = 30.0, 8, 95
DEPTH_MM, BALL_MM = 0.4, 5.0
STARTS = 3


class Camera(ThreadingHTTPServer):
    """Sends 30 pictures per second; `pressed` selects which."""

    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), _Pictures)
        rng = np.random.default_rng(50)
        self.pictures = {depth: [_jpeg(depth, rng) for _ in range(IMAGES)] for depth in (0.0, DEPTH_MM)}
        self.pressed = False
        self.url = f"http://127.0.0.1:{self.server_address[1]}/stream"
        threading.Thread(target=self.serve_forever, daemon=True).start()


class _Pictures(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        camera: Any = self.server
        self.send_response(200)
        self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
        self.end_headers()
        with contextlib.suppress(OSError):  # the reader has left
            for number in range(10**9):
                picture = camera.pictures[DEPTH_MM if camera.pressed else 0.0][number % IMAGES]
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
                self.wfile.write(head.encode() + picture + b"\r\n")
                time.sleep(1 / RATE_HZ)

    def log_message(self, *_: Any) -> None:
        """Log nothing."""


def _jpeg(depth_mm: float, rng: np.random.Generator) -> bytes:
    image = simulate_pose(LAYOUTS[LAYOUT], Ball(BALL_MM / 2), Pose(depth_mm), rng=rng).image
    return cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()


def to_depth() -> dict[str, Any]:
    """Seconds from the start of the process to the address, to the question, to depth on the screen; medians of starts."""
    from playwright.sync_api import sync_playwright

    load, camera = os.getloadavg()[0], Camera()
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        found = [_one(chromium, camera) for _ in range(STARTS)]
        chromium.close()
    camera.shutdown()
    medians = {name: statistics.median(one[name] for one in found) for name in found[0]}
    return {"load_before": load, "starts": STARTS, "pressed_mm": DEPTH_MM, **medians}


def _one(chromium: Any, camera: Camera) -> dict[str, float]:
    camera.pressed = False
    with tempfile.TemporaryDirectory() as folder:
        live = Live(folder, camera.url, "--sensor", MAKE)
        try:
            address_s = time.monotonic() - live.started
            page = chromium.new_page(viewport={"width": 1300, "height": 900})
            page.goto(live.url)
            wait_for(page, "document.getElementById('starter-take')")
            asked_s = time.monotonic() - live.started
            page.click("#starter-take")
            wait_for(page, "gelform.frame?.has('depth')")
            page.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
            depth_s = time.monotonic() - live.started
            camera.pressed = True
            wait_for(page, f"gelform.frame.header.peak > {DEPTH_MM / 2}")
            page.wait_for_timeout(500)
            peak_mm = page.evaluate("gelform.frame.header.peak")
            page.close()
        finally:
            live.close()
    return {"address_s": address_s, "asked_s": asked_s, "depth_s": depth_s, "peak_mm": peak_mm}
