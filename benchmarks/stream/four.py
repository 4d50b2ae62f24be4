"""Four sensors of a hand at once: results lost, their ages, and frames per second, by threads, processes and the live page.

The frames are recorded before anything is timed, because a sensor that is simulated meanwhile takes processor time that a
camera does not. Each source then gives them at their times, like a camera, and skips what its reader comes too late for.
Only the live page simulates its sensors; `image_ms` says what one of their images takes.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import gelform
from gelform.sensors.playback import Closing, FrameReader, Pace
from gelform.sensors.simulated import SimulatedSource
from live.server import COMPUTED_S, running
from live.viewer import Viewer
from speed.turns import EVERYTHING

SENSORS = 4
RECORDED_S = 4.0  # s of the simulated sensor's program, played in a loop
WARM_S = 3.0  # s in which the first frames load and warm up
ALONE_FRAMES = 100  # of one sensor, as fast as they come, for the ratios of this run
AGE_MS = 40.0  # asked of the newest result
PARTS = {"everything": (30.0, EVERYTHING), "depth_only": (60.0, ("depth_mm",))}  # frames per second, maps


def images_of(sensor: Any, rate_hz: float, seed: int) -> list[np.ndarray]:
    """Images of a simulated sensor, computed in advance; each sensor is at another place of the program."""
    source = SimulatedSource(sensor, rate_hz=rate_hz, seed=seed)
    return [source.image_at(k) for k in range(int(RECORDED_S * rate_hz))]


class RecordedSensor(Closing, FrameReader):
    """Images in a loop at their times, as a camera has them: what a late reader missed is gone."""

    live, serial = True, None

    def __init__(self, images: list[np.ndarray], rate_hz: float) -> None:
        self._images, self.rate_hz = images, rate_hz
        self.name, self.settings, self._closed = "recorded", {}, False

    def _frames(self) -> Iterator[gelform.Frame]:
        pace, index = Pace(), 0
        while not self._closed:
            time_s = pace.wait_until(index / self.rate_hz)
            yield gelform.Frame(self._images[index % len(self._images)], time_s, time.time_ns(), index)
            index = max(index + 1, int(pace.late_s(0.0) * self.rate_hz))

    def close(self) -> None:
        self._closed = True


class Hand(threading.Thread):
    """A consumer of one sensor's stream: it reads the maps of each result, and notes how old it then is."""

    def __init__(
        self, source: RecordedSensor, calibration: gelform.Calibration, maps: tuple[str, ...]
    ) -> None:
        super().__init__(daemon=True)
        self.source, self.calibration, self.maps = source, calibration, maps
        self.ages_ms: list[float] = []
        self.taken = self.dropped = 0
        self.measuring, self.stop = threading.Event(), threading.Event()

    def run(self) -> None:
        with gelform.stream(self.source, self.calibration) as stream:
            last = -1
            for result in stream:
                for name in self.maps:
                    getattr(result, name)
                if self.measuring.is_set():
                    self.ages_ms.append(1e3 * (time.monotonic() - result.time_s))
                    self.taken += 1
                    self.dropped += max(0, result.index - last - 1)
                last = result.index
                if self.stop.is_set():
                    return


def hands(
    calibration: gelform.Calibration, films: list[list[np.ndarray]], rate_hz: float, maps: Any, seconds: float
) -> dict[str, Any]:
    """Streams of so many recorded sensors in the threads of this process."""
    consumers = [Hand(RecordedSensor(film, rate_hz), calibration, maps) for film in films]
    for one in consumers:
        one.start()
    time.sleep(WARM_S)
    busy, start = time.process_time(), time.monotonic()
    for one in consumers:
        one.measuring.set()
    time.sleep(seconds)
    for one in consumers:
        one.measuring.clear()
    spent, busy = time.monotonic() - start, time.process_time() - busy
    for one in consumers:
        one.stop.set()
        one.join(10)
    return figures_of(
        [age for one in consumers for age in one.ages_ms],
        sum(one.taken for one in consumers),
        sum(one.dropped for one in consumers),
        spent,
        busy_cores=busy / spent,
    )


def figures_of(ages_ms: list[float], taken: int, dropped: int, seconds: float, **more: Any) -> dict[str, Any]:
    """Frames per second of all sensors together, share of lost ones, and ages."""
    return {
        "frames_per_s": taken / seconds,
        "dropped": dropped,
        "dropped_share": dropped / max(taken + dropped, 1),
        "age_ms": {"median": float(np.median(ages_ms)), "95 %": float(np.quantile(ages_ms, 0.95))},
        **more,
    }


def _in_process(
    queue: Any, start: Any, path: str, film: Any, rate_hz: float, maps: Any, seconds: float
) -> None:
    """One sensor in a process of its own."""
    cv2.setNumThreads(1)
    calibration = gelform.load_calibration(path)
    gelform.Reconstructor(calibration).from_image(film[0])
    start.wait()
    consumer = Hand(RecordedSensor(film, rate_hz), calibration, maps)
    consumer.start()
    time.sleep(WARM_S)
    busy = time.process_time()
    consumer.measuring.set()
    time.sleep(seconds)
    consumer.measuring.clear()
    queue.put((consumer.ages_ms, consumer.taken, consumer.dropped, time.process_time() - busy))
    consumer.stop.set()
    consumer.join(10)


