"""Small sensors to simulate, grids for a gel's surface and for faces, and a box as a mesh."""

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
AXIS = np.linspace(-4, 4, 161)  # mm, to look at faces on
X, Y = AXIS[None, :], AXIS[:, None]


def grid(half_mm, pitch):
    """Coordinates (1, n) and (n, 1) of a square grid about 0, mm."""
    n = 2 * round(half_mm / pitch) + 1
    axis = (np.arange(n) - n // 2) * pitch
    return axis[None, :], axis[:, None]


def box(width, height, depth):
    """Vertices (8, 3) and triangles (12, 3) of a closed box."""
    corners = np.array([(x, y, z) for x in (0, width) for y in (0, height) for z in (0, depth)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
