"""Errors of held-out slopes: their standard deviation by step and slope, and their correlation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.candidates import FittedSlopes
from gelform.calibration.circles.find import ContactCircle, scale_of
from gelform.calibration.circles.samples import PRESS_PIXELS, REST_DISTANCE, PreparedPress
from gelform.calibration.held_out.folds import Fold
from gelform.result.metrics import score_slopes
from gelform.slopes.color_models.forward_response import Step
from gelform.slopes.confidence import SlopeErrors, SlopeSigma

LAGS = 24  # steps, px at 240 rows; errors in a contact correlate over 3-10
ROWS = 8  # rows of gel at rest, for the correlation of errors there
SHORTEST_PX = 0.3  # px, shortest of that correlation, which noise and blur cause
# Fraction of squared residuals of 1 degree of freedom, and their limit.
MOST, CHI_SQUARE_AT_MOST = 0.95, 3.84


@dataclass(frozen=True)
class PressResiduals:
    """The slopes that a model reads on a held-out press, and their errors.

    Attributes
    ----------
    slopes, errors : (h, w, 2) in the contact's bounding box, mm/mm, NaN outside its edge
    stated : (N,) standard deviation by the step; 1 without a step
    residual : (N,) squared, of the color change after the step
    rows, cols : (N,) of the pixels of that part, in the image
    untouched : (M, 2) slopes read far from the contact, where 0 is true, their median removed
    untouched_noise : (M,) their variance from the image's noise
    untouched_rows : (rows, W, 2) the same of whole rows of the image, NaN near the contact
    """

    slopes: NDArray[np.float64]
    errors: NDArray[np.float64]
    stated: NDArray[np.float64]
    residual: NDArray[np.float64]
    rows: NDArray[np.intp]
    cols: NDArray[np.intp]
    untouched: NDArray[np.float64]
    untouched_noise: NDArray[np.float32]
    untouched_rows: NDArray[np.float64]

    def columns(self) -> tuple[NDArray[np.float64], ...]:
        """Slope, errors, stated deviation and residual of some pixels."""
        thin = slice(None, None, max(1, len(self.rows) // PRESS_PIXELS))
        at = self.rows[thin] - self.rows.min(), self.cols[thin] - self.cols.min()
        slopes = np.linalg.norm(self.slopes[at], axis=-1)
        return slopes, self.errors[at], self.stated[thin], self.residual[thin]


def slope_sigma_from_folds(
    fits: Sequence[FittedSlopes],
    folds: Sequence[Fold],
    presses: Sequence[PreparedPress],
    found: Sequence[ContactCircle],
    noise: NDArray[np.float32],
) -> tuple[SlopeSigma, float]:
    """Standard deviation and correlation of the slopes, and the scale of the residual, on held-out presses.

    A fold's model has seen fewer presses than the final one, and is worse for it. So its errors are multiplied by the root
    of
    the fraction of presses, the rate at which errors of estimation fall. `noise` (H, W) is as `noise_at_rest` gives it.
    """
    trained = fraction_trained(folds)
    shape = presses[0].size.shape
    step = max(1, round(scale_of(shape)))
    residuals = {
        i: press_residuals(presses[i], found[i], fit.frame(presses[i]), noise)
        for fit, fold in zip(fits, folds)
        for i in fold.held_out
    }
    products = [_lag_products(one.errors, step) for one in residuals.values()]
    parts = [one.columns() for one in residuals.values()]
    slopes, errors, stated, residual = (np.concatenate(column) for column in zip(*parts))
    untouched = np.concatenate([one.untouched for one in residuals.values()])
    there = np.concatenate([one.untouched_noise for one in residuals.values()])
    held_out = SlopeErrors(slopes, np.sqrt(trained) * errors, untouched, there, stated)
    length, fraction = correlation_from_products(np.mean(products, axis=0), step)
    fitted = SlopeSigma.fit(held_out, length, fraction)
    at_rest = np.mean([_lag_products(one.untouched_rows, 1) for one in residuals.values()], axis=0)
    rest_length, rest_fraction = rest_correlation(at_rest, length)
    fitted = replace(fitted, rest_correlation_px=rest_length, rest_correlated_share=rest_fraction)
    return fitted, max(float(np.quantile(residual, MOST)) / CHI_SQUARE_AT_MOST, 1.0)


def fraction_trained(folds: Sequence[Fold]) -> float:
    """Mean fraction of the presses that train a fold's model."""
    return float(np.mean([len(f.training) / (len(f.training) + len(f.held_out)) for f in folds]))


