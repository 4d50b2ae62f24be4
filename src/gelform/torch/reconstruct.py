"""The path as PyTorch modules: a batch of images to depth in mm, and its steps, on any device."""

from __future__ import annotations

import math
from os import PathLike
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform import CalibrationError, GelformError, markers_from_image
from gelform.arrays import Array, Map
from gelform.calibration_file import Calibration, as_calibration
from gelform.depth.coarse import coarse_of
from gelform.foundations.checks import HIGHEST_SLOPE, check_image
from gelform.foundations.filters import CHANGE_OFFSET, MIN_UNTOUCHED, blur_taps, lattice_step
from gelform.image.background import ChangeSettings, gain_from_background, linear_light
from gelform.image.light import (
    ALIKE,
    EVERY,
    LEAST_REST,
    PRIOR,
    REST_SIGMA,
    TOUCHED_SIGMA,
    WIDENED,
    block_means,
)
from gelform.image.view import BRIGHT, DARK, pixel_positions
from gelform.slopes.budget import EXPOSURE_STEP_PX
from gelform.slopes.color_models import (
    ColorModel,
    ForwardResponse,
    HierarchicalModel,
    LambertianModel,
    NearLightModel,
    PolynomialModel,
)
from gelform.slopes.color_models.forward_response import (
    CLIPPED_STEP_SIGMA,
    DEPTH_UNIT_PX,
    NORMAL_UNIT,
    PLACE_DEGREES,
)
from gelform.slopes.color_models.physical import MAX_SLOPE, inverse_lights, inverted_lights
from gelform.slopes.color_models.seam import at_pixels, interpolation, monomial_parents, monomials

try:
    import torch
    from torch import Tensor, nn
    from torch.nn import functional
except ModuleNotFoundError as missing:
    raise GelformError(
        'torch is not installed, which gelform.torch needs: pip install "gelform[torch]".'
    ) from missing


def planes(values: Array, *axes: int) -> Tensor:
    """(C, H, W) float32 of (H, W, C); `axes` are those that come first, by default the last."""
    axes = axes or (-1,)
    moved = np.moveaxis(values, axes, range(len(axes)))
    return torch.from_numpy(np.ascontiguousarray(moved, dtype=np.float32))


def shares(size: int, other: int, interpolation: int) -> Tensor:
    """The fraction of each sample of a line in those of the same line of another size, (other, size), as in OpenCV."""
    line = np.eye(size, dtype=np.float32)
    return torch.from_numpy(cv2.resize(line, (size, other), interpolation=interpolation))


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
    rows (J. Makhoul, IEEE Trans. ASSP 28, 1980). `mm_per_px` is (x, y), mm, or in another unit, which depth then has.
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


class ColorChange(nn.Module):
    """Color change (N, 3, H, W) of images (N, 3, H, W), 0-255, against a background image (H, W, 3).

    With `compensate_exposure` the exposure of each image is estimated from its blocks at rest and removed. It is a
    constant: no derivative passes through it.
    """

    def __init__(self, background: Map, settings: ChangeSettings, compensate_exposure: bool) -> None:
        super().__init__()
        self.compensate_exposure, self.settings = compensate_exposure, settings
        self.register_buffer("untouched", planes(linear_light(background, settings)))
        self.register_buffer("gain", planes(gain_from_background(background, settings)))
        self.taps = blur_taps(settings.blur_px).tolist()  # from the middle outwards
        self.register_buffer("blocks", planes(block_means(background)))
        shape, (rows, columns) = background.shape[:2], self.blocks.shape[-2:]
        for name, size, few in (("row", shape[0], rows), ("column", shape[1], columns)):
            of_blocks = shares(size, few, cv2.INTER_AREA)
            most = int((of_blocks > 0).sum(1).max())
            order = (of_blocks > 0).sort(dim=1, descending=True, stable=True).indices[:, :most]
            # (pixels of a block, blocks), in the order of the line
            self.register_buffer(f"{name}_index", order.T.contiguous())
            self.register_buffer(f"{name}_share", of_blocks.gather(1, order).T.contiguous())
        self.halves_up = shape == (2 * rows, 2 * columns)  # as OpenCV rounds means of 2x2 pixels
        crosstalk = np.eye(3) if settings.crosstalk is None else np.asarray(settings.crosstalk)
        self.register_buffer("crosstalk", torch.from_numpy(crosstalk.astype(np.float32)))

    def forward(self, images: Tensor) -> Tensor:
        """The color change; a response exponent is differentiable only for images above 0."""
        levels = images.to(self.untouched.dtype)
        if self.compensate_exposure:
            levels = levels / self._gain(images)
        response = self.settings.response
        light = levels if response == 1 else 255 * (levels / 255) ** (1 / response)
        if self.settings.crosstalk is not None:
            light = torch.einsum("cd,ndhw->nchw", torch.linalg.inv(self.crosstalk), light)
        change, reach = (light - self.untouched) * self.gain, len(self.taps) - 1
        if reach == 0:
            return change
        padded = functional.pad(change, (reach,) * 4, mode="reflect")
        return _weighted_sum(_weighted_sum(padded, self.taps, 3), self.taps, 2)

    @torch.no_grad()
    def _gain(self, images: Tensor) -> Tensor:
        """Brightness of each channel relative to the background, (N, 3, 1, 1); see `gain_from_blocks`."""
        levels = images.to(self.untouched.dtype)
        blocks = _means(levels, self.column_index, self.column_share)
        blocks = _means(blocks.mT, self.row_index, self.row_share).mT
        if not images.is_floating_point():
            blocks = (blocks + 0.5).floor() if self.halves_up else blocks.round()
        blocks, rest = blocks[..., ::EVERY, ::EVERY], self.blocks[..., ::EVERY, ::EVERY]
        either = torch.stack([blocks, rest.expand_as(blocks)])
        lit = ((either.amin(0) > DARK) & (either.amax(0) < BRIGHT)).all(1, keepdim=True)
        start = medians_where(blocks / rest.clamp(min=1e-6), lit)
        return _fitted_gain(torch.where(start > 0, start, 1).log(), blocks, rest, lit).exp()


