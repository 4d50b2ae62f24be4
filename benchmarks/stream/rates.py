"""A stream of the simulated sensor in real time: rate and latency, age at a slow consumer, memory over an hour."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np

import gelform
from gelform.sensors.streams import Stream

RATE_HZ, CONSUMER_HZ = 60, 5
WARM_S = 3.0  # s in which the first frames load and warm up
SOAK_START_S = 60.0  # s; memory that a process takes in its first minute is no growth


def live(calibration: gelform.Calibration, seconds: float) -> dict[str, Any]:
    """60 frames per second of 240x320: number of results, their delay in a loop, time of each stage."""
    ages_ms = []
    with gelform.stream("simulated", calibration) as stream:
        before, busy, start = _warmed(stream).stats, time.process_time(), time.monotonic()
        for result in stream:
            ages_ms.append(1e3 * (time.monotonic() - result.time_s))
            if time.monotonic() - start > seconds:
                break
        stats, spent = stream.stats, time.monotonic() - start
        busy_cores = (time.process_time() - busy) / spent
    return {
        "asked": {"rate_hz": RATE_HZ, "latency_ms": 15},
        "rate_hz": (stats.results - before.results) / spent,
        "dropped": stats.drops - before.drops,
        "latency_ms": stats.latency_ms,
        "at_the_loop_ms": {f"{q:g}": float(np.quantile(ages_ms, q)) for q in (0.5, 0.9, 0.99, 1)},
        "stage_ms": stats.stage_ms,
        "busy_cores_of_2": busy_cores,
        "load_average": os.getloadavg()[0],
    }


def slow_consumer(calibration: gelform.Calibration, seconds: float) -> dict[str, Any]:
    """Ages, in frames of the source, of the results of a loop and of `latest` for a consumer at 5 Hz."""
    found: dict[str, Any] = {"asked": {"age_frames": 2}}
    with gelform.stream("simulated", calibration) as stream:
        _warmed(stream)
        results = iter(stream)
        for name, ask in (("loop", lambda: next(results)), ("latest", lambda: stream.latest(1.0))):
            ages, end = [], time.monotonic() + seconds
            while time.monotonic() < end:
                time.sleep(1 / CONSUMER_HZ)
                ages.append((time.monotonic() - ask().time_s) * RATE_HZ)
            found[name] = {
                "asked_times": len(ages),
                "frames_median": float(np.median(ages)),
                "frames_max": max(ages),
                "share_over_2": float(np.mean(np.array(ages) > 2)),
            }
    return {**found, "load_average": os.getloadavg()[0]}


def soak(calibration: gelform.Calibration, minutes: float) -> dict[str, Any]:
    """A long-running stream: growth of its memory per hour, by a line fitted to the minutes, and its rates."""
    rates, resident, samples = [], [], max(2, round(minutes))
    with gelform.stream("simulated", calibration) as stream:
        stream.newest(timeout_s=60)
        time.sleep(min(SOAK_START_S, 60 * minutes / samples))
        resident.append(resident_mb())
        for _ in range(samples):
            before, start = stream.stats.results, time.monotonic()
            time.sleep(60 * minutes / samples)
            rates.append((stream.stats.results - before) / (time.monotonic() - start))
            resident.append(resident_mb())
            print(f"  {rates[-1]:.1f} a second, {resident[-1]:.1f} MB", flush=True)
    hours = np.arange(len(resident)) * minutes / samples / 60
    return {
        "asked": {"growth_mb_per_hour": 20},
        "minutes": minutes,
        "growth_mb": resident[-1] - resident[0],
        "growth_mb_per_hour": float(np.polyfit(hours, resident, 1)[0]),
        "resident_mb": resident,
        "rate_hz_least": min(rates),
        "rate_hz_most": max(rates),
        "load_average": os.getloadavg()[0],
    }


def resident_mb() -> float:
    """Memory in use by this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def _warmed(stream: Stream) -> Stream:
    stream.newest(timeout_s=60)
    time.sleep(WARM_S)
    return stream
