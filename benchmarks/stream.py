"""Streams: rate and latency, age at a slow consumer, slow presses against drift, faults found, false alarms; a soak.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python benchmarks/stream.py             # about 20 minutes on an idle machine
    python benchmarks/stream.py --quick                                              # a few draws of each
    python benchmarks/stream.py --only faults --draws 40
    python benchmarks/stream.py --soak 60                                            # an hour; memory and rate

Gels, faults, presses and drift are drawn from `--seed`, a new one each time unless it is given: nothing is tuned on what is
reported. What takes minutes in life is simulated faster: a stream's memory takes its times from the frames.
Writes results/stream.json; parts that were not run keep their figures.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np

import gelform
from gelform.sensors.files import read_image
from gelform.simulate import LAYOUTS, simulate_ball_presses
from gelform.simulate.background import simulate_background
from gelform.streams.memory import Memory
from report import RESULTS, write
from sensor_faults import FAULTS, Gel, found_in, frames_with
from slow_gel import SlowGel, Touch

SMALL = replace(LAYOUTS["three-edges"], shape=(132, 176), mm_per_px=0.1153)
FULL = LAYOUTS["three-edges"]
STEP_S = 1.0  # between simulated frames of minutes
NAMED = {
    "brightness_shift", "camera_moved", "color_shift", "dust", "frozen",
    "other_gel", "room_light", "scratch", "tear", "torn",
}  # fmt: skip
DATA = Path(os.environ.get("GELFORM_DATA", Path(__file__).parents[2] / "shared" / "data"))


def calibrated(sensor: Any) -> gelform.Calibration:
    """A calibration of a simulated sensor, made as a user does; its background is the mean of ten frames."""
    rng = np.random.default_rng(3)
    simulated = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=14, rng=rng)
    with tempfile.TemporaryDirectory() as folder:
        presses = gelform.save_press_folder(
            folder,
            background=simulated.background,
            images=[press.image for press in simulated.presses],
            ball_diameters_mm=[press.ball_diameter_mm for press in simulated.presses],
            mm_per_px=sensor.mm_per_px,
            name="simulated",
        )
        calibration = gelform.calibrate(gelform.read_presses(presses), color_model="hierarchical")
    return replace(calibration, background=simulate_background(sensor, rng, frames=10))


def live(calibration: gelform.Calibration, seconds: float) -> dict[str, Any]:
    """60 frames a second of 240x320: how many become results, how late, and where the time goes."""
    with gelform.stream("simulated", calibration) as stream:
        stream.newest(timeout_s=60)
        time.sleep(2)  # the first frames load and warm
        before, start = stream.stats, time.monotonic()
        time.sleep(seconds)
        stats, spent = stream.stats, time.monotonic() - start
    return {
        "asked": {"rate_hz": 60, "latency_ms": 15},
        "rate_hz": (stats.results - before.results) / spent,
        "drops_share": (stats.drops - before.drops) / max(1, stats.results - before.results),
        "latency_ms": stats.latency_ms,
        "stage_ms": stats.stage_ms,
    }


def slow_consumer(calibration: gelform.Calibration, seconds: float) -> dict[str, Any]:
    """Ages of what a loop gets that comes by five times a second, in frames of the source."""
    ages = []
    with gelform.stream("simulated", calibration) as stream:
        stream.newest(timeout_s=60)
        time.sleep(2)
        end = time.monotonic() + seconds
        for result in stream:
            ages.append((time.monotonic() - result.time_s) * 60)
            time.sleep(0.2)
            if time.monotonic() > end:
                break
    late = float(np.mean(np.array(ages) > 2))
    return {
        "asked": {"age_frames": 2},
        "frames_median": float(np.median(ages)),
        "frames_max": max(ages),
        "share_over_2": late,
    }


def sequence(
    memory: Memory, gel: SlowGel, times_s: np.ndarray, rng: np.random.Generator
) -> Iterator[gelform.Reconstruction]:
    """The results of a gel's images at these times."""
    for index, time_s in enumerate(times_s):
        image = gel.image_at(float(time_s), rng)
        result = replace(memory.result_from_image(image), index=index, time_s=float(time_s))
        yield memory(image, result)


