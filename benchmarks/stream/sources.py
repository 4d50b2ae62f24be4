"""Streams from a real ffmpeg: 8 megapixels at 25 Hz; killed and restarted 20 times."""

from __future__ import annotations

import gc
import os
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.image.view import View
from gelform.sensors.grabber import Grabber
from gelform.sensors.simulated import SimulatedSource, simulated_sensor_named
from stream.ffmpeg_camera import FFMPEG, FfmpegCamera
from stream.rates import resident_mb

LARGE, LARGE_HZ = (2448, 3264), 25
SMALL_HZ = 60
NOISE_LEVELS = 1.5  # gray levels, added to the large pictures, so that their size in bytes is a camera's
OFF_S = (0.2, 0.8, 1.5)  # s that the camera is off, in turn
SETTLED_S = 90.0  # s until a stream's memory is full: ten-second means of more than a minute


def large_stream(calibration: gelform.Calibration, seconds: float) -> dict[str, Any]:
    """8 megapixels at 25 Hz: frames per second and load of this process; capture alone, then with reconstruction."""
    made = f"-f lavfi -i testsrc2=size={LARGE[1]}x{LARGE[0]}:rate={LARGE_HZ} -t 2 -c:v mjpeg -q:v 3"
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "pattern.mjpeg"
        subprocess.run([FFMPEG, "-loglevel", "error", *made.split(), str(film)], check=True)
        captured = _captured(film, LARGE_HZ, seconds)
        film = Path(folder) / "gel.mjpeg"
        picture_bytes = _film_of_gel(film, LARGE, LARGE_HZ, quality=85)
        shape = (LARGE[0] // 4, LARGE[1] // 4)
        viewed = replace(calibration, view=View(shape, image_shape=calibration.image_shape))
        reconstructed = _reconstructed(film, viewed, seconds)
    return {
        "asked": {"rate_hz": LARGE_HZ, "busy_share_of_a_core": 0.6},
        "captured": captured,
        "reconstructed": {"picture_bytes": picture_bytes, **reconstructed},
        "load_average": os.getloadavg()[0],
    }


def restarts(calibration: gelform.Calibration, count: int, settled_s: float = SETTLED_S) -> dict[str, Any]:
    """Time from a killed camera's restart to its first result, and the memory of the process."""
    back_s, memory_mb, said = [], [], 0
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "gel.mjpeg"
        _film_of_gel(film, calibration.image_shape, SMALL_HZ, quality=95)
        with _camera(film, SMALL_HZ) as camera, gelform.stream(camera.url, calibration) as stream:
            newest = stream.newest(timeout_s=20)
            time.sleep(settled_s)
            memory_mb.append(resident_mb())
            for k in range(count):
                assert newest is not None
                camera.kill()
                time.sleep(OFF_S[k % len(OFF_S)])
                said += stream.stats.state == "reconnecting"
                last = stream.newest(timeout_s=0)
                assert last is not None
                returned = camera.start()
                newest = stream.newest(last.index, timeout_s=20)
                back_s.append(time.monotonic() - returned)
                time.sleep(0.5)
                gc.collect()
                memory_mb.append(resident_mb())
            known = float(np.mean(newest.result.known))
    return {
        "asked": {"back_s": 0.4},
        "restarts": count,
        "back_s_max": max(back_s),
        "back_s_median": float(np.median(back_s)),
        "back_s": back_s,
        "said_reconnecting": said,
        "memory_growth_mb": memory_mb[-1] - memory_mb[0],
        "resident_mb": memory_mb,
        "known_share_of_the_last_result": known,
        "load_average": os.getloadavg()[0],
    }


def _captured(film: Path, rate_hz: float, seconds: float) -> dict[str, Any]:
    with _camera(film, rate_hz) as camera, Grabber(camera.url) as grabber:
        first = grabber.newest(-1, 20)
        assert first is not None
        time.sleep(1.0)
        before, busy, started = grabber.stats, time.process_time(), time.monotonic()
        time.sleep(seconds)
        after, wall = grabber.stats, time.monotonic() - started
        return {
            "rate_hz": (after.frames - before.frames) / wall,
            "served_hz": (after.frames - before.frames + after.drops - before.drops) / wall,
            "busy_share_of_a_core": (time.process_time() - busy) / wall,
            "decoded_px": list(first.image.shape[:2]),
        }


def _reconstructed(film: Path, calibration: gelform.Calibration, seconds: float) -> dict[str, Any]:
    with _camera(film, LARGE_HZ) as camera, gelform.stream(camera.url, calibration) as stream:
        stream.newest(timeout_s=60)
        time.sleep(2.0)
        before, busy, started = stream.stats, time.process_time(), time.monotonic()
        time.sleep(seconds)
        after, wall = stream.stats, time.monotonic() - started
        newest = stream.newest(timeout_s=20)
        assert newest is not None
        return {
            "rate_hz": (after.results - before.results) / wall,
            "busy_share_of_a_core": (time.process_time() - busy) / wall,
            "latency_ms": after.latency_ms,
            "known_share_of_the_last_result": float(np.mean(newest.result.known)),
        }


@contextmanager
def _camera(film: Path, rate_hz: float) -> Iterator[FfmpegCamera]:
    """An ffmpeg that serves the pictures of a film unchanged, in a loop."""
    with FfmpegCamera(f"-f mjpeg -framerate {rate_hz} -stream_loop -1 -i {film} -c:v copy") as camera:
        yield camera


def _film_of_gel(path: Path, shape: tuple[int, int], rate_hz: int, quality: int) -> float:
    """Two seconds of the simulated sensor as JPEG pictures of that shape; returns the bytes of one."""
    source = SimulatedSource(simulated_sensor_named("three-edges"), rate_hz=rate_hz)
    rng, pictures = np.random.default_rng(0), []
    for index in range(2 * rate_hz):
        image = source.image_at(index)
        if image.shape[:2] != shape:
            image = cv2.resize(image, shape[::-1], interpolation=cv2.INTER_CUBIC)
            noise = NOISE_LEVELS * rng.standard_normal((shape[0], shape[1], 1), dtype=np.float32)
            image = np.clip(image + noise, 0, 255).astype(np.uint8)
        code = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
        pictures.append(code.tobytes())
    path.write_bytes(b"".join(pictures))
    return path.stat().st_size / len(pictures)