def _means(values: Tensor, index: Tensor, share: Tensor) -> Tensor:
    """Means along the last dimension, added one after the other as in OpenCV: then ties are rounded as there."""
    total = values[..., index[0]] * share[0]
    for at, part in zip(index[1:], share[1:]):
        total = total + values[..., at] * part
    return total


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


def gradients_module(model: ColorModel, background: Array) -> nn.Module:
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
        self.register_buffer("coefficients", planes(maps, 2, 3))  # (terms, 2, H, W)
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

    def __init__(self, inverse: Array, response: float) -> None:
        super().__init__()
        self.register_buffer("inverse", planes(inverse, 2, 3))  # (3, 3, H or 1, W or 1)
        self.response = response

    def forward(self, color_change: Tensor) -> Tensor:
        """Gradients -g_xy/g_z of g = L^-1 (1 + change), with slopes up to MAX_SLOPE."""
        ratio = 1 + color_change
        if self.response != 1:
            ratio = ratio.clamp(min=0) ** (1 / self.response)
        g = torch.stack([(row * ratio).sum(1) for row in self.inverse], dim=1)
        steepest = g[:, :2].norm(dim=1) / MAX_SLOPE
        # As in `gradients_from_scaled`.
        return -g[:, :2] / torch.maximum(g[:, 2], steepest).clamp(min=1e-6)[:, None]


class CoarseDepthModule(nn.Module):
    """Least-squares depth of frames on a grid four times coarser, 0 at the median of the gel at rest.

    Pixels with a color change up to `untouched` count as gel at rest.
    """

    def __init__(self, shape: tuple[int, int], untouched: float) -> None:
        super().__init__()
        self.square = untouched**2
        grid = coarse_of(shape)
        for name, size, few in zip(("rows", "columns"), shape, grid.shape):
            self.register_buffer(f"{name}_coarse", shares(size, few, cv2.INTER_AREA))
            self.register_buffer(f"{name}_full", shares(few, size, cv2.INTER_LINEAR))
        self.solver = PoissonDepth(grid.shape, grid.pitch_px)

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


class ForwardStep(nn.Module):
    """Gradients (N, 2, H, W) after one step from those of a color model; the response has a `step_sigma`."""

    def __init__(self, forward: ForwardResponse, untouched: float) -> None:
        super().__init__()
        assert forward.step_sigma is not None
        x, y = pixel_positions(forward.shape).T
        places = interpolation(x, y, forward.shape)
        maps = at_pixels(forward.nodes @ forward.roots[0], *places)
        self.register_buffer("coefficients", planes(maps.reshape(*forward.shape, -1, 3), 2, 3))
        self.register_buffer("root", torch.from_numpy(forward.roots[0]))
        self.at_rest, self.per_slope = (sigma**2 for sigma in forward.step_sigma)
        self.depth = CoarseDepthModule(forward.shape, untouched)

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
        # The relative rounding error of a determinant in float32 is 1e-6 of the product of its diagonal.
        determinant = (h11 * h22 * (1 + 1e-6) - h12 * h12)[:, None]
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

    Depth equals that of `integrate(observed_gradients, solver="dct")` of a `Reconstructor`'s result, 0 at rest, within
    1e-4 of its peak. Weights, anchor, confidence, uncertainty, contact and health are left out. Clipped channels are
    used as they are. Buffers follow `.to(device)` and `.double()`.

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
