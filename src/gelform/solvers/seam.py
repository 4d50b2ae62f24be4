"""The seam that every solver fits: prepared once for a shape and a pitch, called with each frame."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Pair = tuple[NDArray[Any], NDArray[Any]]  # of maps of the edges along x, (H, W-1), and along y, (H-1, W)
Weights = NDArray[Any] | Pair | None


class Solution(NamedTuple):
    """What a solver returns for one frame.

    Attributes
    ----------
    depth_mm : (H, W) float32; each island up to a constant, 0 outside the mask
    known : (H, W) bool; False outside the mask and where no slope and no anchor says anything
    iterations : int
        0 for a direct method.
    tolerance : float
        Estimated largest error relative to the range of depth; 0 for a direct method.
    """

    depth_mm: NDArray[np.float32]
    known: NDArray[np.bool_]
    iterations: int = 0
    tolerance: float = 0.0


class Solver(Protocol):
    """A method, prepared for frames of one shape; safe to share between threads.

    Attributes
    ----------
    takes_weights : whether weights, mask and anchor mean something to it; one that treats all slopes alike
        refuses them with a ValueError
    """

    takes_weights: ClassVar[bool]

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        """Everything that depends on the shape (H, W) and the pitch (x, y), mm, alone."""
        ...

    def __call__(
        self,
        gradients: NDArray[Any],
        weights: Weights = None,
        mask: NDArray[np.bool_] | None = None,
        anchor: NDArray[Any] | None = None,
    ) -> Solution:
        """Depth of one frame of slopes (H, W, 2); weights (H, W) or per edge ((H, W-1), (H-1, W))."""
        ...
