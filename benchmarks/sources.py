"""Frames from a real ffmpeg: 8 megapixels at 25 Hz, killed and restarted 20 times, a consumer slower than its source.

    python benchmarks/sources.py            # about two minutes; writes results/sources.json
    python benchmarks/sources.py --quick    # half a minute, writes nothing

The consumer's ages and the processor's load depend on what else the machine does; the load of other processes is
recorded beside them.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ffmpeg_camera import FFMPEG, FfmpegCamera, why_absent
from gelform.sensors.grabber import Grabber
from report import table, write

LARGE, LARGE_HZ = (2448, 3264), 25
CONSUMER_HZ, SOURCE_HZ = 5, 60
OFF_S = (0.2, 0.8, 1.5)  # how long the camera is off, in turn
SETTLED = 3  # restarts after which the memory is looked at first


def large_pictures(folder: Path, seconds: int = 2) -> tuple[Path, float]:
    """A film of JPEG pictures of 8 megapixels, and the bytes of one."""
    path = folder / "large.mjpeg"
    made = f"-f lavfi -i testsrc2=size={LARGE[1]}x{LARGE[0]}:rate={LARGE_HZ} -t {seconds} -c:v mjpeg -q:v 3"
    subprocess.run([FFMPEG, "-loglevel", "error", *made.split(), str(path)], check=True)
    return path, path.stat().st_size / (seconds * LARGE_HZ)


def large_stream(seconds: float) -> dict[str, Any]:
    """Frames a second and the load of this process, on 8 megapixels at 25 Hz."""
    with tempfile.TemporaryDirectory() as folder:
        film, picture_bytes = large_pictures(Path(folder))
        served = f"-f mjpeg -framerate {LARGE_HZ} -stream_loop -1 -i {film} -c:v copy"
        with FfmpegCamera(served) as camera, Grabber(camera.url) as grabber:
            first = grabber.newest(-1, 20)
            assert first is not None
            time.sleep(1.0)
            before, busy, started = grabber.stats, time.process_time(), time.monotonic()
            time.sleep(seconds)
            after = grabber.stats
            wall = time.monotonic() - started
            return {
                "rate_hz": (after.frames - before.frames) / wall,
                "served_hz": (after.frames - before.frames + after.drops - before.drops) / wall,
                "busy_share_of_a_core": (time.process_time() - busy) / wall,
                "decoded_px": list(first.image.shape[:2]),
                "picture_bytes": picture_bytes,
                "load_average": os.getloadavg()[0],
            }


def restarts(count: int) -> dict[str, Any]:
    """How long after a killed camera listens again its first frame is there, and what the memory does."""
    back_s, memory_mb = [], []
    with FfmpegCamera() as camera, Grabber(camera.url) as grabber:
        frame = grabber.newest(-1, 20)
        for k in range(count):
            assert frame is not None
            camera.kill()
            time.sleep(OFF_S[k % len(OFF_S)])
            last = grabber.newest(-1, 0)
            assert last is not None
            returned = camera.start()
            frame = grabber.newest(last.index, 20)
            back_s.append(time.monotonic() - returned)
            time.sleep(0.2)
            gc.collect()
            memory_mb.append(resident_mb())
        stats = asdict(grabber.stats)
    return {
        "restarts": count,
        "back_s_max": max(back_s),
        "back_s_median": float(np.median(back_s)),
        "back_s": back_s,
        "memory_growth_mb": memory_mb[-1] - memory_mb[min(SETTLED, count) - 1],
        "reopened": stats["reopened"],
        "load_average": os.getloadavg()[0],
    }


def slow_consumer(seconds: float) -> dict[str, Any]:
    """Age of the newest frame, in frames of the source, when a consumer at 5 Hz asks for it."""
    served = f"-f lavfi -i testsrc2=size=320x240:rate={SOURCE_HZ} -c:v mjpeg -q:v 3"
    ages, after = [], -1
    with FfmpegCamera(served) as camera, Grabber(camera.url) as grabber:
        grabber.newest(-1, 20)
        time.sleep(1.0)
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            frame = grabber.newest(after, 5)
            assert frame is not None
            ages.append((time.monotonic() - frame.time_s) * SOURCE_HZ)
            after = frame.index
            time.sleep(1 / CONSUMER_HZ)
        rate = grabber.stats.rate_hz
    return {
        "source_hz": rate,
        "asked": len(ages),
        "age_frames_max": max(ages),
        "age_frames_median": float(np.median(ages)),
        "load_average": os.getloadavg()[0],
    }


def simulated(seconds: float) -> dict[str, Any]:
    """Rate and load of the source "simulated", which has to leave room for the reconstruction."""
    with Grabber("simulated") as grabber:
        grabber.newest(-1, 30)
        before, busy, started = grabber.stats, time.process_time(), time.monotonic()
        time.sleep(seconds)
        wall = time.monotonic() - started
        return {
            "rate_hz": (grabber.stats.frames - before.frames) / wall,
            "busy_share_of_a_core": (time.process_time() - busy) / wall,
            "load_average": os.getloadavg()[0],
        }


def resident_mb() -> float:
    """Memory of this process that is in use, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def main() -> None:
    """Measure all, print the table, write the figures."""
    reason = why_absent()
    if reason is not None:
        sys.exit(f"benchmarks/sources.py: {reason}.")
    quick = "--quick" in sys.argv
    figures = {
        "large_stream": large_stream(3 if quick else 15),
        "restarts": restarts(3 if quick else 20),
        "slow_consumer": slow_consumer(3 if quick else 20),
        "simulated": simulated(2 if quick else 10),
    }
    large, again, slow = figures["large_stream"], figures["restarts"], figures["slow_consumer"]
    rows = [
        ("8 megapixels at 25 Hz: frames a second", "25", large["rate_hz"]),
        ("its load, share of a core", "0.60 at most", large["busy_share_of_a_core"]),
        (
            f"ffmpeg killed and restarted {again['restarts']} times: back within, s",
            "0.4",
            again["back_s_max"],
        ),
        ("memory growth meanwhile, MB", "flat", again["memory_growth_mb"]),
        ("consumer at 5 Hz on 60 Hz: oldest frame, in frames", "2", slow["age_frames_max"]),
        ('"simulated" at 60 Hz: frames a second', "60", figures["simulated"]["rate_hz"]),
        ("its load, share of a core", "-", figures["simulated"]["busy_share_of_a_core"]),
    ]
    print(table(("figure", "asked", "reached"), rows))
    if not quick:
        write("sources", figures)


if __name__ == "__main__":
    main()
