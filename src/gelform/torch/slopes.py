"""color change -> gradients, for batches: the color models with a closed formula."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from gelform.errors import CalibrationError
from gelform.foundations.checks import HIGHEST_SLOPE
from gelform.image.view.resample import pixel_positions
from gelform.slopes.color_models import (
    ColorModel,
    HierarchicalModel,
    LambertianModel,
    NearLightModel,
    PolynomialModel,
)
from gelform.slopes.color_models._shared.least_squares import monomial_parents, monomials
from gelform.slopes.color_models.lambertian import MAX_SLOPE, inverse_lights
from gelform.slopes.color_models.near_light import inverted_lights

LEAST_NORMAL_Z = 1e-6  # as in `gradients_from_scaled`


def gradients_module(model: ColorModel, background: NDArray[Any]) -> nn.Module:
    """A color model on a background image (H, W, 3) as a module: color change (N, 3, H, W) -> gradients (N, 2, H, W).

    CalibrationError: the color model has no such form.
    """
    shape = background.shape[:2]
    if isinstance(model, (HierarchicalModel, PolynomialModel)):
        return PolynomialGradients(model, shape)
    if isinstance(model, LambertianModel):
        return LitGradients(inverse_lights(model.lights)[None, None], model.response)
    if isinstance(model, NearLightModel):
        inverse = inverted_lights(model.lights_at(*pixel_positions(shape).T)).reshape(*shape, 3, 3)
        return LitGradients(inverse, model.response)
    raise CalibrationError(
        "Expected a calibration with the color model hierarchical, polynomial, lambertian or near_light, "
        f"got {model.name}. Calibrate with --model hierarchical, or use gelform.Reconstructor."
    )


class PolynomialGradients(nn.Module):
    """A polynomial in the color change whose coefficients vary over the image."""

    def __init__(self, model: HierarchicalModel | PolynomialModel, shape: tuple[int, int]) -> None:
        super().__init__()
        maps = model.coefficients_at(*pixel_positions(shape).T).reshape(*shape, -1, 2)
        self.register_buffer("coefficients", _tensor(np.moveaxis(maps, (2, 3), (0, 1))))  # (terms, 2, H, W)
        self.parents = monomial_parents(monomials(3, model.degree)).tolist()
        self.steepest = model.steepest if isinstance(model, HierarchicalModel) else HIGHEST_SLOPE

    def forward(self, color_change: Tensor) -> Tensor:
        """Gradients; each monomial is the product of an earlier one and a channel."""
        channels = color_change.unbind(1)
        products: list[Tensor] = []
        gradients = torch.zeros_like(color_change[:, :2])
        for (parent, channel), coefficient in zip(self.parents, self.coefficients):
            products.append(channels[channel] if parent < 0 else products[parent] * channels[channel])
            gradients = gradients + products[-1][:, None] * coefficient
        return gradients * (self.steepest / gradients.norm(dim=1, keepdim=True).clamp(min=self.steepest))


class LitGradients(nn.Module):
    """Photometric stereo with the inverse of a light matrix, one for all pixels or one per pixel."""

    def __init__(self, inverse: NDArray[Any], response: float) -> None:
        super().__init__()
        self.register_buffer(
            "inverse", _tensor(np.moveaxis(inverse, (2, 3), (0, 1)))
        )  # (3, 3, H or 1, W or 1)
        self.response = response

    def forward(self, color_change: Tensor) -> Tensor:
        """Gradients -g_xy/g_z of g = L^-1 (1 + change), with slopes up to MAX_SLOPE."""
        ratio = 1 + color_change
        if self.response != 1:
            ratio = ratio.clamp(min=0) ** (1 / self.response)
        g = torch.stack([(row * ratio).sum(1) for row in self.inverse], dim=1)
        steepest = g[:, :2].norm(dim=1) / MAX_SLOPE
        return -g[:, :2] / torch.maximum(g[:, 2], steepest).clamp(min=LEAST_NORMAL_Z)[:, None]


def _tensor(values: NDArray[Any]) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