def part_of(result: gelform.Reconstruction, gel: SlowGel) -> float:
    """The depth in depths of the truth: the best factor over the press."""
    truth = gel.pressed_at(result.time_s).depth_mm
    return float((result.depth_mm * truth).sum() / (truth * truth).sum())


def slow_presses(calibration: gelform.Calibration, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Two presses of 0.2 mm over 180 s each, anywhere, LEDs drifting: the depth at their ends in that of no memory."""
    reconstruct, kept = gelform.Reconstructor(calibration), []
    for _ in range(draws):
        half = 0.3 * np.array(SMALL.shape[::-1]) * SMALL.mm_per_px
        touches = tuple(
            Touch(start, 180.0, 5.0, 0.2, tuple(rng.uniform(-half, half)), float(rng.uniform(2, 8)))
            for start in (30, 250)
        )
        gel = SlowGel.drawn(SMALL, rng, drift=0.05, touches=touches)
        still = SlowGel(SMALL, 0 * gel.led_ends, gel.led_times_s, 0.0, 1.0, (0, 0), 1.0, touches)
        for result in sequence(Memory(reconstruct), gel, np.arange(0, 436, STEP_S), rng):
            if gel.pressed_at(result.time_s).depth_mm.max() > 0.199:
                alone = reconstruct.from_image(still.image_at(result.time_s, rng))
                kept.append(part_of(result, gel) / part_of(replace(alone, time_s=result.time_s), gel))
    return {"asked": 0.95, "draws": draws, "kept_median": float(np.median(kept)), "kept_least": min(kept)}


def drift(calibration: gelform.Calibration, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Ten minutes of 5 % LED drift and a gel that relaxes by 10-30 um, nothing touching: RMS of the depth, um."""
    reconstruct, worst, without = gelform.Reconstructor(calibration), [], []
    for _ in range(draws):
        gel = SlowGel.drawn(SMALL, rng, drift=0.05)
        results = sequence(Memory(reconstruct), gel, np.arange(0, 601, STEP_S), rng)
        worst.append(max(_rms_um(result) for result in results))
        without.append(
            max(_rms_um(reconstruct.from_image(gel.image_at(t, rng))) for t in (300, 400, 500, 600))
        )
    return {"asked_um": 5, "draws": draws, "rms_um_worst": max(worst), "rms_um_without_memory": max(without)}


def _rms_um(result: gelform.Reconstruction) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.square(result.depth_mm))))


