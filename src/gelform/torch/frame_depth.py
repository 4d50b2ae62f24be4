"""gradients -> the frame's depth, for the forward response: `FrameDepth` of numpy, a batch at a time."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from gelform.color_models.frame_depth import LEAST_UNTOUCHED, coarse_grid
from gelform.torch.maps import bilinear_shares, block_shares, medians_where
from gelform.torch.poisson import PoissonDepth


class FrameDepth(nn.Module):
    """Least-squares depth of frames on a grid that is four times coarser, 0 in the median of untouched gel.

    Parameters
    ----------
    shape : (H, W)
    untouched : color changes up to it say untouched gel, where depth is 0
    """

    def __init__(self, shape: tuple[int, int], untouched: float) -> None:
        super().__init__()
        self.square = untouched**2
        grid, pitch_px = coarse_grid(shape)
        for name, size, few in zip(("rows", "columns"), shape, grid):
            self.register_buffer(f"{name}_coarse", block_shares(size, few))
            self.register_buffer(f"{name}_full", bilinear_shares(few, size))
        self.solver = PoissonDepth(grid, pitch_px)

    def forward(self, gradients: Tensor, rest: Tensor) -> Tensor:
        """Depth (N, 1, rows, columns), px, at least 0, of gradients (N, 2, H, W); its median over `rest` is 0."""
        slopes = self.made_coarse(gradients)
        depth = self.solver(slopes - medians_where(slopes, rest))[:, None]
        return (depth - medians_where(depth, rest)).clamp(min=0)

    @torch.no_grad()
    def rest(self, color_change: Tensor) -> Tensor:
        """Samples (N, 1, rows, columns) whose color change (N, 3, H, W) says untouched gel; at least 2 % of them."""
        change = self.made_coarse(color_change)
        square = ((change - medians_where(change)) ** 2).sum(1, keepdim=True)
        least = square.flatten(1).quantile(LEAST_UNTOUCHED, dim=1)
        return square <= least.clamp(min=self.square)[:, None, None, None]

    def made_coarse(self, maps: Tensor) -> Tensor:
        """Maps (N, C, H, W) on the coarser grid: means."""
        return self.rows_coarse @ maps @ self.columns_coarse.T

    def in_full(self, maps: Tensor) -> Tensor:
        """Maps of the coarser grid for every pixel, bilinear."""
        return self.rows_full @ (maps @ self.columns_full.T)
