"""A grid to look at faces on, and a box as a mesh."""

import numpy as np

AXIS = np.linspace(-4, 4, 161)
X, Y = AXIS[None, :], AXIS[:, None]


def box(width, height, depth):
    """Vertices (8, 3) and triangles (12, 3) of a closed box."""
    corners = np.array([(x, y, z) for x in (0, width) for y in (0, height) for z in (0, depth)], dtype=float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
