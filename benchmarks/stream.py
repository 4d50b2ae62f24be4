"""Figures of streams: rate, latency, age, lost sources, large frames, named faults, false alarms, a soak.

    python benchmarks/stream.py                        # all except the soak test: about 15 minutes on an idle machine
    python benchmarks/stream.py --quick                # a few draws and seconds of each, about 4 minutes; writes nothing
    python benchmarks/stream.py --only live slow       # some parts; the others keep their figures
    python benchmarks/stream.py --only four            # four sensors of a hand; on a machine without other work
    python benchmarks/stream.py --soak 60              # an hour of the simulated sensor: memory and rate

Parts: live (1 min), slow (2 min), restarts and large (3 and 2 min; with a real ffmpeg), four (4 min), faults (8 min), alarms
(2 min; needs GELFORM_DATA).

Gels and faults are random, by default with a new `--seed` each time: nothing is tuned on the reported data. Minutes of them
are simulated faster than real time, because a stream's memory takes its times from the frames.
The script writes results/stream.json. Times and ages depend on the machine's other work, so its load is recorded too.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import cv2
import numpy as np

import gelform
from gelform.sensors.files import read_image
from gelform.simulate import LAYOUTS, simulate_ball_presses
from gelform.simulate.light import simulate_background
from presses import DATA, presses_of, unlabeled
from report import recorded, table, write
from stream.ffmpeg_camera import why_absent
from stream.four import four
from stream.rates import live, slow_consumer, soak
from stream.sensor_faults import FAULTS, Gel, found_in, frames_with
from stream.sources import large_stream, restarts

SMALL = replace(LAYOUTS["three-edges"], shape=(132, 176), mm_per_px=0.1153)
FULL = LAYOUTS["three-edges"]
PARTS = ("live", "slow", "restarts", "large", "four", "faults", "alarms")
NAMED = {
    "brightness_shift", "camera_moved", "color_shift", "dust", "frozen",
    "other_gel", "room_light", "scratch", "tear", "torn",
}  # fmt: skip


def calibrated(sensor: Any) -> gelform.Calibration:
    """A calibration of a simulated sensor, as a user makes it; its background is the mean of ten frames."""
    rng = np.random.default_rng(3)
    simulated = simulate_ball_presses(sensor, ball_diameters_mm=[5.0, 8.0], count=14, rng=rng)
    calibration = gelform.calibrate(unlabeled(presses_of(simulated)), color_model="hierarchical")
    return replace(calibration, background=simulate_background(sensor, rng, frames=10))


def faults(calibration: gelform.Calibration, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Each fault on random gels: how often it is named within 48 s, and other findings; and gels without a fault."""
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
    """Real sensors without a fault, each image shown for two seconds, video unchanged: names of findings."""
    mini = gelform.calibrate(gelform.read_presses(DATA / "mini-ball"), color_model="hierarchical")
    found = {}
    for name, images, background, rate_hz in _real_sequences():
        calibration = replace(
            mini, background=background.astype(np.float32)
        )  # the background image of its own unit
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


def parts_of(asked: argparse.Namespace, rng: np.random.Generator) -> dict[str, Callable[[], dict[str, Any]]]:
    """The requested parts by name."""
    quick = asked.quick
    of = cache(calibrated)
    seconds, draws = (5, 2) if quick else (30, 40)
    draws = asked.draws or draws
    return {
        "live": lambda: live(of(FULL), seconds),
        "slow": lambda: slow_consumer(of(FULL), seconds),
        "restarts": lambda: of_ffmpeg(lambda: restarts(of(FULL), *((3, 5.0) if quick else (20,)))),
        "large": lambda: of_ffmpeg(lambda: large_stream(of(FULL), 3 if quick else 20)),
        "four": lambda: four(of(FULL), FULL, seconds),
        "faults": lambda: faults(of(SMALL), draws, rng),
        "alarms": false_alarms,
        "soak": lambda: soak(of(FULL), asked.soak),
    }


def of_ffmpeg(part: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """The part's figures, or the reason why there are none."""
    reason = why_absent()
    return part() if reason is None else {"skipped": reason}


def shown(figures: dict[str, Any]) -> str:
    """A table of required and measured figures, of the parts that were run."""
    wanted = (
        ("live", "simulated 240x320 at 60 Hz: results a second", "60", ("rate_hz",)),
        ("live", "capture to result, median ms", "15", ("latency_ms",)),
        ("slow", "oldest result of a loop at 5 Hz, frames", "2", ("loop", "frames_max")),
        ("slow", "oldest result of `latest` at 5 Hz, frames", "2", ("latest", "frames_max")),
        ("restarts", "ffmpeg killed and restarted: back within, s", "0.4", ("back_s_max",)),
        ("restarts", "memory growth meanwhile, MB", "flat", ("memory_growth_mb",)),
        ("large", "8 megapixels at 25 Hz: frames a second", "25", ("captured", "rate_hz")),
        ("large", "share of a core", "0.6", ("captured", "busy_share_of_a_core")),
        ("large", "with reconstruction: results a second", "-", ("reconstructed", "rate_hz")),
        ("large", "share of a core", "-", ("reconstructed", "busy_share_of_a_core")),
        *(
            ("four", f"four sensors, {what}, {kind}: {name}", asked, (what, kind, *path))
            for what, rate in (("everything", "120"), ("depth_only", "240"))
            for kind in ("threads", "processes")
            for name, asked, path in (
                ("frames a second", rate, ("frames_per_s",)),
                ("frames lost", "0", ("dropped",)),
                ("age at the consumer, 95 %, ms", "40", ("age_ms", "95 %")),
            )
        ),
        ("four", "everything: two threads over one", "1.8", ("everything", "alone", "two_over_one")),
        ("four", "depth_only: two threads over one", "1.8", ("depth_only", "alone", "two_over_one")),
        *(
            ("four", f"{part}: two processes over one", "-", (part, "alone", "two_processes_over_one"))
            for part in ("everything", "depth_only")
        ),
        ("soak", "memory growth an hour, MB", "20", ("growth_mb_per_hour",)),
    )
    rows = []
    for part, what, asked, path in wanted:
        value = figures.get(part)
        for key in path:
            value = value.get(key) if isinstance(value, dict) else None
        if value is not None:
            rows.append((what, asked, float(value)))
    return table(("figure", "asked", "reached"), rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--quick", action="store_true", help="a few draws and seconds of each; writes nothing"
    )
    parser.add_argument("--only", choices=PARTS, nargs="+")
    parser.add_argument("--draws", type=int, help="of each fault")
    parser.add_argument("--seed", type=int, default=secrets.randbelow(10**6))
    parser.add_argument("--soak", type=float, metavar="MINUTES")
    asked = parser.parse_args()
    cv2.setNumThreads(1)
    parts = parts_of(asked, np.random.default_rng(asked.seed))
    figures = recorded("stream")
    for name in ["soak"] if asked.soak else asked.only or PARTS:
        figures[name] = {"seed": asked.seed, **parts[name]()}
        print(f"{name}: {json.dumps(figures[name], default=float)}", flush=True)
        if not asked.quick:
            write("stream", figures)
    print(shown(figures))


if __name__ == "__main__":
    main()
