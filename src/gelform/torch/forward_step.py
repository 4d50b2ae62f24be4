"""The step of the forward response and the depth that it needs, for batches: `PreparedStep` of numpy, `TorchFrameDepth`."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from gelform.depth.coarse import coarse_of
from gelform.foundations.filters import MIN_UNTOUCHED
from gelform.image.view.resample import pixel_positions
from gelform.slopes.color_models import ForwardResponse
from gelform.slopes.color_models._shared.least_squares import at_pixels, interpolation, monomials
from gelform.slopes.color_models.forward_response import (
    CLIPPED_STEP_SIGMA,
    DEPTH_UNIT_PX,
    NORMAL_UNIT,
    PLACE_DEGREES,
)
from gelform.torch.maps import PoissonDepth, bilinear_shares, block_shares, medians_where


class TorchFrameDepth(nn.Module):
    """Least-squares depth of frames on a grid four times coarser, 0 at the median of the gel at rest.

    Pixels with a color change up to `untouched` count as gel at rest.
    """

    def __init__(self, shape: tuple[int, int], untouched: float) -> None:
        super().__init__()
        self.square = untouched**2
        grid, pitch_px = coarse_of(shape).shape, coarse_of(shape).pitch_px
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
        """Samples (N, 1, rows, columns) at rest by their color change (N, 3, H, W); at least 2 % of them."""
        change = self.made_coarse(color_change)
        square = ((change - medians_where(change)) ** 2).sum(1, keepdim=True)
        least = square.flatten(1).quantile(MIN_UNTOUCHED, dim=1)
        return square <= least.clamp(min=self.square)[:, None, None, None]

    def made_coarse(self, maps: Tensor) -> Tensor:
        """Means of maps (N, C, H, W) on the coarser grid."""
        return self.rows_coarse @ maps @ self.columns_coarse.T

    def in_full(self, maps: Tensor) -> Tensor:
        """Maps of the coarser grid for every pixel, bilinear."""
        return self.rows_full @ (maps @ self.columns_full.T)


ROUNDING = 1e-6  # relative rounding error of a determinant in float32, over the product of its diagonal


class ForwardStep(nn.Module):
    """Gradients (N, 2, H, W) after one step from those of a color model; the response has a `step_sigma`."""

    def __init__(self, forward: ForwardResponse, untouched: float) -> None:
        super().__init__()
        assert forward.step_sigma is not None
        height, width = forward.shape
        x, y = pixel_positions(forward.shape).T
        places = interpolation(x, y, forward.shape)
        maps = at_pixels(forward.nodes @ forward.roots[0], *places)
        maps = np.moveaxis(maps.reshape(height, width, -1, 3), (2, 3), (0, 1))
        self.register_buffer("coefficients", torch.from_numpy(np.ascontiguousarray(maps, dtype=np.float32)))
        self.register_buffer("root", torch.from_numpy(forward.roots[0]))
        self.at_rest, self.per_slope = (sigma**2 for sigma in forward.step_sigma)
        self.depth = TorchFrameDepth(forward.shape, untouched)

    def forward(self, color_change: Tensor, gradients: Tensor) -> Tensor:
        """The step for a color change (N, 3, H, W) and gradients (N, 2, H, W)."""
        depth = self.depth(gradients, self.depth.rest(color_change))
        z = self.depth.in_full(depth)[:, 0] / DEPTH_UNIT_PX
        p, q = gradients.unbind(1)
        short = (1 + p * p + q * q).rsqrt()
        x, y, cube = p * short / NORMAL_UNIT, q * short / NORMAL_UNIT, short**3 / NORMAL_UNIT
        value, by_x, by_y = self._value(x, y, z)
        change = torch.einsum("ck,nchw->nkhw", self.root, color_change)
        cross = (-p * q * cube)[:, None]
        along_p = by_x * ((1 + q * q) * cube)[:, None] + by_y * cross
        along_q = by_x * cross + by_y * ((1 + p * p) * cube)[:, None]
        left = change - value
        prior = 1 / (self.at_rest + self.per_slope * (p * p + q * q))
        h11, h22 = (along_p**2).sum(1) + prior, (along_q**2).sum(1) + prior
        h12, b1, b2 = (
            (one * other).sum(1) for one, other in ((along_p, along_q), (along_p, left), (along_q, left))
        )
        determinant = (h11 * h22 * (1 + ROUNDING) - h12 * h12)[:, None]
        step = torch.stack([h22 * b1 - h12 * b2, h11 * b2 - h12 * b1], 1) / determinant
        length = ((step**2).sum(1, keepdim=True) + 1e-18).sqrt()
        return gradients + step * (CLIPPED_STEP_SIGMA / length).clamp(max=1)

    def _value(self, x: Tensor, y: Tensor, z: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """The whitened color change (N, 3, H, W) of a normal and a depth, and its derivatives by the normal's terms."""
        xs, ys = ([torch.ones_like(v), v, v * v, v**3, v**4] for v in (x, y))
        *of_normal, by_depth, by_depth_x, by_depth_y = self.coefficients
        value = z[:, None] * by_depth
        by_x, by_y = z[:, None] * by_depth_x, z[:, None] * by_depth_y
        value = value + by_x * x[:, None] + by_y * y[:, None]
        for term, k in zip(monomials(2, len(PLACE_DEGREES)), of_normal):
            a, b = term.count(0), term.count(1)
            value = value + k * (xs[a] * ys[b])[:, None]
            if a:
                by_x = by_x + k * (a * xs[a - 1] * ys[b])[:, None]
            if b:
                by_y = by_y + k * (b * xs[a] * ys[b - 1])[:, None]
        return value, by_x, by_y
