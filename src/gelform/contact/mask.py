"""depth -> contact: where something touches the gel, from the depth alone."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import LARGEST, check_map, check_mm_per_px, check_number, check_positive
from gelform.medians import medians_where

NOISE_SAMPLES = 5_000


def contact_from_depth(
    depth_mm: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    min_depth_mm: float = 0.02,
    noise_factor: float = 4.0,
    rim_fraction: float = 0.3,
    min_area_mm2: float = 0.1,
) -> NDArray[np.bool_]:
    """Where the gel is pressed in by more than its noise, in patches that are not specks.

    A patch is a connected region deeper than `min_depth_mm` and `noise_factor` standard deviations of the
    untouched gel; of each, the part deeper than `rim_fraction` of its own deepest point is contact. The last
    cuts away the gel that is drawn down beside an object: at the rim of a pressed ball it is still 0.3-0.6 of
    the peak deep (1/2 on an elastic half-space: Hertz 1882; Johnson, Contact Mechanics, 1985, section 4.2).
    Depth alone cannot say exactly where gel and object part: the contact radius of a ball comes out at 1.0 to
    1.4 times the true one on simulated gels, at 0.84 times on a cap without any gel drawn down.

    Parameters
    ----------
    depth_mm : (H, W), mm, 0 at rest, positive where pressed
    mm_per_px : float or (x, y), mm
    min_depth_mm : the least depth that counts, whatever the noise, mm
    noise_factor : how many standard deviations of the untouched gel count; these are taken from the pixels
        below zero, which no contact makes
    rim_fraction : 0-1, of each patch's deepest point
    min_area_mm2 : smaller patches are specks, mm^2

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
    for name, value in (
        ("rim_fraction", rim_fraction),
        ("noise_factor", noise_factor),
        ("min_area_mm2", min_area_mm2),
    ):
        check_number(value, name)
    if not (0 <= rim_fraction < 1 and noise_factor >= 0 and min_area_mm2 >= 0):
        raise ValueError(
            f"Expected rim_fraction of 0 to below 1, noise_factor >= 0 and min_area_mm2 >= 0, got {rim_fraction}, "
            f"{noise_factor} and {min_area_mm2}."
        )
    pitch_x, pitch_y = check_mm_per_px(mm_per_px)
    threshold = max(
        min(check_positive(min_depth_mm, "min_depth_mm"), LARGEST), noise_factor * _noise_mm(depth)
    )
    return _patches(depth, threshold, rim_fraction, min_area_mm2 / (pitch_x * pitch_y))


def _noise_mm(depth: NDArray[Any]) -> float:
    """Standard deviation of the untouched gel: the median of its negative depths, as of half a Gaussian."""
    values = depth.reshape(-1, 1, 1)
    (median,), _ = medians_where(values, values[..., 0] < 0, max(1, depth.size // NOISE_SAMPLES))
    return -1.4826 * float(median)


def _patches(depth: NDArray[Any], threshold: float, rim_fraction: float, min_px: float) -> NDArray[np.bool_]:
    contact = np.zeros(depth.shape, dtype=bool)
    deep = (depth > threshold).view(np.uint8)
    left, top, width, height = cv2.boundingRect(deep)
    if width == 0:
        return contact
    whole = (
        slice(top, top + height),
        slice(left, left + width),
    )  # labels are looked for where there is anything
    found = contact[whole]
    depth = depth[whole]
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(deep[whole], connectivity=8)
    for label in range(1, count):
        left, top, width, height, area = boxes[label]
        if area >= min_px:
            box = slice(top, top + height), slice(left, left + width)
            patch = np.where(labels[box] == label, depth[box], 0)
            found[box] |= patch > max(threshold, rim_fraction * float(patch.max()))
    return contact
