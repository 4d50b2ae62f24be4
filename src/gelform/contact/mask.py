"""depth -> contact: where something touches the gel, from how the surface bends and how deep it is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_map, check_mm_per_px, check_number
from gelform.medians import medians_where

SMOOTHINGS_PX = (
    0.7,
    1.5,
    2.5,
)  # standard deviation of a Gaussian, before the surface's bending is taken: the first ...
QUIET = 0.06  # ... that leaves no more noise than this, 1/mm
NOISE_SAMPLES = 10_000
SHARE_AT_REST = 0.3  # of the frame that is taken to be untouched at least
SIGMA_OF_SHARE = (
    2.595  # standard deviation of a normal distribution over the magnitude that 30 % of it are below
)
SIGMAS_OF_DEPTH = 2.0  # that depth has to exceed its own standard deviation by, to say anything
STIFFEST = 25.0  # 1/mm^2: no gel relaxes within less than 0.2 mm
LEAST_FALLING = 50  # pixels beside a contact, from which the gel's relaxation is told
SEED = 1.7  # times the noise factor, where contacts start
LEAST_SEEDS = 4  # pixels
NEIGHBOURHOOD_PX = 4  # in which the rim is half as high as what is around it
LEAST_OF_BED = 0.35  # times z/L^2: L is not known exactly, nor the same everywhere
FLAT, OF_FLAT = (
    0.4,
    0.75,
)  # where the bed's share is so much of the pressure around, so much of it is a contact too
LEAST_PRESSURE = 0.02  # 1/mm
HALF = 0.65  # nearly: the smooth rim of a contact is blurred outwards more than inwards


def contact_from_depth(
    depth_mm: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    depth_sigma_mm: ArrayLike | None = None,
    noise_factor: float = 4.5,
    min_area_mm2: float = 0.05,
) -> NDArray[np.bool_]:
    """Where something holds the gel's surface up.

    Beside an object the surface is held by the gel alone: a membrane under tension on an elastic bed, whose depth z
    falls off as `laplace(z) = z/L^2` (Kerr, J. Appl. Mech. 31, 1964). So the pressure on it in units of its tension,
    `p = z/L^2 - laplace(z)`, is 0 there and positive in the contact, on a ball as on a flat face. L is read from the
    frame itself, where the surface falls off. A contact starts where p exceeds 1.7 times `noise_factor` of its noise,
    goes on where it exceeds `noise_factor` of it and a third of z/L^2, and ends where it is about half of what it is
    around: gel that is drawn down beside an object is no contact, and hollow contacts stay hollow.

    Parameters
    ----------
    depth_mm : (H, W), mm, 0 at rest, positive where pressed
    mm_per_px : float or (x, y), mm
    depth_sigma_mm : (H, W), mm, standard deviation of the depth; the depth counts by what it has beyond twice that.
        Without it: that of the depths below 0, which no contact makes
    noise_factor : how many standard deviations of the frame's noise count
    min_area_mm2 : smaller regions are specks, mm^2

    Returns
    -------
    contact : (H, W) bool

    Raises
    ------
    ValueError, TypeError
        Wrong shape, NaN, or a setting outside its range.
    """
    depth = check_map(depth_mm, "depth_mm")
    if depth.ndim != 2:
        raise ValueError(f"Expected depth_mm of one frame, (H, W), got {depth.shape}.")
    for name, value in (("noise_factor", noise_factor), ("min_area_mm2", min_area_mm2)):
        check_number(value, name)
    if not (noise_factor > 0 and min_area_mm2 >= 0):
        raise ValueError(
            f"Expected noise_factor > 0 and min_area_mm2 >= 0, got {noise_factor} and {min_area_mm2}."
        )
    pitch = check_mm_per_px(mm_per_px)
    if depth_sigma_mm is None:
        sigma: Any = np.float32(_noise_mm(depth))
    else:
        sigma = check_map(depth_sigma_mm, "depth_sigma_mm", shape=depth.shape, nonnegative=True)
    pressure, bed = _pressure(depth, sigma, pitch)
    limit = max(noise_factor * _noise(pressure), LEAST_PRESSURE)
    return _regions(pressure, limit, bed, min_area_mm2 / (pitch[0] * pitch[1]))


def _pressure(
    depth: NDArray[Any], sigma: Any, pitch: tuple[float, float]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Pressure (H, W) over the surface's tension, 1/mm, and the bed's share z/L^2 of what depth is known to be there."""
    for smoothing in SMOOTHINGS_PX:
        smooth = cv2.GaussianBlur(depth, (0, 0), smoothing, borderType=cv2.BORDER_REPLICATE).reshape(
            depth.shape
        )
        bent = _bent(smooth, pitch, int(np.ceil(2 * smoothing)))
        if (noise := _noise(bent)) <= QUIET:
            break
    bed = np.maximum(smooth - np.float32(SIGMAS_OF_DEPTH) * sigma, 0, out=smooth)
    falling = (bent < np.float32(-4 * noise)) & (bed > 0)
    stiffness = 0.0
    if np.count_nonzero(falling) >= LEAST_FALLING:
        ratios = -bent[falling] / bed[falling]
        stiffness = min(float(medians_where(ratios.reshape(-1, 1, 1))[0][0]), STIFFEST)
    bed *= np.float32(stiffness)
    bent += bed
    return bent, bed


