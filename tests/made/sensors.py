"""Small sensors to simulate, and a grid for a gel's surface."""

from dataclasses import replace

import numpy as np

from gelform.simulate import LAYOUTS, Coating, Gel, Led, SimulatedSensor

PLAIN = SimulatedSensor(
    (Led((-9, 2, 8), (9000, 500, 0)), Led((5, 9, 8), (0, 9000, 8000))), shape=(60, 80), mm_per_px=0.1
)
SMALL = replace(LAYOUTS["three-edges"], shape=(48, 64), mm_per_px=0.3)
DRAGGED = SimulatedSensor(
    (Led((-6, 2, 7), (4000, 500, 0)), Led((5, 5, 7), (0, 5000, 900))),
    shape=(60, 80),
    mm_per_px=0.1,
    gel=Gel(thickness_mm=2.0, bulge=0.6, friction=0.5),
    coating=Coating(marker_pitch_mm=1.0, marker_radius_mm=0.2),
)
LENGTH = 0.5  # mm over which the gel relaxes


def grid(half_mm, pitch):
    """Coordinates (1, n) and (n, 1) of a square grid about 0, mm."""
    n = 2 * round(half_mm / pitch) + 1
    axis = (np.arange(n) - n // 2) * pitch
    return axis[None, :], axis[:, None]
