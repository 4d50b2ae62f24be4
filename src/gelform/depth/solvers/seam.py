"""Solver: the protocol of all solvers. One is prepared for a shape and a pitch, and called with each frame."""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

Pair = tuple[NDArray[Any], NDArray[Any]]  # maps of the edges along x, (H, W-1), and along y, (H-1, W)
Weights = NDArray[Any] | Pair | None


class Solution(NamedTuple):
    """The answer of a solver for one frame.

    Attributes
    ----------
    depth_mm : (H, W) float32; each island up to a constant; 0 outside the mask
    known : (H, W) bool; False outside the mask and where neither a slope nor an anchor counts
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
    """A method, prepared for frames of one shape; threads can share it.

    Attributes
    ----------
    takes_weights : whether it uses weights, mask and anchor; a solver that treats all slopes alike
        refuses them with a ValueError
    """

    takes_weights: ClassVar[bool]

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        """Prepare everything that depends only on the shape (H, W) and the pitch (x, y), mm."""
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