def faults(calibration: gelform.Calibration, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Each fault on gels drawn at random: how often it is named within 48 s, and what else; and sound gels."""
    found: dict[str, Any] = {}
    for fault in (None, *FAULTS):
        others: Counter[str] = Counter()
        named = 0
        for _ in range(draws):
            gel = Gel.drawn(SMALL, rng)
            names = (
                NAMED & found_in(frames_with(fault, gel, 60, rng), gel.calibration(calibration, rng)).keys()
            )
            named += fault in names
            others.update(names - {fault})
        found[fault or "none"] = {"named": named / draws, "other_names": dict(others)}
        print(f"  {fault or 'none'}: named {named} of {draws}, other names {dict(others)}", flush=True)
    return {"asked": 0.95, "draws": draws, "by_fault": found}


def false_alarms() -> dict[str, Any]:
    """Real sensors that are sound, each image shown for two seconds, video as it is: names of faults that were found."""
    mini = gelform.calibrate(gelform.read_presses(DATA / "mini-ball"), color_model="hierarchical")
    found = {}
    for name, images, background, rate_hz in _real_sequences():
        calibration = replace(
            mini, background=background.astype(np.float32)
        )  # the untouched image of its own unit
        names = NAMED & found_in(iter(images), calibration, rate_hz).keys()
        found[name] = sorted(names)
        print(f"  {name}: {len(images)} images: {sorted(names)}", flush=True)
    return {"asked": 0, "by_set": found}


def _real_sequences() -> Iterator[tuple[str, list[np.ndarray], np.ndarray, float]]:
    presses = gelform.read_presses(DATA / "mini-ball")
    yield "mini-ball", [press.image for press in presses.presses], presses.background, 0.5
    folder = DATA / "mini-objects"
    files = sorted(path for path in folder.rglob("*.png") if "background" not in path.name)
    rest = read_image(next(iter(folder.rglob("background*.png"))))
    images = [image for path in files if (image := read_image(path)).shape == rest.shape]
    yield "mini-objects", images * 10, rest, 0.5
    video = next(
        path
        for path in (DATA / "mini-markers-video").iterdir()
        if path.suffix in (".mp4", ".avi", ".mov", ".mkv")
    )
    frames = [
        cv2.resize(frame.image, (320, 240), interpolation=cv2.INTER_AREA) for frame in gelform.Video(video)
    ]
    yield "mini-markers-video", frames, np.mean(frames[:20], axis=0), 25.0


def soak(calibration: gelform.Calibration, minutes: float) -> dict[str, Any]:
    """A stream that runs for long: memory after the first minute and at the end, and the rate of each minute."""
    rates, resident = [], []
    with gelform.stream("simulated", calibration) as stream:
        stream.newest(timeout_s=60)
        time.sleep(60)
        resident.append(_resident_mb())
        for _ in range(max(1, round(minutes))):
            before = stream.stats.results
            time.sleep(60)
            rates.append((stream.stats.results - before) / 60)
            resident.append(_resident_mb())
            print(f"  {rates[-1]:.1f} a second, {resident[-1]:.1f} MB", flush=True)
    return {
        "asked": {"growth_mb": 20},
        "minutes": minutes,
        "growth_mb": resident[-1] - resident[0],
        "most_mb": max(resident),
        "rate_hz_least": min(rates),
        "rate_hz_most": max(rates),
    }


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a few draws and seconds of each")
    parser.add_argument("--only", choices=("live", "slow", "presses", "drift", "faults", "alarms"), nargs="+")
    parser.add_argument("--draws", type=int)
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6))
    parser.add_argument("--soak", type=float, metavar="MINUTES")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    rng, seconds = np.random.default_rng(asked.seed), 5 if asked.quick else 30
    few, many = (asked.draws or 1, asked.draws or 2) if asked.quick else (asked.draws or 8, asked.draws or 40)
    cache: dict[Any, gelform.Calibration] = {}

    def of(sensor: Any) -> gelform.Calibration:
        return cache.setdefault(sensor.shape, cache.get(sensor.shape) or calibrated(sensor))

    parts: dict[str, Callable[[], dict[str, Any]]] = {
        "live": lambda: live(of(FULL), seconds),
        "slow": lambda: slow_consumer(of(FULL), seconds),
        "presses": lambda: slow_presses(of(SMALL), few, rng),
        "drift": lambda: drift(of(SMALL), few, rng),
        "faults": lambda: faults(of(SMALL), many, rng),
        "alarms": false_alarms,
    }
    chosen = ["soak"] if asked.soak else asked.only or list(parts)
    parts["soak"] = lambda: soak(of(FULL), asked.soak)
    written = RESULTS / "stream.json"
    figures = json.loads(written.read_text()) if written.exists() else {}
    for name in chosen:
        figures[name] = {"seed": asked.seed, **parts[name]()}
        print(f"{name}: {json.dumps(figures[name], default=float)}", flush=True)
    if not asked.quick:
        figures.pop("machine", None)
        write("stream", figures)


if __name__ == "__main__":
    main()
