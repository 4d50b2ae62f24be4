"""Patches of outliers that agree among themselves: regions bounded by jumps of slope that no surface can have.

Within such a patch the slopes are those of a surface, and only its rim shows in the curl. So the frame is cut
into regions where neighbouring slopes jump, and every region is judged by its rim. At the rim of a contact the
slope jumps across the rim only, as a surface allows: sampled on pixels, its circulation has both signs and
cancels in the sum over a few loops. At the rim of an outlier patch the slope along the rim jumps as well, which
does not cancel. The circulation of single outliers cancels too; those are found pixel by pixel.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

# Slopes jump where neighbours differ by more than so many times the usual circulation (1 % of pairs do under
# noise alone), and by more than surfaces without noise bend from pixel to pixel.
JUMP = 3.0
LEAST_JUMP = 0.1
# Where more of the jump than this is along the rim (in squares), no surface has it.
SHARE = 0.1
# A region is an outlier if so much of its rim says so. Contacts reach 0 to 0.3, more where patches touch their
# rim; outlier patches 0.3 to 0.7. A small region needs less: little is lost if it was right.
RIM = 0.36
SMALL_RIM = 0.2
SMALL = 0.005
# What a contact's rim, of so many loops at least, shows at single ones: so much of the jump's square.
CONTACT = 12
KINK = 0.2


class Patches(NamedTuple):
    """What the rims say.

    Attributes
    ----------
    outlier : (H, W) bool
        Pixels of outlier regions.
    explained : (H-1, W-1) float32
        Squares of circulation that the rims of contacts explain.
    """

    outlier: NDArray[np.bool_]
    explained: NDArray[np.float32]


def patches_from_jumps(
    circulation: NDArray[np.float32],
    jumps: tuple[NDArray[np.float32], NDArray[np.float32]],
    usual: float,
) -> Patches | None:
    """Judge the regions of a frame; None where nothing jumps.

    Parameters
    ----------
    circulation : (H-1, W-1)
        Sum of the edge slopes around each loop of four pixels.
    jumps : (H, W-1) and (H-1, W)
        Squares of the differences of slope between neighbours.
    usual : float
        Standard deviation of circulation that noise makes.
    """
    across, down = jumps
    limit = np.float32(max(JUMP * usual, LEAST_JUMP) ** 2)
    jumps_across, jumps_down = across > limit, down > limit
    if not (jumps_across.any() or jumps_down.any()):
        return None
    regions, areas = _regions(jumps_across, jumps_down)
    near, far = _regions_around_loops(regions)
    jumping = jumps_across[1:] | jumps_across[:-1] | jumps_down[:, 1:] | jumps_down[:, :-1]
    rim = np.flatnonzero(jumping & (far < near))
    square = 0.5 * (across[1:] + across[:-1] + down[:, 1:] + down[:, :-1])
    along, whole = _sum_around(circulation), _sum_around(np.sqrt(square) * jumping)
    along_rim = along.ravel()[rim] ** 2 > SHARE * whole.ravel()[rim] ** 2
    owner = near.ravel()[rim]
    count = np.bincount(owner, minlength=areas.size)
    needed = np.where(areas < SMALL * regions.size, SMALL_RIM, RIM)
    outlier = np.bincount(owner, along_rim, minlength=areas.size) > needed * count
    contact = rim[count[owner] >= CONTACT]
    explained = np.zeros(circulation.shape, dtype=np.float32)
    explained.ravel()[contact] = KINK * square.ravel()[contact]
    grown = cv2.dilate(outlier[regions].astype(np.uint8), np.ones((3, 3), np.uint8))
    return Patches(grown.astype(bool), explained)


def _regions(
    jumps_across: NDArray[np.bool_], jumps_down: NDArray[np.bool_]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Numbers (H, W) of connected pixels off all jumps, from 1 for the largest down; areas by number.

    0 where a jump is: both pixels of it.
    """
    smooth = np.ones((jumps_across.shape[0], jumps_down.shape[1]), dtype=np.uint8)
    smooth[:, 1:] &= ~jumps_across
    smooth[:, :-1] &= ~jumps_across
    smooth[1:] &= ~jumps_down
    smooth[:-1] &= ~jumps_down
    count, labels = cv2.connectedComponents(smooth, connectivity=4)
    areas = np.bincount(labels.ravel(), minlength=count)
    order = np.concatenate([[0], 1 + np.argsort(-areas[1:], kind="stable")])
    number = np.empty(count, dtype=np.int32)
    number[order] = np.arange(count)
    return number[labels], areas[order]


def _regions_around_loops(regions: NDArray[np.int32]) -> tuple[NDArray[Any], NDArray[Any]]:
    """The smallest and the largest region among the 4x4 pixels around each loop: (H-1, W-1) numbers."""
    window = np.ones((4, 4), dtype=np.uint8)
    numbers = regions.astype(np.float32)  # exact: fewer than 2^24
    near = cv2.dilate(numbers, window, anchor=(1, 1))[:-1, :-1]
    numbers[regions == 0] = regions.size
    return near.astype(np.int32), cv2.erode(numbers, window, anchor=(1, 1))[:-1, :-1]


def _sum_around(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum over 3x3 loops."""
    total = cv2.boxFilter(values, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(total, dtype=np.float32)
