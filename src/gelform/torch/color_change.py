"""images -> color change, for batches: exposure, response, crosstalk and blur as in the numpy path."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from gelform.foundations.filters import blur_taps
from gelform.image.background.change import ChangeSettings, gain_from_background, linear_light
from gelform.image.background.exposure import FULL_SHARE, HALF_WIDTHS_LOG, MIN_SHARE, block_means
from gelform.image.frame import BRIGHT, DARK
from gelform.torch.maps import block_shares, planes

BINS, WINDOW, SPAN = 240, 6, 1.2  # of the histogram of log ratios, as in the kernel `crowd_of_ratios`


class ColorChange(nn.Module):
    """Color change (N, 3, H, W) of images (N, 3, H, W), 0-255, against a background image (H, W, 3).

    With `compensate_exposure` the exposure of each image is estimated from its blocks at rest and removed. It is a
    constant: no derivative passes through it.
    """

    def __init__(
        self, background: NDArray[np.float32], settings: ChangeSettings, compensate_exposure: bool
    ) -> None:
        super().__init__()
        self.compensate_exposure = compensate_exposure
        taps = blur_taps(settings.blur_px)
        self.settings = settings
        self.shape = background.shape[:2]
        self.register_buffer("untouched", planes(linear_light(background, settings)))
        self.register_buffer("gain", planes(gain_from_background(background, settings)))
        self.taps = taps.tolist()  # from the middle outwards
        self.register_buffer("blocks", planes(block_means(background)))
        for name, size, blocks in zip(("rows", "columns"), self.shape, self.blocks.shape[-2:]):
            self.register_buffer(name, block_shares(size, blocks))
        size = self.blocks.shape[-2:]
        self.halves_up = self.shape == (2 * size[0], 2 * size[1])  # as OpenCV rounds means of 2x2 pixels
        crosstalk = np.eye(3) if settings.crosstalk is None else np.asarray(settings.crosstalk)
        self.register_buffer("crosstalk", torch.from_numpy(crosstalk.astype(np.float32)))

    def forward(self, images: Tensor) -> Tensor:
        """The color change; a response exponent is differentiable only for images above 0."""
        levels = images.to(self.untouched.dtype)
        if self.compensate_exposure:
            levels = levels / self._believed_gain(images)[:, :, None, None]
        light = levels if self.settings.response == 1 else self._linear(levels)
        if self.settings.crosstalk is not None:
            light = torch.einsum("cd,ndhw->nchw", torch.linalg.inv(self.crosstalk), light)
        return self._blurred((light - self.untouched) * self.gain)

    def _linear(self, levels: Tensor) -> Tensor:
        return 255 * (levels / 255) ** (1 / self.settings.response)

    def _blurred(self, change: Tensor) -> Tensor:
        reach = len(self.taps) - 1
        if reach == 0:
            return change
        padded = functional.pad(change, (reach,) * 4, mode="reflect")
        return _weighted_sum(_weighted_sum(padded, self.taps, 3), self.taps, 2)

    @torch.no_grad()
    def _believed_gain(self, images: Tensor) -> Tensor:
        """Brightness of each channel relative to the background, (N, 3); see `Exposure.believed_gain`."""
        levels = images.to(self.untouched.dtype)
        blocks = self.rows @ levels @ self.columns.T
        if not images.is_floating_point():
            blocks = (blocks + 0.5).floor() if self.halves_up else blocks.round()
        either = torch.stack([blocks, self.blocks.expand_as(blocks)])
        lit = ((either.amin(0) > DARK) & (either.amax(0) < BRIGHT)).all(1).flatten(1)
        ratio = (blocks / self.blocks).clamp(1e-6, 1e6)
        logs = torch.where(lit[:, None], ratio.flatten(2).log(), 0)
        center = _fullest(logs, lit)
        for half_width in HALF_WIDTHS_LOG:
            away = logs - center[..., None]
            near = lit & (away.abs().amax(1) < float(half_width))
            count = near.sum(1)
            center = center + (away * near[:, None]).sum(2) / count.clamp(min=1)[:, None]
        part = ((count / lit.shape[1] - MIN_SHARE) / (FULL_SHARE - MIN_SHARE)).clamp(0, 1)
        return (center * part[:, None]).exp()


def _weighted_sum(values: Tensor, taps: list[float], dim: int) -> Tensor:
    """Blur along a dimension, without its ends; a grouped convolution takes four times as long on a CPU."""
    reach = len(taps) - 1
    kept = values.shape[dim] - 2 * reach
    total = values.narrow(dim, reach, kept) * taps[0]
    for k, tap in enumerate(taps[1:], 1):
        sides = values.narrow(dim, reach - k, kept) + values.narrow(dim, reach + k, kept)
        total = total.add(sides, alpha=tap)
    return total


def _fullest(logs: Tensor, lit: Tensor) -> Tensor:
    """Middle (N, 3) of the window of bins with the most log ratios (N, 3, blocks)."""
    bins = ((logs + SPAN) * (BINS / (2 * SPAN))).clamp(0, BINS - 1).long()
    counts = torch.zeros(*logs.shape[:2], BINS, dtype=logs.dtype, device=logs.device)
    counts.scatter_add_(2, bins, lit[:, None].to(logs.dtype).expand_as(logs))
    held = counts.unfold(2, WINDOW, 1).sum(-1)
    first = (held == held.amax(2, keepdim=True)).to(torch.uint8).argmax(2)
    return (first.to(logs.dtype) + WINDOW / 2) * (2 * SPAN / BINS) - SPAN
