"""The simulated sensor's calibration: made once by `calibrate` on simulated presses, then kept in the user's cache."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

from gelform import __version__
from gelform.calibration.fit import calibrate
from gelform.calibration.presses.press_set import Press, Presses
from gelform.calibration_file import FORMAT_VERSION, Calibration, load_calibration
from gelform.errors import CalibrationError
from gelform.frames import pixels_digest
from gelform.progress import Progress, no_progress
from gelform.simulate import SimulatedPresses, SimulatedSensor, simulate_ball_presses
from gelform.view import View

BALLS_MM, COUNT, SEED = (4.0, 6.0), 16, 11
COLOR_MODEL = "polynomial"  # half the time that choosing takes; 0.2 degrees worse than the best here


def ready_calibration(sensor: SimulatedSensor, *, progress: Progress = no_progress) -> Calibration:
    """The calibration of a simulated sensor, from the cache where it is there, else made (about ten seconds).

    Parameters
    ----------
    sensor : SimulatedSensor
    progress : called with (done, total, what) while it is made
    """
    kept = kept_path(sensor)
    if kept is not None and kept.is_file():
        try:
            return load_calibration(kept)
        except CalibrationError:
            kept.unlink(missing_ok=True)  # damaged: it is ours, and made again
    calibration = calibrate(_presses(sensor, progress), color_model=COLOR_MODEL, progress=progress)
    if kept is not None:
        calibration.save(kept, overwrite=True)
    return calibration


def kept_path(sensor: SimulatedSensor) -> Path | None:
    """Where the calibration of this sensor is kept; None where the user's cache cannot be written."""
    folder = cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError:
        return None
    if not os.access(folder, os.W_OK):
        return None
    height, width = sensor.shape
    return folder / f"{sensor.name}-{height}x{width}-{__version__}-{FORMAT_VERSION}.npz"


def cache_folder() -> Path:
    """The folder for files that can be made again: XDG_CACHE_HOME, or what the system has in its place."""
    if given := os.environ.get("XDG_CACHE_HOME"):
        return Path(given) / "gelform"
    home = Path.home()
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "gelform"
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", home / "AppData" / "Local")) / "gelform" / "cache"
    return home / ".cache" / "gelform"


def _presses(sensor: SimulatedSensor, progress: Progress) -> Presses:
    rng = np.random.default_rng(SEED)
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=BALLS_MM, count=COUNT, rng=rng, oversample=1, progress=progress
    )
    return presses_of(made)


def presses_of(made: SimulatedPresses) -> Presses:
    """Simulated presses as calibration takes them, without the detour over files."""
    return Presses(
        folder="simulated presses",
        presses=tuple(
            Press(f"press {k}", press.image, press.ball_diameter_mm, None, pixels_digest(press.image))
            for k, press in enumerate(made.presses)
        ),
        background=made.background.astype(np.float32),
        mm_per_px=made.sensor.mm_per_px,
        mm_per_px_sigma=None,
        sensor_name=made.sensor.name,
        serial=None,
        gel_id=None,
        view=View(),
    )