def processes(
    path: Path, films: list[list[np.ndarray]], rate_hz: float, maps: Any, seconds: float
) -> dict[str, Any]:
    """Streams of the same sensors, each in a process of its own."""
    context = multiprocessing.get_context("spawn")
    queue, start = context.Queue(), context.Barrier(len(films))
    workers = [
        context.Process(target=_in_process, args=(queue, start, str(path), film, rate_hz, maps, seconds))
        for film in films
    ]
    for one in workers:
        one.start()
    found = [queue.get() for _ in workers]
    for one in workers:
        one.join()
    ages, taken, dropped, busy = zip(*found)
    return figures_of([*chain(*ages)], sum(taken), sum(dropped), seconds, busy_cores=sum(busy) / seconds)


def page(path: Path, sensor: Any, rate_hz: float, seconds: float) -> dict[str, Any]:
    """`gelform live` of simulated sensors, whose one client watches all: results and pictures per second, and their ages."""
    source = SimulatedSource(sensor, rate_hz=rate_hz)
    image_ms = [1e3 * timed(lambda k=k: source.image_at(k)) for k in range(30)]
    words = [word for _ in range(SENSORS) for word in (f"simulated:{sensor.name}", "-c", str(path))]
    with running(*words, "--rate", f"{rate_hz:g}") as (live, _):
        viewers = [Viewer(live, station=k) for k in range(SENSORS)]
        for one in viewers:
            one.start()
        time.sleep(COMPUTED_S)
        before = [len(one.results) for one in viewers]
        for one in viewers:
            one.ages_ms.clear()
        time.sleep(seconds)
        results = sum(len(one.results) for one in viewers) - sum(before)
        ages = [age for one in viewers for age in one.ages_ms]
        for one in viewers:
            one.stop.set()
    return {
        "results_per_s": results / seconds,
        "pictures_per_s": len(ages) / seconds,
        "picture_age_ms": {"median": float(np.median(ages)), "95 %": float(np.quantile(ages, 0.95))},
        "image_ms": float(np.median(image_ms)),
    }


def as_fast_as_they_come(
    calibration: gelform.Calibration, films: list[list[np.ndarray]], maps: Any
) -> dict[str, float]:
    """Frames per second of one thread, of two beside each other, and of two processes: what this machine gives to either."""
    reconstruct = gelform.Reconstructor(calibration)

    def work(film: list[np.ndarray]) -> None:
        for k in range(ALONE_FRAMES):
            result = reconstruct.from_image(film[k % len(film)])
            for name in maps:
                getattr(result, name)

    work(films[0][:1])
    beside = {"thread": threading.Thread, "process": multiprocessing.get_context("fork").Process}
    rates: dict[str, list[float]] = {name: [] for name in ("one", *beside)}
    for _ in range(3):  # in turn, because the machine's other work changes
        rates["one"].append(ALONE_FRAMES / timed(lambda: work(films[0])))
        for name, kind in beside.items():
            both = [kind(target=work, args=(film,)) for film in films[:2]]
            rates[name].append(2 * ALONE_FRAMES / timed(partial(run_together, both)))
    one, threads, processes = (max(of) for of in rates.values())
    return {
        "one_thread_per_s": one, "two_threads_per_s": threads, "two_over_one": threads / one,
        "two_processes_per_s": processes, "two_processes_over_one": processes / one,
    }  # fmt: skip


def run_together(both: list[Any]) -> None:
    """Run threads or processes to their end."""
    for one in both:
        one.start()
    for one in both:
        one.join()


def timed(work: Callable[[], Any]) -> float:
    """Seconds of some work."""
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def four(calibration: gelform.Calibration, sensor: Any, seconds: float) -> dict[str, Any]:
    """All figures of a hand of four sensors."""
    found: dict[str, Any] = {"asked": {"dropped": 0, "age_ms": AGE_MS}, "sensors": SENSORS}
    with tempfile.TemporaryDirectory() as folder:
        calibration.save(path := Path(folder) / "hand.npz")
        for part, (rate_hz, maps) in PARTS.items():
            films = [images_of(sensor, rate_hz, seed) for seed in range(SENSORS)]
            found[part] = {
                "rate_hz": rate_hz,
                "alone": as_fast_as_they_come(calibration, films, maps),
                "threads": hands(calibration, films, rate_hz, maps, seconds),
                "processes": processes(path, films, rate_hz, maps, seconds),
            }
            if part == "everything":
                found[part]["page"] = page(path, sensor, rate_hz, seconds)
            print(f"  {part}: {found[part]}", flush=True)
    return {**found, "load_average": os.getloadavg()[0], "cores": os.cpu_count()}
