"""The zero and the leveling of depth: slopes leave a constant open, and drift adds a tilt."""

from __future__ import annotations

from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_mask
from gelform.foundations.filters import MEDIAN_SAMPLES, lattice_step, medians_where

Zero = Literal["mean", "border"]
Level = Literal["slope", "plane", "quadratic"]


def zero_region(zero: Zero | NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    """The pixels (H, W) bool that define where depth is 0.

    ValueError, TypeError: an unknown word, or a map that is not boolean of that shape.
    """
    if isinstance(zero, str):
        if zero not in ("mean", "border"):
            raise ValueError(f"Expected zero as 'mean', 'border' or a boolean (H, W), got {zero!r}.")
        region = np.ones(shape, dtype=bool)
        if zero == "border" and min(shape) > 2:
            region[1:-1, 1:-1] = False
        return region
    return check_mask(zero, shape=shape, name="zero")


def checked_level(level: Any) -> Level | None:
    """Return the kind of leveling, checked."""
    if level is not None and not (isinstance(level, str) and level in get_args(Level)):
        raise ValueError(f"Expected level as None, 'slope', 'plane' or 'quadratic', got {level!r:.60}.")
    return level  # type: ignore[return-value]


def zero_depth(
    depth: NDArray[np.float32],
    zero: str | NDArray[np.bool_],
    region: NDArray[np.bool_],
    inside: NDArray[np.bool_] | None = None,
) -> np.float32:
    """The depth that becomes 0 on one island: the median of its zero pixels, or its mean.

    It is the mean if `zero` is "mean" or the island has no zero pixel. `inside` is the island; None means the whole frame.
    """
    within = region if inside is None else region & inside
    if (isinstance(zero, str) and zero == "mean") or not within.any():
        return np.float32((depth if inside is None else depth[inside]).mean(dtype=np.float64))
    return np.float32(median_over(depth, within))


def median_over(maps: NDArray[np.float32], region: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Median (...) of maps (..., H, W) over a region; a large region is sampled on a lattice, which is exact enough."""
    if maps.ndim > 2:
        return np.stack([median_over(one, region) for one in maps])
    step = lattice_step(region.size)
    values = np.ascontiguousarray(maps, dtype=np.float32)[..., None]
    median, count = medians_where(values, region, step)
    if count < MEDIAN_SAMPLES / 20 and step > 1:
        median, _ = medians_where(values, region)
    return median.reshape(())


def fitted_surface(depth: NDArray[Any], region: NDArray[np.bool_], degree: int) -> NDArray[np.float32]:
    """Least-squares polynomial surface of the depth in the region, evaluated over the frame.

    ValueError: the region has fewer pixels than the surface has terms.
    """
    height, width = region.shape
    x = np.linspace(-1, 1, width)[None, :].repeat(height, 0)
    y = np.linspace(-1, 1, height)[:, None].repeat(width, 1)
    terms = np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)], axis=-1)
    if np.count_nonzero(region) < terms.shape[-1]:
        raise ValueError(
            f"Expected at least {terms.shape[-1]} zero pixels to fit a surface, got {region.sum()}."
        )
    rows = depth[..., region].reshape(-1, int(region.sum())).T.astype(np.float64)
    coefficients = np.linalg.lstsq(terms[region], rows, rcond=None)[0]
    return np.moveaxis(terms @ coefficients, -1, 0).reshape(depth.shape).astype(np.float32)