def correlation_from_products(products: NDArray[np.float64], step: float) -> tuple[float, float]:
    """Length (px) and fraction (0-1) of the correlated part of errors: `fraction exp(-lag^2 / (2 length^2))` from lag 1 on.

    The rest is white, with no correlation at the first lag. Products are at lags of 0, 1, 2 ... steps (px).
    """
    correlation = products / max(products[0], 1e-30)
    below = np.nonzero(correlation[1:] < 0.05)[0]
    last = max(3, int(below[0]) + 1 if below.size else LAGS)
    lags = step * np.arange(1, last)
    best = (np.inf, float(step), 0.0)
    for length in step * np.geomspace(0.7, LAGS, 60):
        shape = np.exp(-(lags**2) / (2 * length**2))
        fraction = float(np.clip(shape @ correlation[1:last] / max(shape @ shape, 1e-30), 0, 1))
        misfit = float(np.square(fraction * shape - correlation[1:last]).sum())
        best = min(best, (misfit, float(length), fraction))
    return best[1], best[2]


def rest_correlation(products: NDArray[np.float64], length: float) -> tuple[float, float]:
    """Short length (px), and fraction a, of errors of gel at rest: `(1 - a) exp(-lag^2/(2 short^2)) + a exp(...)`.

    The second term falls off over the given length, as errors in a contact do. Products are at lags of 0, 1, 2 ... px.
    """
    if products[0] <= 0:
        return 0.0, 0.0
    lags = np.arange(1, len(products))
    wanted = products[1:] / products[0]
    far = np.exp(-(lags**2) / (2 * length**2))
    best = (np.inf, 0.0, 0.0)
    for short in np.geomspace(SHORTEST_PX, max(length / 2, SHORTEST_PX), 60):
        near = np.exp(-(lags**2) / (2 * short**2))
        fraction = float(
            np.clip((far - near) @ (wanted - near) / max((far - near) @ (far - near), 1e-30), 0, 1)
        )
        misfit = float(np.square(near + fraction * (far - near) - wanted).sum())
        best = min(best, (misfit, float(short), fraction))
    return best[1], best[2]


def press_residuals(
    press: PreparedPress, found: ContactCircle, frame: Step, noise: NDArray[np.float32]
) -> PressResiduals:
    """The slopes read on a held-out press and their errors; its center is free, because labels are off by a pixel."""
    rows, cols = press.pixels(found, 1.0)
    gradients = frame.gradients[rows, cols].astype(np.float64)
    error = score_slopes(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px).errors
    box = (int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1, 2)
    maps = np.full((2, *box), np.nan)
    for values, into in zip((gradients, error), maps):
        into[rows - rows.min(), cols - cols.min()] = values
    stated, residual = np.sqrt(frame.variance[rows, cols]), frame.residual[rows, cols]
    untouched = _untouched_slopes(press, found, frame.gradients, noise)
    return PressResiduals(maps[0], maps[1], stated, residual, rows, cols, *untouched)


def _untouched_slopes(
    press: PreparedPress, found: ContactCircle, gradients: NDArray[np.float32], noise: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float64]]:
    """Slopes (N, 2) read far from the contact, minus their median as in the Reconstructor, with the noise there.

    They are followed by the noise (N,), and by the slopes (rows, W, 2) of whole rows.
    """
    height, width = press.size.shape
    step = max(1, int(np.sqrt(height * width / PRESS_PIXELS)))
    apart = max(1, height // ROWS)
    y, x = np.ogrid[:height, :width]
    far = np.hypot(x - found.x_px, y - found.y_px) > (REST_DISTANCE + 1) * found.radius_px
    if press.usable is not None:
        far &= press.usable
    slopes = np.where(far[..., None], gradients, np.nan).astype(np.float64)
    some, bias = slopes[::step, ::step], np.zeros(2)
    there = np.isfinite(some[..., 0])
    known = some[there]
    if len(known):
        bias = np.median(known, axis=0)
    return known - bias, noise[::step, ::step][there], slopes[apart // 2 :: apart] - bias


def _lag_products(error: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Mean product of errors `lag * step` pixels apart along a row, for lags 0 .. LAGS-1."""
    width = error.shape[1]
    products = np.zeros(LAGS)
    for lag in range(min(LAGS, (width - 1) // step)):
        product = error[:, lag * step :] * error[:, : width - lag * step]
        known = np.isfinite(product)
        products[lag] = product[known].mean() if known.any() else 0.0
    return products
