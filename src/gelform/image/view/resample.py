"""Resampling of an image in one pass: averages over boxes of whole pixels, then one bilinear remap.

Pixel centers are at integers, so a pixel covers half a pixel on each side of its number, and resizing maps *areas*.
If an image is reduced strongly, whole pixels are averaged first, which avoids aliasing.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray


def box_centers(
    start: float, length: float, available: int, count: int, flipped: bool
) -> tuple[NDArray[Any], slice, int]:
    """Positions of image pixels along one axis of a frame, in boxes of whole frame pixels.

    The axis has `count` image pixels, which show a part of a frame of `available` px. If it is flipped, the first of them is
    at the end of the part. Returns their centers in boxes, the part of the frame to cut out, and the number of frame pixels
    in a box, which is the integer part of the reduction.
    """
    scale = length / count
    box = max(1, int(scale + 0.5))
    first = min(int(start), available - 1)
    last = min(available, int(np.ceil(start + length)))
    centers = (np.arange(count) + 0.5) * scale + start
    if flipped:
        centers = centers[::-1]
    return (centers - first) / box - 0.5, slice(first, last), box


def averaged(pixels: NDArray[Any], box: tuple[int, int]) -> NDArray[Any]:
    """Mean of pixels (H, W, 3) over boxes (height, width); the last box repeats the border beyond the frame."""
    if box == (1, 1):
        return pixels
    boxes = [-(-pixels.shape[axis] // box[axis]) for axis in (0, 1)]
    missing = [boxes[axis] * box[axis] - pixels.shape[axis] for axis in (0, 1)]
    if any(missing):
        pixels = cv2.copyMakeBorder(pixels, 0, missing[0], 0, missing[1], cv2.BORDER_REPLICATE)
    averaged: NDArray[Any] = cv2.resize(pixels, (boxes[1], boxes[0]), interpolation=cv2.INTER_AREA)
    return averaged


def pixel_maps(x: NDArray[Any], y: NDArray[Any]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Maps (h, w) of each pixel's position in the source.

    All rows of the maps have the columns x (w,), and all columns the rows y (h,).
    """
    map_x, map_y = np.meshgrid(x.astype(np.float32), y.astype(np.float32))
    return _read_only(map_x), _read_only(map_y)


def pixel_positions(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Positions (H*W, 2), x and y, of the pixels of an image (H, W), row by row."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.stack([x.ravel(), y.ravel()], axis=1)


def maps_of_positions(
    positions_px: NDArray[Any], shape: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Maps (H, W) of positions (H*W, 2), x and y, in the source, as `remapped` takes them."""
    map_x, map_y = (positions_px[:, k].reshape(shape).astype(np.float32) for k in (0, 1))
    return _read_only(map_x), _read_only(map_y)


def _read_only(values: NDArray[Any]) -> NDArray[Any]:
    """The same array, read-only, because threads share prepared maps."""
    values.setflags(write=False)
    return values


def remapped(pixels: NDArray[Any], map_x: NDArray[Any], map_y: NDArray[Any]) -> NDArray[Any]:
    """Bilinear values at maps (h, w) of source columns and rows; the border is repeated beyond it."""
    found: NDArray[Any] = cv2.remap(pixels, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return found
