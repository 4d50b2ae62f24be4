"""Part of real_frames.py: what a stream learns while it runs: of a slow press, which it must not, and of drifting light."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

import gelform
from gelform.image.light import block_means
from gelform.sensors.streams.memory import Memory
from gelform.simulate import LAYOUTS
from real_frames.contacts import with_noise
from real_frames.sets import Run
from report import table
from stream.slow_gel import SlowGel, Touch

LAYOUT, SEED = "ring-120", 20261126
PRESS_S, HOLD_S, REST_S, STEP_S = (
    60.0,
    60.0,
    20.0,
    2.0,
)  # of a slow press, after a rest; a frame in so many seconds
DRIFT_S, DRIFT, DRIFTING = 600.0, 0.05, 3  # s; change of the LEDs' light, as a fraction; gels
PRESSES = 3  # of a set
DEEP = 0.3  # of the peak: pixels of the press itself
BALLS = {"small ball": (2.0, 0.2), "large ball": (4.0, 0.5)}  # radius and depth, mm
FOLLOWING = ("slow presses, um", "slow real presses, % of peak", "light after ten minutes of drift, %")


def following(run: Run) -> dict[str, Any]:
    """Error of depth in contact during a slow press, with and without the memory of a stream; error of a drifting light.

    A simulated press is judged by its truth. A real one is a press blended in over a minute, judged by the same frames read
    without memory: root mean square over pixels deeper than 0.3 of the peak, and percent of the peak.
    """
    layout, real = run.layout(LAYOUT), {}
    for name in run.sets:
        images = [press.image for press in run.presses(name).presses]
        real[name] = _real(run.calibration(name), images[:: len(images) // PRESSES][:PRESSES])
    pressed = {what: _simulated(layout, *ball) for what, ball in BALLS.items()}
    figures = dict(zip(FOLLOWING, (pressed, real, _drift(layout))))
    for what, rows in figures.items():
        header = [what, *next(iter(rows.values()))]
        print("\n" + table(header, [[name, *row.values()] for name, row in rows.items()]), flush=True)
    return figures


def _times() -> np.ndarray:
    return np.arange(0, REST_S + PRESS_S + HOLD_S + STEP_S / 2, STEP_S)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _both(
    calibration: gelform.Calibration, images: Iterable[np.ndarray], times: Sequence[float]
) -> list[tuple[Any, Any]]:
    """Each image's result without memory, and by the memory of the images before it."""
    alone = gelform.Reconstructor(calibration)
    memory, results = Memory(alone), []
    for index, (image, time_s) in enumerate(zip(images, times)):
        found = memory.result_from_image(image).changed(index=index, time_s=float(time_s))
        results.append((alone.from_image(image), memory(image, found)))
    return results


def _by_stage(times: np.ndarray, errors: Callable[[int, int], float]) -> dict[str, float]:
    """Root mean square of the errors (of frame and reader) while pressing and while held, without and with memory."""
    stages = {
        "pressing": np.flatnonzero((times > REST_S + PRESS_S / 4) & (times <= REST_S + PRESS_S)),
        "held": np.flatnonzero(times > REST_S + PRESS_S),
    }
    return {
        f"{stage}, {reader}": _rms(np.array([errors(int(k), which) for k in frames]))
        for stage, frames in stages.items()
        for which, reader in enumerate(("no memory", "memory"))
    }


def _simulated(calibration: gelform.Calibration, radius_mm: float, depth_mm: float) -> dict[str, float]:
    """Errors against the truth, um, on a gel without drift."""
    sensor, rng, times = LAYOUTS[LAYOUT], np.random.default_rng(SEED), _times()
    touch = Touch(REST_S, PRESS_S, HOLD_S + 1, depth_mm, (1.5, -1.0), radius_mm)
    gel = replace(SlowGel.drawn(sensor, rng, drift=0.0, touches=(touch,)), hill_mm=0.0)
    results = _both(calibration, (gel.image_at(t, rng) for t in times), times)

    def error(k: int, reader: int) -> float:
        truth = gel.pressed_at(times[k]).depth_mm
        deep = truth > DEEP * truth.max()
        return 1e3 * _rms((results[k][reader].depth_mm - truth)[deep])

    return _by_stage(times, error)


def _real(calibration: gelform.Calibration, presses: Sequence[np.ndarray]) -> dict[str, float]:
    """Change of depth by the memory, percent of the peak, root mean square over presses."""
    rng, times, found = np.random.default_rng(SEED), _times(), []
    parts = np.clip((times - REST_S) / PRESS_S, 0, 1)
    for press in presses:
        rest = (with_noise(calibration, rng).astype(np.float64) for _ in times)
        images = (
            np.clip(np.rint((1 - a) * one + a * press), 0, 255).astype(np.uint8)
            for a, one in zip(parts, rest)
        )
        results = _both(calibration, images, times)
        deep = results[-1][0].depth_mm > DEEP * results[-1][0].peak_mm

        def error(k: int, reader: int, results: Any = results, deep: Any = deep) -> float:
            alone, now = results[k][0].depth_mm, results[k][reader].depth_mm
            return 100 * _rms((now - alone)[deep]) / float(alone[deep].max())

        found.append(_by_stage(times, error))
    return {
        stage: _rms(np.array([one[stage] for one in found])) for stage in found[0] if "no memory" not in stage
    }


def _drift(calibration: gelform.Calibration) -> dict[str, Any]:
    """Error of the background image's blocks against the true light, root mean square in percent, and depth's at rest."""
    figures: dict[str, Any] = {}
    for hill in ("LEDs", "LEDs and gel"):
        rows = []
        for seed in range(DRIFTING):
            rng = np.random.default_rng([SEED, seed])
            gel = SlowGel.drawn(LAYOUTS[LAYOUT], rng, drift=DRIFT)
            gel = gel if "gel" in hill else replace(gel, hill_mm=0.0)
            times = np.arange(0, DRIFT_S + STEP_S / 2, STEP_S)
            own = replace(calibration, background=gel.image_at(0, None).astype(np.float32))
            memory = Memory(gelform.Reconstructor(own))
            depths = []
            for index, time_s in enumerate(times):
                image = gel.image_at(time_s, rng)
                found = memory.result_from_image(image).changed(index=index, time_s=float(time_s))
                depths.append(1e3 * _rms(memory(image, found).depth_mm))
            truth = block_means(gel.image_at(times[-1], None).astype(np.float32))
            now, start = (block_means(one) for one in (memory.reconstruct.background, own.background))
            rows.append((100 * _rms(now / truth - 1), 100 * _rms(start / truth - 1), max(depths)))
        light, alone, depth = np.array(rows).T
        figures[hill] = {
            "followed": _rms(light),
            "not followed": _rms(alone),
            "depth at rest, most, um": float(depth.max()),
        }
    return figures
