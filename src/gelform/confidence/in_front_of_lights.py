"""Where something may stand in a light: pixels from which the surface rises towards it more steeply than its rays.

What a press shows is integrated, coarsely, and each pixel looks towards each light. A ball casts no shadow on itself, and
none falls on the side that faces a light: darkness there is no shadow, however little the slopes explain it.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.solvers.dct import DctSolver

# Rise of the lowest rays, mm/mm: those of DIGITs rise by 0.33 to 0.45. What stands off its true height by a third, as it
# does while shadows are taken for slopes, still counts.
LOWEST_RAY = 0.23
DOUBLINGS = 5  # rays are followed over 31 coarse pixels
UPPER, AROUND = 0.65, 31  # of the highest within so many coarse pixels across: what is higher is the contact


class InFrontOfLights:
    """The rays of all lights at coarse pixels; immutable, shared by threads.

    Parameters
    ----------
    toward : (rows, columns, lights, 2), unit vectors in the image towards each light, x and y
    shape : (H, W) of the image
    """

    def __init__(self, toward: NDArray[np.float32], shape: tuple[int, int]) -> None:
        rows, columns = toward.shape[:2]
        pitch = shape[1] / columns, shape[0] / rows  # px of the image in a coarse one
        self._solver = DctSolver((rows, columns), pitch)
        self._pitch = float(np.mean(pitch))
        y, x = np.mgrid[:rows, :columns].astype(np.float32)
        # The ray's next 1, 2, 4 ... coarse pixels: the largest of all that lie within twice as many is that of the largest
        # from here and of that from there.
        self._steps = [
            [
                (x + np.float32(2**k) * light[..., 0], y + np.float32(2**k) * light[..., 1])
                for k in range(DOUBLINGS)
            ]
            for light in np.moveaxis(toward, 2, 0)
        ]

    def __call__(self, slopes: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Pixels (rows, columns) that some light's lowest rays do not reach, by slopes (rows, columns, 2)."""
        depth = np.ascontiguousarray(self._solver(slopes).depth_mm, dtype=np.float32)
        hidden = np.zeros(depth.shape, dtype=bool)
        for steps in self._steps:
            highest = depth
            for k, (x, y) in enumerate(steps):
                further = cv2.remap(highest, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
                highest = np.maximum(highest, further - np.float32(LOWEST_RAY * self._pitch * 2**k))
            hidden |= highest > depth
        depth = depth - np.float32(np.median(depth))
        top = cv2.dilate(depth, np.ones((AROUND, AROUND), np.uint8))
        hidden &= depth < UPPER * top
        return hidden
