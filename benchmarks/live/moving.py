"""The moving picture of the README: the live page shows presses of the simulated sensor, frame by frame.

The presses are a recording of as many frames as the picture has. The page is held at each one, so that the picture is
smooth on a slow machine too. It begins and ends where the first object is pressed deepest.
"""

from __future__ import annotations

import tempfile
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from gelform.calibration.library import ready_calibration
from gelform.image.view import Frame
from gelform.sensors import simulated_sensor_named
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.source import DEFAULT_SENSOR
from gelform.simulate import Coin, simulate_press, text_relief
from live.guided import wait_for
from live.pictures import served

PAGE = (1200, 800)  # px: the surface over the panes, both 880 px wide
WIDTH, QUALITY = 760, 55  # px and of 100, of the picture
FRAME_MS, MOST_BYTES = 90, 400_000
STEPS = 18  # frames from one deepest point to the gel at rest and to the next deepest point
OBJECTS = ((Coin(), 0.4), (text_relief("gelform", height_mm=2.6), 0.28))  # and how deep, mm
RECORDED_HZ = 1000 / FRAME_MS
SETTLED_MS = 500  # until the page has drawn a frame: the surface too
SEEK = "(s => {{ s.value = {}; s.dispatchEvent(new Event('input')); }})(document.getElementById('scrub'))"
LEAST_MM = 0.002  # of a press, so that there is one


def depths_mm() -> list[tuple[Any, float]]:
    """The object and its depth in each frame: each object is lifted, and the next one pressed."""
    lifted = 0.5 + 0.5 * np.cos(np.pi * np.arange(STEPS // 2) / (STEPS // 2))
    (first, deep), (second, less) = OBJECTS
    down, up = lifted, (1 - lifted)
    return [
        *((first, deep * f) for f in down), *((second, less * f) for f in up),
        *((second, less * f) for f in down), *((first, deep * f) for f in up),
    ]  # fmt: skip


def write_presses(path: Path) -> int:
    """A recording of the presses; how many frames it has."""
    sensor, rng = simulated_sensor_named(DEFAULT_SENSOR), np.random.default_rng(0)
    recording = McapRecording(path, RecordingFacts(sensor.name, None, {}, RECORDED_HZ))
    frames = depths_mm()
    for k, (indenter, depth_mm) in enumerate(frames):
        image = simulate_press(sensor, indenter, depth_mm=max(depth_mm, LEAST_MM), rng=rng).image
        recording.write(Frame(image, k / RECORDED_HZ, k, k))
    recording.close()
    return len(frames)


def shots(page: Any, count: int) -> list[Image.Image]:
    """The page at each frame of the recording, cut to the surface and the panes."""
    boxes = [page.locator(one).bounding_box() for one in ("#stage", "#panes")]
    top, bottom = boxes[0]["y"], boxes[1]["y"] + boxes[1]["height"]
    clip = {"x": boxes[0]["x"], "y": top, "width": boxes[0]["width"], "height": bottom - top}
    taken = []
    for k in range(count):
        page.evaluate(SEEK.format(k))
        wait_for(page, f"gelform.frame.header.replay?.[0] === {k}")
        page.wait_for_timeout(SETTLED_MS)
        taken.append(Image.open(BytesIO(page.screenshot(clip=clip, full_page=True))).convert("RGB"))
    return taken


def take_moving(folder: Path) -> None:
    """`live.webp` of a folder; says its size.

    Raises
    ------
    ValueError
        It is larger than a README should load.
    """
    with tempfile.TemporaryDirectory() as name:
        count = write_presses(Path(name) / "presses.mcap")
        with served(name, str(Path(name) / "presses.mcap"), "-c", str(_calibration(Path(name)))) as opened:
            page = opened(PAGE)
            page.click("#step-back")  # holds
            page.evaluate("document.activeElement.blur()")
            taken = shots(page, count)
    size = (WIDTH, round(WIDTH * taken[0].height / taken[0].width))
    first, *others = (one.resize(size, Image.Resampling.LANCZOS) for one in taken)
    path = folder / "live.webp"
    first.save(
        path, save_all=True, append_images=others, duration=FRAME_MS, loop=0, quality=QUALITY, method=6
    )
    size_bytes = path.stat().st_size
    print(f"{path}: {count} frames, {size[0]} x {size[1]} px, {size_bytes / 1e3:.0f} kB")
    if size_bytes > MOST_BYTES:
        raise ValueError(f"Expected at most {MOST_BYTES} bytes, got {size_bytes}. Lower QUALITY.")


def _calibration(folder: Path) -> Path:
    """The file of the simulated sensor's calibration."""
    path = folder / "calibration.npz"
    ready_calibration(simulated_sensor_named(DEFAULT_SENSOR)).save(path)
    return path
