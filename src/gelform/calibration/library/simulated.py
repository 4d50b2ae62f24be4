"""Calibrations of simulated sensors: shipped for the default one, else made by `calibrate` on simulated presses and cached.

The modules for making one are imported on demand, because that takes longer than the first picture.
"""

from __future__ import annotations

import os
from importlib import resources
from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

from gelform import __version__
from gelform.calibration_file import FORMAT_VERSION, Calibration, load_calibration
from gelform.errors import CalibrationError
from gelform.foundations.progress import Progress, no_progress
from gelform.sensors.simulated.settings import simulated_sensor_named
from gelform.sensors.source import DEFAULT_SENSOR
from gelform.simulate import SimulatedPresses, SimulatedSensor, simulate_ball_presses

BALLS_MM, COUNT, SEED = (4.0, 6.0), 16, 11  # ball diameters, presses per ball, seed of the places
SHIPPED = f"{DEFAULT_SENSOR}.npz"  # made by `benchmarks/live.py --calibration`
COLOR_MODEL = "polynomial"  # half the time of choosing a model; 0.2 degrees worse than the best model here


def ready_calibration(sensor: SimulatedSensor, *, progress: Progress = no_progress) -> Calibration:
    """The calibration of a simulated sensor: shipped, cached, or made in about ten seconds.

    Parameters
    ----------
    sensor : SimulatedSensor
    progress : called with (done, total, what) while the calibration is made
    """
    if sensor == simulated_sensor_named(DEFAULT_SENSOR):
        with resources.as_file(resources.files(__package__) / SHIPPED) as shipped:
            return load_calibration(shipped)
    kept = kept_path(sensor)
    if kept is not None and kept.is_file():
        try:
            return load_calibration(kept)
        except CalibrationError:
            kept.unlink(missing_ok=True)  # damaged; it is gelform's own file, and is made again
    from gelform.calibration.fit import calibrate
    from gelform.calibration.presses.press_set import presses_from_simulated

    made = simulated_presses(sensor, COUNT, progress=progress)
    calibration = calibrate(presses_from_simulated(made), color_model=COLOR_MODEL, progress=progress)
    if kept is not None:
        calibration.save(kept, overwrite=True)
    return calibration


def kept_path(sensor: SimulatedSensor) -> Path | None:
    """The path of the cached calibration of a sensor; None if the user's cache is not writable."""
    folder = user_cache_path("gelform", appauthor=False)
    if not folder.is_absolute():  # a user without a home folder
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    height, width = sensor.shape
    return folder / f"{sensor.name}-{height}x{width}-{__version__}-{FORMAT_VERSION}.npz"


def simulated_presses(
    sensor: SimulatedSensor, count: int, *, progress: Progress = no_progress
) -> SimulatedPresses:
    """Presses of two balls all over the gel, simulated as the live page's objects."""
    rng = np.random.default_rng(SEED)
    return simulate_ball_presses(
        sensor, ball_diameters_mm=BALLS_MM, count=count, rng=rng, oversample=1, progress=progress
    )
