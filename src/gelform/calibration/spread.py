"""How far off held-out slopes are: their standard deviation as a function of slope, and their correlation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses import Contact, scale_of
from gelform.calibration.samples import PreparedPress
from gelform.calibration.select import Fold
from gelform.color_models import ColorModel
from gelform.confidence import SlopeSigma
from gelform.metrics import ball_center, ball_gradients

LAGS = 24


def slope_sigma_from_folds(
    models: Sequence[ColorModel],
    folds: Sequence[Fold],
    presses: Sequence[PreparedPress],
    found: Sequence[Contact],
) -> SlopeSigma:
    """Standard deviation and correlation length of the slopes, from presses that each model has not seen."""
    step = max(1, round(scale_of(presses[0].size.shape)))
    slopes, errors, products = [], [], np.zeros(LAGS)
    for model, fold in zip(models, folds):
        for i in fold.held_out:
            seen, error = _residual_map(presses[i], found[i], model)
            inside = np.isfinite(error[..., 0])
            slopes.append(np.linalg.norm(seen[inside], axis=-1)[::5])
            errors.append(error[inside][::5])
            products += _lag_products(error, step)
    below = np.nonzero(products < products[0] / np.e)[0]
    lag = step * (int(below[0]) if below.size else LAGS - 1)
    return SlopeSigma.fit(np.concatenate(slopes), np.concatenate(errors), float(max(1, lag)))


def _residual_map(
    press: PreparedPress, found: Contact, model: ColorModel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Slopes and their errors in the contact's bounding box, NaN outside its inner 90 %; the centre is free."""
    rows, cols = press.pixels(found, 0.9)
    gradients = press.gradients(model, rows, cols)
    center = ball_center(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px)
    error = gradients - ball_gradients(cols, rows, center, press.ball_radius_px)
    box = (int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1, 2)
    maps = np.full((2, *box), np.nan)
    for values, into in zip((gradients, error), maps):
        into[rows - rows.min(), cols - cols.min()] = values
    return maps[0], maps[1]


def _lag_products(error: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Mean product of errors `lag * step` pixels apart along a row, for lags 0 .. LAGS-1."""
    width = error.shape[1]
    products = np.zeros(LAGS)
    for lag in range(min(LAGS, (width - 1) // step)):
        product = error[:, lag * step :] * error[:, : width - lag * step]
        known = np.isfinite(product)
        products[lag] = product[known].mean() if known.any() else 0.0
    return products
