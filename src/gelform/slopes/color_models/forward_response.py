"""The forward response: the color change of a slope at a place and a depth, and one step back from it.

    f(g; x, y, z) = sum over 1 <= i + j <= 4 of B_ij(x, y) vx^i vy^j  +  z a(x, y)  +  z (bx vx + by vy)      (3 channels)

v is the normal's first two components over 0.3, z the depth of the frame over 10 px. Pressed gel is nearer to the
lamps than gel at rest, so that level gel changes its color too, which no map from color to slope can express. So the
slopes of a color model get one Gauss-Newton step toward those of the color in the image. The step's prior is the color
model's own error; the step also gives its covariance and its residual (C. M. Bishop, Pattern Recognition and Machine
Learning, 2006, section 4.4, Laplace's approximation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gelform._native import Kernel
from gelform.arrays import Array, Map, Mask, Numbers, Slopes
from gelform.foundations.checks import check_values, check_within
from gelform.foundations.information import determined_by
from gelform.slopes.color_models.polynomial import RIDGES as POLYNOMIAL_RIDGES
from gelform.slopes.color_models.seam import (
    ORDER_GROWTH,
    Samples,
    Stored,
    Term,
    VaryingRegression,
    at_pixels,
    interpolation,
    monomial_products,
    monomials,
    nodes_at_scale,
    terms_of_orders,
)

# Units of the coefficients that make all terms about 1: the RMS of the normal's first two components in contacts, and a
# usual depth, px.
NORMAL_UNIT, DEPTH_UNIT_PX = 0.3, 10.0
PLACE_DEGREES = 5, 4, 3, 2  # degrees in place of terms of order 1 to 4 in the normal
RIDGES = POLYNOMIAL_RIDGES[2:]  # ridges that calibration tries, the stiffest first
# Prior of a slope with one of three channels clipped, mm/mm: a wide one. Also the longest step: a longer one explains a
# mirrored light or dust by a slope of its color.
CLIPPED_STEP_SIGMA = 0.3

_POWERS = monomials(2, len(PLACE_DEGREES))  # (vx, vy, vx vx, vx vy, ...)
TERMS = len(_POWERS) + 3
_PER_UNIT = np.array(
    [NORMAL_UNIT ** -len(term) for term in _POWERS]
    + [1 / DEPTH_UNIT_PX]
    + 2 * [1 / (DEPTH_UNIT_PX * NORMAL_UNIT)]
)  # of each term, so that a frame's step needs no units

_forward_step = Kernel(
    "forward_step",
    "f32[h,w,3] change, f32[h,w,2] read, f32[dh,dw] depth, u8[h,w,3]? clipped, f32[r,c,17,3] nodes, f32[4,3,3] roots, "
    "out f32[n] work, out f32[h,w,2] gradients, out f32[h,w] variance, out f32[h,w] residual, f32 at_rest, "
    "f32 per_slope, f32 clipped_prior",
)


class Step(NamedTuple):
    """Slopes after one step, with their variance and residual."""

    gradients: Array  # (..., 2), mm/mm
    variance: Array  # (...), mean of both components' variances
    residual: Array  # (...), squared, of the color change, in units of its covariance: 1 degree of freedom


@dataclass(frozen=True, eq=False)
class ForwardResponse(Stored):
    """Color change as a polynomial in the normal and the depth, its coefficients varying over the image."""

    # (rows, columns, 17, 3), coefficients at every 16th pixel, bilinear between: 14 monomials of the normal, the depth, and
    # the depth times the normal.
    nodes: Numbers
    covariance: Numbers  # (3, 3), of the color change about it on the presses it was fitted to
    shape: tuple[int, int]  # (H, W)
    # (at rest, per slope), the prior of a step: slopes g of the color model have a standard deviation of
    # hypot(at rest, per slope |g|), mm/mm. None without a step, because it did not improve held-out presses.
    step_sigma: tuple[float, float] | None = None
    # Squared residuals on held-out presses over those that the covariance predicts, at the 95 % that usual pixels stay
    # under: the unit for judging outliers.
    residual_scale: float = 1.0
    # (2, 3), whether the training presses show red, green, blue at the camera's lower and upper end: if so, the model holds
    # for such pixels too.
    clipped: Mask | None = None

    def __post_init__(self) -> None:
        check_values(self.nodes, "forward_nodes", (3,))
        covariance = check_values(self.covariance, "forward_covariance", (3,))
        right = np.shape(self.nodes)[2:] == (TERMS, 3) and covariance.shape == (3, 3)
        if not right or determined_by(covariance).undetermined.any():
            raise ValueError(
                f"Expected forward nodes (rows, columns, {TERMS}, 3) and a covariance (3, 3), got others."
            )
        if self.step_sigma is not None:
            for value, least in zip(self.step_sigma, (1e-6, 0)):
                check_within(value, "step_sigma", least, 1e3)
        check_within(self.residual_scale, "residual_scale", 1e-6, 1e12)

    @classmethod
    def fit_each(
        cls,
        samples: Samples,
        ridges: Sequence[float] = RIDGES,
        *,
        step_sigma: tuple[float, float] | None = None,
        start: ForwardResponse | None = None,
    ) -> list[ForwardResponse]:
        """One response for each ridge, by penalized least squares of the color change.

        The samples need `depth_px`, the depth of the frame from the color model. The ridge belongs to a coefficient that is
        the same everywhere, relative to the samples' weight. With the `start` of another unit, coefficients are pulled to
        its own instead of to 0.
        """
        assert samples.depth_px is not None
        g, target = samples.gradients, samples.color_change
        from_nodes = 0 if start is None else start.nodes
        if start is not None:
            at = samples.x_px, samples.y_px
            target = target - start.color_from_gradients(g, *at, depth_px=samples.depth_px)
        v, z = normal_terms(g), np.asarray(samples.depth_px, dtype=np.float64) / DEPTH_UNIT_PX
        orders = [len(term) for term in _POWERS]
        terms = [
            *terms_of_orders(monomial_products(v.T, _POWERS), orders, PLACE_DEGREES),
            Term(z, 4, ORDER_GROWTH),
            *(Term(z * one, 0, ORDER_GROWTH**2) for one in v.T),
        ]
        regression = VaryingRegression.of(terms, target, samples)
        pressed = np.any(g != 0, axis=1)[:: round(len(samples.x_px) / len(regression.target))]
        found = []
        for ridge in ridges:
            coefficients = regression.coefficients(ridge)
            left = regression.residual(coefficients)[pressed]
            covariance = np.cov(left.T) + 1e-12 * np.eye(3)
            nodes = from_nodes + regression.nodes(coefficients)
            found.append(cls(nodes, covariance, samples.shape, step_sigma))
        return found

    @classmethod
    def average(cls, responses: Sequence[ForwardResponse], shares: Sequence[float]) -> ForwardResponse:
        """The mean of responses that have a step and were fitted to the same samples, in shares.

        A weighted mean of the fits' mean squares is that of the mean fit plus the fits' own variance about it. So its
        covariance and its prior have the error within the fits and the one between them.
        """
        nodes, covariance, squares = (
            np.average(values, axis=0, weights=shares)
            for values in (
                [one.nodes for one in responses],
                [one.covariance for one in responses],
                [np.square(np.asarray(one.step_sigma)) for one in responses],
            )
        )
        at_rest, per_slope = np.sqrt(squares).tolist()
        return cls(nodes, covariance, responses[0].shape, (at_rest, per_slope))

    def color_from_gradients(
        self, gradients: Array, x_px: Array, y_px: Array, *, depth_px: Array | float = 0.0
    ) -> Numbers:
        """Expected color change (N, 3) of gradients (N, 2), and depths (N,), at pixel positions (N,)."""
        v, z = normal_terms(gradients), np.broadcast_to(np.asarray(depth_px) / DEPTH_UNIT_PX, len(gradients))
        coefficients = at_pixels(self.nodes, *interpolation(x_px, y_px, self.shape))
        products = np.stack([*monomial_products(v.T, _POWERS), z, z * v[:, 0], z * v[:, 1]])
        return np.asarray(np.einsum("tn,ntc->nc", products, coefficients))

    def of_other_unit(self, gain: Numbers, wider: float) -> ForwardResponse:
        """The response of a unit with smaller color changes and noise, by a gain (rows, columns, 3) at its nodes.

        Its pixels are `wider` times as wide on the gel.
        """
        nodes = nodes_at_scale(self.nodes, self.shape, wider) / gain[:, :, None]
        nodes[:, :, -3:] *= wider  # depth is in pixels
        usual = np.exp(np.log(gain).mean(axis=(0, 1)))
        covariance = self.covariance / np.outer(usual, usual)
        return replace(self, nodes=nodes, covariance=covariance)

    def at_size(self, shape: tuple[int, int], wider: float) -> ForwardResponse:
        """As `ColorModel.at_size`."""
        nodes = nodes_at_scale(self.nodes, self.shape, wider, shape)
        nodes[:, :, -3:] *= wider  # depth is in pixels
        return replace(self, nodes=nodes, shape=shape)

    @cached_property
    def slope_per_change(self) -> float:
        """Error of a slope at rest, mm/mm, for an error of 1 of the color change: the median over the image."""
        along = np.moveaxis(self.nodes[:, :, :2], 2, 3) / NORMAL_UNIT
        information = np.linalg.eigvalsh(np.einsum("rcka,rckb->rcab", along, along))
        variance = np.sum(1 / np.maximum(information, 1e-12), axis=2) / 2
        return float(np.sqrt(np.median(variance)))

    @cached_property
    def roots(self) -> Map:
        """(4, 3, 3): lower factors L of the inverse covariance L L^T of all channels, and without red, green, blue."""
        found = np.zeros((4, 3, 3))
        # Definite: the record refuses any other covariance, and so are its parts.
        found[0] = np.linalg.cholesky(np.linalg.inv(self.covariance))
        for channel in range(3):
            kept = [c for c in range(3) if c != channel]
            inverse = np.linalg.inv(self.covariance[np.ix_(kept, kept)])
            found[1 + channel][np.ix_(kept, [0, 1])] = np.linalg.cholesky(inverse)
        return found.astype(np.float32)


class PreparedStep:
    """Steps of whole frames by one forward response. It is immutable; threads can share it."""

    def __init__(self, forward: ForwardResponse) -> None:
        assert forward.step_sigma is not None
        self._nodes = np.ascontiguousarray(forward.nodes * _PER_UNIT[:, None], dtype=np.float32)
        self._roots = forward.roots
        at_rest, per_slope = forward.step_sigma
        self._priors = at_rest**2, per_slope**2, 1 / CLIPPED_STEP_SIGMA**2
        padded = -(-forward.shape[1] // 16) * 16
        self._work_size = 2 * self._nodes.shape[1] * TERMS * 3 + 4 * TERMS * 3 + 12 * padded

    def __call__(
        self, color_change: Map, gradients: Slopes, depth_px: Map, clipped: NDArray[np.uint8] | None = None
    ) -> Step:
        """The step of a frame, from the gradients (H, W, 2) that a color model read of a color change (H, W, 3).

        The depth (rows, columns), px, is coarser. A `clipped` channel (H, W, 3) does not count; there the other two take two
        steps, with a prior of 0.3. No step is longer than that.
        """
        stepped = np.empty_like(gradients)
        variance, residual = (np.empty(gradients.shape[:2], np.float32) for _ in range(2))
        work = np.empty(self._work_size, np.float32)
        _forward_step(
            color_change, gradients, depth_px, clipped, self._nodes, self._roots, work, stepped, variance, residual,
            *self._priors,
        )  # fmt: skip
        return Step(stepped, variance, residual)


def normal_terms(gradients: Array) -> Numbers:
    """The normal's first two components (N, 2), with the sign of the slopes, in the response's unit."""
    slopes = np.asarray(gradients, dtype=np.float64)
    length = np.sqrt(1 + np.sum(slopes**2, axis=-1, keepdims=True))
    return np.asarray(slopes / (NORMAL_UNIT * length))
