"""What `DepthSigma` is given, checked once at its door."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import as_array, check_map, check_within

MOST_PX, MOST_PROBES = 20_000, 10_000


def checked_sigma(gradients_sigma: ArrayLike, shape: tuple[int, int] | None = None) -> NDArray[np.float32]:
    """Standard deviations (H, W, 1 or 2)."""
    sigma = as_array(gradients_sigma, "gradients_sigma")
    size = sigma.shape[:2]
    alike = shape is not None and sigma.shape == tuple(shape)
    if not alike and (sigma.ndim != 3 or sigma.shape[2] != 2 or shape not in (None, size)):
        wanted = "(H, W, 2)" if shape is None else f"({shape[0]}, {shape[1]}, 2)"
        raise ValueError(f"Expected gradients_sigma of shape {wanted}, got {sigma.shape}.")
    if sigma.size == 0:
        raise ValueError(f"Expected gradients_sigma of some pixels, got none: shape {sigma.shape}.")
    if sigma.ndim == 3 and sigma.strides[2] == 0:
        sigma = sigma[..., 0]  # one map, broadcast to both slopes
    flat = check_map(sigma.reshape(size[0], -1), "gradients_sigma", nonnegative=True)
    if flat.min() == 0:
        raise ValueError("Expected gradients_sigma > 0, got 0: no slope is known exactly.")
    return flat.reshape(*size, -1)


def checked_weights(weights: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float32]:
    array = check_map(weights, "weights", shape=shape, nonnegative=True)
    if array.ndim != 2:
        raise ValueError(f"Expected weights of shape ({shape[0]}, {shape[1]}), got {array.shape}.")
    return array


def checked_probes(probes: int) -> int:
    """Return a number of random draws that tell a deviation."""
    return int(check_within(probes, "probes", 2, MOST_PROBES))


def checked_share(correlation_px: float, correlated_share: float) -> float:
    check_within(correlation_px, "correlation_px", 0, MOST_PX)
    check_within(correlated_share, "correlated_share", 0, 1)
    return correlated_share if correlation_px > 0 else 0.0


def checked_rest(rest: ArrayLike | None, shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Return pixels (H, W) where nothing touches, which may be none, as bool."""
    if rest is None:
        return None
    array = as_array(rest, "rest")
    if array.dtype != np.bool_ or array.shape != shape:
        raise ValueError(f"Expected rest as bool of shape {shape}, got {array.dtype} of {array.shape}.")
    return np.ascontiguousarray(array)
