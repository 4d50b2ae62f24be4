"""images -> color change, for batches: exposure, response, crosstalk and blur as in the numpy path."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from gelform.foundations.filters import CHANGE_OFFSET, blur_taps
from gelform.image.background.change import ChangeSettings, gain_from_background, linear_light
from gelform.image.background.light import (
    ALIKE,
    EVERY,
    LEAST_REST,
    PRIOR,
    REST_SIGMA,
    TOUCHED_SIGMA,
    WIDENED,
    block_means,
)
from gelform.image.frame import BRIGHT, DARK
from gelform.torch.maps import block_shares, medians_where, planes


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
            levels = levels / self._gain(images)
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
    def _gain(self, images: Tensor) -> Tensor:
        """Brightness of each channel relative to the background, (N, 3, 1, 1); see `gain_from_blocks`."""
        levels = images.to(self.untouched.dtype)
        blocks = self.rows @ levels @ self.columns.T
        if not images.is_floating_point():
            blocks = (blocks + 0.5).floor() if self.halves_up else blocks.round()
        blocks, rest = blocks[..., ::EVERY, ::EVERY], self.blocks[..., ::EVERY, ::EVERY]
        either = torch.stack([blocks, rest.expand_as(blocks)])
        lit = ((either.amin(0) > DARK) & (either.amax(0) < BRIGHT)).all(1, keepdim=True)
        start = medians_where(blocks / rest.clamp(min=1e-6), lit)
        return _fitted_gain(torch.where(start > 0, start, 1).log(), blocks, rest, lit).exp()


def _fitted_gain(logarithm: Tensor, blocks: Tensor, rest: Tensor, lit: Tensor) -> Tensor:
    """The gain's logarithm (N, 3, 1, 1) from a start, as the kernel `fit_light` fits a gain alone."""
    places = (1, 2, 3)
    sigma = torch.full_like(logarithm[:, :1], REST_SIGMA)
    count = lit.sum(places, keepdim=True).clamp(min=1)
    for widened in WIDENED[:-1].tolist():  # the last round moves nothing
        deviation = sigma * widened
        light = logarithm.exp() * rest
        per_level = 1 / (light + CHANGE_OFFSET)
        residual, per_log = (blocks + CHANGE_OFFSET) * per_level - 1, light * per_level
        square = residual.square().sum(1, keepdim=True)
        apart = 0.5 / deviation**2 - 0.5 / TOUCHED_SIGMA**2
        odd = (-square * apart).clamp(min=-80).exp()
        at_rest = lit * odd / (odd + (deviation / TOUCHED_SIGMA) ** 3)
        weight, prior = ALIKE / (count * deviation**2), PRIOR[0]
        side = weight * (at_rest * per_log * residual).sum((2, 3), keepdim=True) - prior * logarithm
        normal = weight * (at_rest * per_log.square()).sum((2, 3), keepdim=True) + prior
        logarithm = logarithm + side / normal
        sums = (at_rest * square).sum(places, keepdim=True), at_rest.sum(places, keepdim=True)
        sigma = (sums[0] / (3 * sums[1] + 1e-9)).sqrt().clamp(LEAST_REST, REST_SIGMA)
    return logarithm


def _weighted_sum(values: Tensor, taps: list[float], dim: int) -> Tensor:
    """Blur along a dimension, without its ends; a grouped convolution takes four times as long on a CPU."""
    reach = len(taps) - 1
    kept = values.shape[dim] - 2 * reach
    total = values.narrow(dim, reach, kept) * taps[0]
    for k, tap in enumerate(taps[1:], 1):
        sides = values.narrow(dim, reach - k, kept) + values.narrow(dim, reach + k, kept)
        total = total.add(sides, alpha=tap)
    return total
