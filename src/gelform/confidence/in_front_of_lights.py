"""Where something may stand in a light: blocks from which the surface rises towards it more steeply than its rays.

What a press shows is integrated, coarsely, and each block looks towards each light. A ball casts no shadow on itself, and
none falls on the side that faces a light: darkness there is no shadow, however little the slopes explain it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.solvers.dct import DctSolver

# Rise of the lowest rays, mm/mm: those of DIGITs rise by 0.33 to 0.45. What stands off its true height by a third, as it
# does while shadows are taken for slopes, still counts.
LOWEST_RAY = 0.23
UPPER = 0.65  # of the highest around: what is higher is the contact
REACH = (
    15  # of native/confidence/cast_shadows.c: blocks on each side that are around; rays are followed over 31
)
_behind_hills = Kernel(
    "behind_hills",
    "f32[rows,columns] depth, bool[rows,columns] asked, f32[rows,columns,lights,2] toward, out bool[rows,columns] behind, "
    "out f32[n] work, f32 rise, f32 upper",
)


class InFrontOfLights:
    """The rays of all lights at blocks of pixels; immutable, shared by threads.

    Parameters
    ----------
    toward : (rows, columns, lights, 2), unit vectors in the image towards each light, x and y
    block : (x, y), px of the image in a block
    """

    def __init__(self, toward: NDArray[np.float32], block: tuple[float, float]) -> None:
        self._shape = toward.shape[0], toward.shape[1]
        self._toward = np.ascontiguousarray(toward, dtype=np.float32)
        self._solver = DctSolver(self._shape, block)
        self._rise = LOWEST_RAY * float(np.mean(block))

    def __call__(self, slopes: NDArray[np.float32], asked: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
        """Those of some blocks (rows, columns) that some light's lowest rays do not reach; None where there are none.

        Parameters
        ----------
        slopes : (rows, columns, 2), mm/mm
        asked : (rows, columns), the blocks in question
        """
        if not asked.any():
            return None
        depth = self._solver(slopes).depth_mm
        rows, columns = self._shape
        behind = np.empty(self._shape, dtype=bool)
        work = np.empty((rows + 2 * REACH) * columns + columns + 2 * REACH, dtype=np.float32)
        found = _behind_hills(depth, asked, self._toward, behind, work, self._rise, UPPER)
        return behind if found else None
