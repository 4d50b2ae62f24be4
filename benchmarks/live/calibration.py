"""The shipped calibration of `gelform live`'s simulated sensor: src/gelform/calibration/library/three-edges.npz.

It is made from presses of a ball, as any calibration, and shipped so that the first picture needs no wait. Its background is
the sensor's without noise: whole gray levels, which compress to a few kilobytes.
"""

from __future__ import annotations

import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from gelform.calibration.fit import calibrate
from gelform.calibration.library import SHIPPED, simulated_presses
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.calibration_file import load_calibration
from gelform.image.background import noise_from_image
from gelform.sensors.simulated import simulated_sensor_named
from gelform.sensors.source import DEFAULT_SENSOR
from gelform.simulate import simulate_background

PRESSES = 24


def make_calibration() -> None:
    """Calibrate, save, compress."""
    sensor = simulated_sensor_named(DEFAULT_SENSOR)
    presses = presses_from_simulated(simulated_presses(sensor, PRESSES))
    presses = replace(
        presses,
        background_noise=noise_from_image(presses.background),
        background=np.asarray(simulate_background(sensor, None), dtype=np.float32),
    )
    calibration = calibrate(presses)
    path = Path(__file__).parents[2] / "src" / "gelform" / "calibration" / "library" / SHIPPED
    calibration.save(path, overwrite=True)
    _pack(path)
    print(load_calibration(path).held_out, f"{path.stat().st_size / 1e3:.0f} kB")


def _pack(path: Path) -> None:
    """Write the file's members again, deflated; the digest covers their contents."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
