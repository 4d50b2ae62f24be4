"""What several of the modules do with maps: means of blocks, bilinear enlargement, medians over chosen pixels."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor


def planes(values: NDArray[Any]) -> Tensor:
    """(C, H, W) float32 of (H, W, C)."""
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(values, -1, 0), dtype=np.float32))


def block_shares(size: int, blocks: int) -> Tensor:
    """Which share of each pixel of a line goes into each block's mean, (blocks, size), as OpenCV has them."""
    return _resized(size, blocks, cv2.INTER_AREA)


def bilinear_shares(few: int, size: int) -> Tensor:
    """Which share of each sample of a coarser line goes into each pixel, (size, few), as OpenCV has them."""
    return _resized(few, size, cv2.INTER_LINEAR)


def _resized(size: int, other: int, interpolation: int) -> Tensor:
    return torch.from_numpy(
        cv2.resize(np.eye(size, dtype=np.float32), (size, other), interpolation=interpolation)
    )


def medians_where(maps: Tensor, chosen: Tensor | None = None) -> Tensor:
    """Medians (N, C, 1, 1) of maps (N, C, h, w) over chosen pixels (N, 1, h, w), by default all; 0 where none is."""
    if chosen is None:
        chosen = torch.ones_like(maps[:, :1], dtype=torch.bool)
    values = torch.where(chosen, maps, torch.inf).flatten(2).sort(dim=2).values
    count = chosen.flatten(1).sum(1).clamp(min=1)
    middle = torch.stack([(count - 1) // 2, count // 2], 1)[:, None].expand(-1, maps.shape[1], -1)
    median = values.gather(2, middle).mean(2)
    return torch.where(median.isfinite(), median, 0)[..., None, None]
