"""Operations on batches of maps: block means, bilinear enlargement, medians over chosen pixels, depth from gradients."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional


def planes(values: NDArray[Any]) -> Tensor:
    """(C, H, W) float32 of (H, W, C)."""
    return torch.from_numpy(np.ascontiguousarray(np.moveaxis(values, -1, 0), dtype=np.float32))


def block_shares(size: int, blocks: int) -> Tensor:
    """The fraction of each pixel of a line in each block's mean, (blocks, size), as in OpenCV."""
    return _resized(size, blocks, cv2.INTER_AREA)


def bilinear_shares(few: int, size: int) -> Tensor:
    """The fraction of each sample of a coarser line in each pixel, (size, few), as in OpenCV."""
    return _resized(few, size, cv2.INTER_LINEAR)


def _resized(size: int, other: int, interpolation: int) -> Tensor:
    return torch.from_numpy(
        cv2.resize(np.eye(size, dtype=np.float32), (size, other), interpolation=interpolation)
    )


def medians_where(maps: Tensor, chosen: Tensor | None = None) -> Tensor:
    """Medians (N, C, 1, 1) of maps (N, C, h, w) over chosen pixels (N, 1, h, w), by default all; 0 if none is chosen."""
    if chosen is None:
        chosen = torch.ones_like(maps[:, :1], dtype=torch.bool)
    values = torch.where(chosen, maps, torch.inf).flatten(2).sort(dim=2).values
    count = chosen.flatten(1).sum(1).clamp(min=1)
    middle = torch.stack([(count - 1) // 2, count // 2], 1)[:, None].expand(-1, maps.shape[1], -1)
    median = values.gather(2, middle).mean(2)
    return torch.where(median.isfinite(), median, 0)[..., None, None]


class PoissonDepth(nn.Module):
    """Depth (N, H, W) of mean 0 from gradients (N, 2, H, W), as the solver `dct` of the numpy path.

    The slope of an edge is the mean of its two pixels' slopes. The cosine modes diagonalize the normal equations (B.
    L. Buzbee, G. H. Golub and C. W. Nielson, SIAM J. Numer. Anal. 7, 1970). Each transform is one FFT of the reordered
    rows (J. Makhoul, IEEE Trans. ASSP 28, 1980).

    Parameters
    ----------
    shape : (H, W)
    mm_per_px : (x, y), mm, or another unit, which depth then has
    """

    def __init__(self, shape: tuple[int, int], mm_per_px: tuple[float, float]) -> None:
        super().__init__()
        self.pitch = mm_per_px[1]
        self.along_x = mm_per_px[1] / mm_per_px[0]  # weight of edges along x; edges along y have weight 1
        eigen = [
            (2 * torch.sin(torch.pi * torch.arange(n, dtype=torch.float64) / (2 * n))) ** 2 for n in shape
        ]
        inverse = 1 / (eigen[0][:, None] + self.along_x**2 * eigen[1])
        inverse[0, 0] = 0
        self.register_buffer("inverse", inverse.float())

    def forward(self, gradients: Tensor) -> Tensor:
        """Depth in the unit of the pitch."""
        p, q = gradients.unbind(1)
        along_x = (p[:, :, 1:] + p[:, :, :-1]) * (self.along_x / 2)
        along_y = (q[:, 1:] + q[:, :-1]) / 2
        right = _minus_differences(along_x, 2) + _minus_differences(along_y, 1)
        spectrum = _cosines(_cosines(right).mT) * self.inverse.mT
        return self.pitch * _from_cosines(_from_cosines(spectrum).mT)


def _minus_differences(edges: Tensor, dim: int) -> Tensor:
    """Adjoint of the differences along a dimension."""
    sides = (0, 0) * (edges.ndim - 1 - dim)
    return functional.pad(edges, (*sides, 1, 0)) - functional.pad(edges, (*sides, 0, 1))


def _turns(count: int, like: Tensor) -> Tensor:
    angle = torch.arange(count, dtype=like.dtype, device=like.device) * (math.pi / (2 * count))
    return torch.polar(torch.ones_like(angle), -angle)


def _cosines(rows: Tensor) -> Tensor:
    """Cosine transform (type 2, orthonormal except for the scale of each mode) along the last dimension."""
    count = rows.shape[-1]
    reordered = torch.cat([rows[..., ::2], rows[..., 1::2].flip(-1)], -1)
    return (torch.fft.fft(reordered) * _turns(count, rows)).real


def _from_cosines(spectrum: Tensor) -> Tensor:
    """The inverse of `_cosines`."""
    count = spectrum.shape[-1]
    mirrored = torch.cat([torch.zeros_like(spectrum[..., :1]), spectrum[..., 1:].flip(-1)], -1)
    values = torch.fft.ifft(torch.complex(spectrum, -mirrored) * _turns(count, spectrum).conj()).real
    half = (count + 1) // 2
    rows = torch.empty_like(values)
    rows[..., ::2], rows[..., 1::2] = values[..., :half], values[..., half:].flip(-1)
    return rows
