"""Minutes of a sensor that warms up and relaxes, on random sensors: slow presses are kept, drift is removed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

import gelform
from gelform.sensors.streams.memory import Memory
from gelform.simulate import SimulatedSensor
from stream.slow_gel import SlowGel, Touch

STEP_S = 1.0  # between simulated frames
PRESS_MM, PRESS_S, HOLD_S = 0.2, 180.0, 5.0
DRIFT_S, DRIFT = 600.0, 0.05

Sensors = list[tuple[SimulatedSensor, gelform.Calibration]]


def slow_presses(sensors: Sensors, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Two presses of 0.2 mm over 180 s each, anywhere, with LED drift: their final depth relative to that without memory."""
    kept = _by_sensor(sensors, draws, lambda sensor, calibration: _kept(sensor, calibration, rng))
    figures = {name: [figure for draw in of_one for figure in draw] for name, of_one in kept.items()}
    everything = [figure for of_one in figures.values() for figure in of_one]
    return {
        "asked": 0.95,
        "draws_of_each_sensor": draws,
        "kept_median": float(np.median(everything)),
        "kept_least": min(everything),
        "kept_by_sensor": figures,
    }


def drift(sensors: Sensors, draws: int, rng: np.random.Generator) -> dict[str, Any]:
    """Ten minutes of 5 % LED drift and a gel that relaxes by 10-30 um, without touch: RMS of the depth, um."""
    rms = _by_sensor(sensors, draws, lambda sensor, calibration: _drifted(sensor, calibration, rng))
    worst = {name: max(with_memory for with_memory, _ in of_one) for name, of_one in rms.items()}
    return {
        "asked_um": 5,
        "draws_of_each_sensor": draws,
        "rms_um_worst": max(worst.values()),
        "rms_um_worst_by_sensor": worst,
        "rms_um_without_memory": max(without for of_one in rms.values() for _, without in of_one),
    }


def _by_sensor(
    sensors: Sensors, draws: int, measured: Callable[[SimulatedSensor, gelform.Calibration], Any]
) -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = {}
    for number, (sensor, calibration) in enumerate(sensors):
        name = f"{number} {sensor.name}"
        found[name] = [measured(sensor, calibration) for _ in range(draws)]
        print(f"  {name}: {np.round(found[name], 4).tolist()}", flush=True)
    return found


def _kept(sensor: SimulatedSensor, calibration: gelform.Calibration, rng: np.random.Generator) -> list[float]:
    """The kept fraction of each of two presses: depth with memory over depth without, while the press is held."""
    reconstruct = gelform.Reconstructor(calibration)
    half = 0.3 * np.array(sensor.shape[::-1]) * sensor.mm_per_px
    touches = tuple(
        Touch(start, PRESS_S, HOLD_S, PRESS_MM, tuple(rng.uniform(-half, half)), float(rng.uniform(2, 8)))
        for start in (30, 250)
    )
    gel = SlowGel.drawn(sensor, rng, drift=DRIFT, touches=touches)
    still = SlowGel(sensor, 0 * gel.led_ends, gel.led_times_s, 0.0, 1.0, (0, 0), 1.0, touches)
    deep: dict[Touch, list[tuple[float, float]]] = {touch: [] for touch in touches}
    for result in _results(Memory(reconstruct), gel, np.arange(0, 436, STEP_S), rng):
        for touch, of_one in deep.items():
            if 0 <= result.time_s - touch.start_s - touch.press_s <= HOLD_S:
                alone = reconstruct.from_image(still.image_at(result.time_s, rng))
                of_one.append((_part_of(result, gel), _part_of(replace(alone, time_s=result.time_s), gel)))
    sums = [np.sum(of_one, axis=0) for of_one in deep.values()]
    return [float(with_memory / without) for with_memory, without in sums]


def _drifted(
    sensor: SimulatedSensor, calibration: gelform.Calibration, rng: np.random.Generator
) -> tuple[float, float]:
    """The largest RMS of the depth with memory, and without."""
    reconstruct = gelform.Reconstructor(calibration)
    gel = SlowGel.drawn(sensor, rng, drift=DRIFT)
    results = _results(Memory(reconstruct), gel, np.arange(0, DRIFT_S + 1, STEP_S), rng)
    worst = max(_rms_um(result) for result in results)
    return worst, max(_rms_um(reconstruct.from_image(gel.image_at(t, rng))) for t in (300, 400, 500, 600))


def _results(
    memory: Memory, gel: SlowGel, times_s: np.ndarray, rng: np.random.Generator
) -> Iterator[gelform.Reconstruction]:
    for index, time_s in enumerate(times_s):
        image = gel.image_at(float(time_s), rng)
        result = replace(memory.result_from_image(image), index=index, time_s=float(time_s))
        yield memory(image, result)


def _part_of(result: gelform.Reconstruction, gel: SlowGel) -> float:
    """The depth relative to the truth: the best factor over the press."""
    truth = gel.pressed_at(result.time_s).depth_mm
    return float((result.depth_mm * truth).sum() / (truth * truth).sum())


def _rms_um(result: gelform.Reconstruction) -> float:
    return 1e3 * float(np.sqrt(np.mean(np.square(result.depth_mm))))
