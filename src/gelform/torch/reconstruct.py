"""The path as a PyTorch module: a batch of images to depth in mm."""

from __future__ import annotations

from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from gelform import CalibrationError, GelformError, markers_from_image
from gelform.calibration_file import Calibration, as_calibration
from gelform.foundations.checks import check_image
from gelform.foundations.filters import MIN_UNTOUCHED, lattice_step
from gelform.image.background import EXPOSURE_STEP_PX

try:
    import torch
    from torch import Tensor, nn
except ModuleNotFoundError as missing:
    raise GelformError(
        'torch is not installed, which gelform.torch needs: pip install "gelform[torch]".'
    ) from missing

from gelform.torch.steps import ColorChange, ForwardStep, PoissonDepth, gradients_module, medians_where

CPU_FRAMES = 2  # frames at a time: their data fits into the processor's cache


class BatchReconstruction(NamedTuple):
    """The result of a batch of images.

    Attributes
    ----------
    depth_mm : (N, 1, H, W), mm, 0 where the gel is at rest, positive where pressed; px without mm_per_px
    gradients : (N, 2, H, W), mm/mm: dz/dx, dz/dy of the color model, without the bias of the pixels at rest
    """

    depth_mm: Tensor
    gradients: Tensor


class Reconstruct(nn.Module):
    """Color model and cosine solver of a calibration, for batches: differentiable, on the module's device.

    Depth equals that of `gelform.Reconstructor(calibration, solver="dct").from_image` within 1e-4 of its peak.
    Weights, anchor, confidence, uncertainty, contact and health are left out. Clipped channels are used as they are.
    Buffers follow `.to(device)` and `.double()`.

    Parameters
    ----------
    calibration : of this sensor, or the path of its file; color model hierarchical, polynomial, lambertian or near_light
    background : (H, W, 3), 0-255, a current background image; by default the calibration's own
    compensate_exposure : whether each image's exposure is estimated and removed, as in the numpy path
        It is a constant: no derivative passes through it. Turn it off for rendered images, and for exact derivatives.

    Raises
    ------
    CalibrationError
        The color model is another one, the gel has markers, or the file cannot be read.
    GelformError
        torch is not installed.
    """

    def __init__(
        self,
        calibration: Calibration | str | PathLike[str],
        background: ArrayLike | None = None,
        *,
        compensate_exposure: bool = True,
    ) -> None:
        super().__init__()
        calibration = as_calibration(calibration)
        self.shape = height, width = calibration.image_shape
        self.lattice = (..., *(slice(None, None, lattice_step(height * width)),) * 2)
        today = calibration.background
        if background is not None:
            today = check_image(background, shape=self.shape, name="background").astype(np.float32)
        if len(markers_from_image(today)):
            raise CalibrationError(
                "Expected a gel without markers, whose dots this module would read as slopes. "
                "Use gelform.Reconstructor."
            )
        self.threshold = calibration.untouched_change
        self.color_change = ColorChange(today, calibration.change, compensate_exposure)
        self.model = gradients_module(calibration.color_model, today)
        forward = calibration.forward
        self.step = None
        if forward is not None and forward.step_sigma is not None:
            self.step = ForwardStep(forward, self.threshold)
        self.solver = PoissonDepth(self.shape, (calibration.mm_per_px or 1.0,) * 2)

    def forward(self, images: Tensor) -> BatchReconstruction:
        """Depth of a batch of images, RGB, 0-255, (N, 3, H, W): uint8, or floating point for derivatives.

        Raises
        ------
        ValueError
            The images have another shape.
        """
        if images.ndim != 4 or tuple(images.shape[1:]) != (3, *self.shape):
            raise ValueError(
                f"Expected images of shape (N, 3, {self.shape[0]}, {self.shape[1]}), got {tuple(images.shape)}. "
                "Move the channels first: torch.from_numpy(image).permute(2, 0, 1)[None]."
            )
        if images.device.type == "cpu" and len(images) > CPU_FRAMES:
            parts = [self._of_part(part) for part in images.split(CPU_FRAMES)]
            return BatchReconstruction(*(torch.cat(of_parts) for of_parts in zip(*parts)))
        return self._of_part(images)

    def _of_part(self, images: Tensor) -> BatchReconstruction:
        change = self.color_change(images)
        gradients = self.model(change)
        if self.step is not None:
            gradients = self.step(change, gradients)
        chosen = self._at_rest(change)[self.lattice]
        gradients = gradients - medians_where(gradients[self.lattice], chosen)
        depth = self.solver(gradients)[:, None]
        zero = medians_where(depth[self.lattice], chosen)
        return BatchReconstruction(depth - zero, gradients)

    @torch.no_grad()
    def _at_rest(self, change: Tensor) -> Tensor:
        """Pixels (N, 1, H, W) whose color did not change; if too few, the pixels that changed least."""
        coarse = change[..., ::EXPOSURE_STEP_PX, ::EXPOSURE_STEP_PX]
        near = ((change - medians_where(coarse)) ** 2).sum(1, keepdim=True) < self.threshold**2
        few = near[self.lattice].float().mean((1, 2, 3)) < MIN_UNTOUCHED
        if bool(few.any()):
            size = change[few].norm(dim=1, keepdim=True)
            ordered = size.flatten(1).sort(dim=1).values
            limit = ordered[:, round(MIN_UNTOUCHED * (ordered.shape[1] - 1))]
            near[few] = size <= limit[:, None, None, None]
        return near