def _bent(depth: NDArray[Any], pitch: tuple[float, float], margin: int) -> NDArray[np.float32]:
    """Minus the Laplacian (H, W) of a depth, 1/mm; within a margin of the borders that of the next pixels inside."""
    x, y = 1 / pitch[0] ** 2, 1 / pitch[1] ** 2
    kernel = np.array([[0, -y, 0], [-x, 2 * (x + y), -x], [0, -y, 0]], dtype=np.float32)
    bent: NDArray[np.float32] = cv2.filter2D(depth, cv2.CV_32F, kernel).reshape(depth.shape)
    if min(bent.shape) > 2 * margin:
        for side in (bent, bent.T):
            side[:margin], side[-margin:] = side[margin], side[-margin - 1]
    return bent


def _noise(values: NDArray[np.float32]) -> float:
    """Standard deviation of a map (H, W) where nothing is: of the share of it that is smallest."""
    sample = np.abs(values.ravel()[:: max(1, values.size // NOISE_SAMPLES)])
    place = int(SHARE_AT_REST * (sample.size - 1))
    return SIGMA_OF_SHARE * float(np.partition(sample, place)[place])


def _noise_mm(depth: NDArray[Any]) -> float:
    """Standard deviation of the untouched gel: the median of its negative depths, as of half a Gaussian."""
    sample = depth.ravel()[:: max(1, depth.size // NOISE_SAMPLES)]
    below = sample[sample < 0]
    return -1.4826 * float(np.median(below)) if below.size else 0.0


def _regions(
    pressure: NDArray[np.float32], limit: float, bed: NDArray[np.float32], min_px: float
) -> NDArray[np.bool_]:
    """Where the pressure (H, W) is above the limit and half of what it is around, in regions that start for sure."""
    above = pressure > np.maximum(np.float32(limit), np.float32(LEAST_OF_BED) * bed)
    size = (2 * NEIGHBOURHOOD_PX + 1,) * 2
    sums = {"normalize": False, "borderType": cv2.BORDER_CONSTANT}
    there = cv2.boxFilter(above.view(np.uint8), cv2.CV_32F, size, **sums)
    around = cv2.boxFilter(np.where(above, pressure, 0), cv2.CV_32F, size, **sums)
    around /= np.maximum(there, 1)
    flat = above & (pressure > np.float32(OF_FLAT) * bed) & (bed > np.float32(FLAT) * around)
    above &= pressure > np.float32(HALF) * around
    above |= cv2.erode(flat.view(np.uint8), np.ones((5, 5), np.uint8)).view(np.bool_)
    count, labels = cv2.connectedComponents(above.view(np.uint8), connectivity=8)
    inside = labels[above]  # few pixels of the frame: all that follows looks at these alone
    areas = np.bincount(inside, minlength=count)
    seeds = np.bincount(inside[pressure[above] > np.float32(SEED * limit)], minlength=count)
    above[above] = ((areas >= min_px) & (seeds >= min(LEAST_SEEDS, max(min_px, 1))))[inside]
    return above
