"""Checks of the arguments of solvers, made once on entry to `depth` and `depth_sigma`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.depth.solvers import SOLVERS
from gelform.depth.solvers.seam import Weights
from gelform.foundations.checks import as_array, check_choice, check_map


def checked_solver(solver: str) -> str:
    """The solver's name, if it is "auto" or in `SOLVERS`; else ValueError."""
    return check_choice(solver, ("auto", *SOLVERS), "a solver")


def takes_weights(solver: str) -> bool:
    """Whether a solver takes weights, mask and anchor; "auto" does."""
    return checked_solver(solver) == "auto" or SOLVERS[solver].takes_weights


def check_weights(weights: Any, shape: tuple[int, ...]) -> Weights:
    """Weights in the form that solvers take, for slopes of shape (H, W), or (..., H, W) for a stack.

    ValueError, TypeError: another shape, or a value that is negative or not finite.
    """
    height, width = shape[-2:]
    if (
        isinstance(weights, (tuple, list))
        and len(weights) == 2
        and np.ndim(weights[0]) == np.ndim(weights[1]) == 2
    ):
        wx, wy = (np.asarray(w) for w in weights)
        if wx.shape != (height, width - 1) or wy.shape != (height - 1, width):
            raise ValueError(
                f"Expected weights per edge of shapes ({height}, {width - 1}) and ({height - 1}, {width}), "
                f"got {wx.shape} and {wy.shape}. For weights per pixel give one map ({height}, {width})."
            )
        return tuple(  # type: ignore[return-value]
            check_map(w, "weights", nonnegative=True) if w.size else w.astype(np.float32) for w in (wx, wy)
        )
    array = check_map(weights, "weights", shape=(height, width), nonnegative=True)
    if array.ndim > 2 and array.shape != shape:
        raise ValueError(f"Expected weights of shape {shape[-2:]} or {shape}, got {array.shape}.")
    return array


def check_anchor(anchor: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float32]:
    """An anchor map (H, W) from a map or a number."""
    array = as_array(anchor, "anchor")
    array = check_map(
        np.full(shape, array) if array.ndim == 0 else array, "anchor", shape=shape, nonnegative=True
    )
    if array.ndim != 2:
        raise ValueError(f"Expected anchor as a number or of shape {shape}, got {array.shape}.")
    return array
