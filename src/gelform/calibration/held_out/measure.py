"""Errors on held-out presses, each reconstructed once without itself; their standard deviation by step and slope.

Errors on held-out presses: each is reconstructed once, by a calibration selected and fitted without it.

Some of its pixels are kept with their slopes, the ball's own slopes, and the depth minus the cap. They stay in the report
of the run, unsaved; the report's statistics are binned from them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.candidates import Candidate, FittedSlopes
from gelform.calibration.circles.find import (
    PRESS_PIXELS,
    REST_DISTANCE,
    ZONE,
    ContactCircle,
    PreparedPress,
    scale_of,
)
from gelform.calibration.circles.prepare import change_settings
from gelform.calibration.fitted import Fitted
from gelform.calibration.held_out.scores import Fold, circle_sigmas
from gelform.calibration.presses.press_set import Press
from gelform.calibration_file import Calibration
from gelform.depth.sigma import squared_factor
from gelform.foundations.findings import Progress, no_progress
from gelform.image.background import PreparedBackground
from gelform.reconstruct import FrameRecord, Reconstructor
from gelform.result import Reconstruction
from gelform.result.metrics import (
    STEEPEST_FRACTION,
    PressErrors,
    ball_center,
    ball_gradients,
    followed_radius,
    press_errors,
    score_slopes,
)
from gelform.slopes.budget import noise_at_rest
from gelform.slopes.color_models import ForwardResponse
from gelform.slopes.color_models.forward_response import Step
from gelform.slopes.sigma import ONE_SIGMA, TWO_SIGMA, SlopeErrors, SlopeSigma

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


# Rings of equal steps of slope in a contact: for each of their sizes an object of its own. Pixels, least for a mean, most
# for pairs of them.
RINGS, RING_PIXELS = 6, (10, 200)
ANY_SLOPE = 1e3, 1e3  # mm/mm, beyond any
# Contact radii from which on depth is judged at rest, pixels of it that are enough for a press, every one of so many of
# them, and times the usual RMS of a press above which something else lay on the gel.
FAR_RADII, LEAST_FAR_PX, EVERY_FAR, MOST_FAR = 2.5, 200, 7, 5.0


@dataclass(frozen=True, eq=False)
class HeldOutSample:
    """Pixels of one press, reconstructed with a model that has not seen it; the ball's center is free.

    Attributes
    ----------
    index : of the press in its folder
    circle_px : (center x, center y, contact radius), px; for a deep press, the radius that the gel follows
    x_px, y_px : (N,) float32, inside the contact, 3 px (at 240 rows) inside its rim
    true_gradients, gradients : (N, 2) float32, the ball's slopes there and the reconstructed ones
    cap_error_um : (h, w) float32, depth minus the ball's cap in the contact's box, mean 0, NaN outside it;
        empty if the fitted ball lies outside the frame
    """

    index: int
    circle_px: tuple[float, float, float]
    x_px: NDArray[np.float32]
    y_px: NDArray[np.float32]
    true_gradients: NDArray[np.float32]
    gradients: NDArray[np.float32]
    cap_error_um: NDArray[np.float32]

    @property
    def errors(self) -> NDArray[np.float32]:
        """(N, 2) reconstructed minus true slopes."""
        return self.gradients - self.true_gradients

    def inside(self, zone: float) -> NDArray[np.bool_]:
        """Which pixels (N,) are inside a fraction of the contact radius."""
        x, y, radius = self.circle_px
        return np.hypot(self.x_px - x, self.y_px - y) < zone * radius

    def within(self, zone: float) -> HeldOutSample:
        """The pixels inside a fraction of the contact radius."""
        keep = self.inside(zone)
        kept = {name: getattr(self, name)[keep] for name in ("x_px", "y_px", "true_gradients", "gradients")}
        return replace(self, **kept)


@dataclass(frozen=True)
class Judged:
    """The errors of a fit on held-out presses.

    Attributes
    ----------
    errors : index of the press -> its errors through the whole path, with the candidate selected without its fold
    saved_errors : the same by the saved model's kind, settings and zone, fitted without its fold
    samples : some pixels of each press
    slope_sigma : standard deviation of the slopes of the chosen color model, and of those of the solved depth
    forward : the forward response, its residuals in the unit of those of held-out presses
    circle_sigmas : index of the press -> standard deviations, px, of its circle's center and radius
    """

    errors: Mapping[int, PressErrors]
    saved_errors: Mapping[int, PressErrors]
    samples: tuple[HeldOutSample, ...]
    slope_sigma: SlopeSigma
    forward: ForwardResponse
    circle_sigmas: Mapping[int, tuple[float, float]]


def measure_held_out(fitted: Fitted, *, progress: Progress = no_progress) -> Judged:
    """Errors of every usable press with the candidate selected and fitted without its fold, and the deviation of slopes.

    The deviation of slopes as read comes from the errors of the folds' models, that of the solved depth's slopes from the
    errors of the reconstructed presses.
    """
    errors: dict[int, PressErrors] = {}
    saved_errors: dict[int, PressErrors] = {}
    samples: list[HeldOutSample] = []
    held_out, chosen, draft = fitted.held_out, fitted.selection.chosen, fitted.calibration
    prepared, folds = held_out.presses[chosen.change_offset], held_out.folds
    fits = held_out.fitted(chosen)
    model = draft.color_model.prepare(draft.background, draft.image_shape)
    untouched = PreparedBackground(draft.background, draft.change)
    noise = noise_at_rest(model, untouched, draft.settings.image_noise)
    sigma, residual_scale = slope_sigma_from_folds(fits, folds, prepared, held_out.found, noise)
    assert draft.forward is not None
    forward = replace(draft.forward, residual_scale=residual_scale)
    # Held-out presses show what slopes there are; what these have in common counts in units of the error still to be found.
    unlimited = replace(sigma, shown=ANY_SLOPE, gain_sigma=1.0)
    draft = replace(draft, forward=forward, slope_sigma=unlimited)
    own: list[HeldOutSample] = []
    stated: list[NDArray[np.float32]] = []
    far: list[NDArray[np.float32]] = []
    for done, (fold, candidate) in enumerate(zip(folds, fitted.selection.by_fold)):
        runs = [(candidate, errors)]
        if candidate != chosen:
            runs.append((chosen, saved_errors))
        for one, into in runs:
            for i, circle, record, result in _reconstructed(draft, fitted, one, fold):
                press = fitted.located.presses.presses[i]
                measured = press, circle, result, draft.known_mm_per_px, prepared[i].contact_radius_ratio
                into[i] = errors_of(*measured)
                sample = sample_of(i, *measured)
                if into is errors:
                    samples.append(sample)
                if one == chosen:  # the law of its slopes does not hold for another candidate's
                    own.append(sample)
                    stated.append(at_sample(record.budget.read, sample))
                    far.append(_far_depth(record, circle))
        if candidate == chosen:
            saved_errors |= {i: errors[i] for i in fold.held_out if i in errors}
        progress(done + 1, len(folds), "measuring on held-out presses")
    return Judged(
        errors,
        saved_errors,
        tuple(samples),
        with_factors(sigma, own, stated, far, fraction_trained(folds), draft.settings.contact_radius_ratio),
        forward,
        circle_sigmas(fitted.located.prepared, held_out.found, folds, fitted.located.refined_by),
    )


def _reconstructed(
    draft: Calibration, fitted: Fitted, candidate: Candidate, fold: Fold
) -> Iterator[tuple[int, tuple[float, float, float], FrameRecord, Reconstruction]]:
    """Index, circle, record and result of each press of a fold, by a calibration that was fitted without the fold."""
    held_out, presses, known = fitted.held_out, fitted.located.presses, draft.forward
    ((reader, forward),) = held_out.fit(fold, [candidate])
    change = change_settings(presses, candidate.change_offset)
    assert known is not None
    own = replace(known, step_sigma=None) if forward is None else forward
    own = replace(own, clipped=known.clipped, residual_scale=known.residual_scale)
    reconstruct = Reconstructor(replace(draft, color_model=reader.model, forward=own, change=change))
    for i in fold.held_out:
        record, albedo = reconstruct.record(presses.presses[i].image)
        result = reconstruct.result(record, albedo)
        circle = _free_circle(held_out.presses[candidate.change_offset][i], held_out.found[i], result)
        yield i, circle, record, result


def _free_circle(
    press: PreparedPress, found: ContactCircle, result: Reconstruction
) -> tuple[float, float, float]:
    """The circle found in the held-out press alone, with the center of the solved slopes; its radius is not refined."""
    rows, cols = press.pixels(found, ZONE, PRESS_PIXELS)
    start = found.x_px, found.y_px
    x, y = ball_center(result.gradients[rows, cols], cols, rows, start, press.ball_radius_px)
    return x, y, found.radius_px


def errors_of(
    press: Press,
    circle_px: tuple[float, float, float],
    result: Reconstruction,
    mm_per_px: float,
    contact_radius_ratio: float,
) -> PressErrors:
    """Errors of a reconstructed press whose visible circle (center x, center y, radius, px) is known."""
    return press_errors(
        result.depth_mm,
        result.gradients,
        circle_px=circle_px,
        ball_radius_mm=press.ball_diameter_mm / 2,
        mm_per_px=mm_per_px,
        contact_radius_ratio=contact_radius_ratio,
    )


def sample_of(
    index: int,
    press: Press,
    circle_px: tuple[float, float, float],
    result: Reconstruction,
    mm_per_px: float,
    contact_radius_ratio: float,
    *,
    max_pixels: int = PRESS_PIXELS,
) -> HeldOutSample:
    """Pixels of a reconstructed press for its errors, up to the visible rim; about `max_pixels`.

    That region and the free centers, fitted inside the contact edge, are those of `gelform.result.metrics.press_errors`.
    """
    ball_px = press.ball_diameter_mm / 2 / mm_per_px
    height, width = result.depth_mm.shape
    followed = followed_radius(circle_px[2], ball_px)
    reach = min(followed - 3 * min(height, width) / 240, STEEPEST_FRACTION * ball_px)
    y, x = np.mgrid[:height, :width]
    start = circle_px[:2]
    inside = np.hypot(x - start[0], y - start[1]) < min(contact_radius_ratio * followed, reach)
    center = ball_center(result.gradients[inside], x[inside], y[inside], start, ball_px)
    rows, cols = _thinned(np.hypot(x - center[0], y - center[1]) < reach, max_pixels)
    return HeldOutSample(
        index,
        (*center, followed),
        cols.astype(np.float32),
        rows.astype(np.float32),
        ball_gradients(cols, rows, center, ball_px).astype(np.float32),
        result.gradients[rows, cols],
        _cap_error_um(result.depth_mm, inside, start, reach, ball_px, mm_per_px),
    )


def _thinned(region: NDArray[np.bool_], count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of at most about `count` pixels of a region, on a regular lattice."""
    rows, cols = np.nonzero(region)
    stride = -(-len(rows) // count)
    keep = (cols + 3 * rows) % max(stride, 1) == 0
    return rows[keep], cols[keep]


def _cap_error_um(
    depth_mm: NDArray[Any],
    inside: NDArray[np.bool_],
    start_px: tuple[float, float],
    reach_px: float,
    ball_px: float,
    mm_per_px: float,
) -> NDArray[np.float32]:
    """Depth minus the cap of a ball whose center is fitted to the slopes of the depth, in the contact's box."""
    along_y, along_x = np.gradient(depth_mm.astype(np.float64), mm_per_px)
    slopes = np.stack([along_x, along_y], axis=-1)[inside]
    y, x = np.mgrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    center = ball_center(slopes, x[inside], y[inside], start_px, ball_px)
    square = (x - center[0]) ** 2 + (y - center[1]) ** 2
    error = 1e3 * (depth_mm - mm_per_px * np.sqrt(np.maximum(ball_px**2 - square, 0)))
    region = square < reach_px**2
    if not region.any():
        return np.empty((0, 0), dtype=np.float32)
    error = np.where(region, error - error[region].mean(), np.nan).astype(np.float32)
    rows, cols = np.nonzero(region)
    box: NDArray[np.float32] = error[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]
    return box


def with_factors(
    sigma: SlopeSigma,
    samples: Sequence[HeldOutSample],
    stated: Sequence[NDArray[np.float32]],
    far: Sequence[NDArray[np.float32]],
    trained: float,
    contact_radius_ratio: float | None,
) -> SlopeSigma:
    """The deviation of slopes with the factors of the solved depth's slopes and of depth, and the common error of slopes.

    As in `slope_sigma_from_folds`, the common error is multiplied by the root of the fraction of presses that a fold has
    seen; the factors are those of the folds, because little of the other errors falls with more presses. `stated` are the
    deviations of the slopes as read at the samples' pixels, `far` what `depth_factor` takes.
    """
    ratio = contact_radius_ratio or 1.0
    kept = [one.inside(ratio) for one in samples]
    inner = [one.within(ratio) for one in samples]
    sigma = replace(sigma, gain_sigma=float(np.sqrt(trained)) * common_error(inner, sigma))
    errors = np.concatenate([one.errors for one in inner])
    sigma = sigma.with_solved(errors, np.concatenate([one[k] for one, k in zip(stated, kept)]))
    return replace(sigma, depth_factor=depth_factor(far, sigma.gain_sigma, sigma.depth_factor))


def depth_factor(far: Sequence[NDArray[np.float32]], gain_sigma: float, usual: float) -> float:
    """The smallest factor that leaves 68 % of depth far from contacts within one sigma and 95 % within two.

    `far` has (4, N) for each press, mm^2: squared depth, twice that of negative depths, the variance by the slopes and a
    factor of 1, and that which slopes have in common for a `gain_sigma` of 1. Presses count alike; some may have no pixels.
    """
    far = [one for one in far if one.size]
    if not far:
        return usual
    sizes = np.array([np.mean(one[0] / one[2]) for one in far])
    some = [one for one, size in zip(far, sizes) if size <= MOST_FAR**2 * np.median(sizes)]
    weights = np.concatenate([np.full(one.shape[1], 1 / one.shape[1]) for one in some]) / len(some)
    square, own, unit, common = np.concatenate(some, axis=1)
    common *= np.float32(gain_sigma**2)
    needed = 1.0
    for sigmas, wanted in ((1, ONE_SIGMA), (2, TWO_SIGMA)):
        factors = squared_factor(square / sigmas**2 - common, own, unit)
        order = np.argsort(factors)
        enough = int(np.searchsorted(np.cumsum(weights[order]), wanted))
        needed = max(needed, float(np.sqrt(factors[order[min(enough, len(order) - 1)]])))
    return needed


def _far_depth(record: FrameRecord, circle_px: tuple[float, float, float]) -> NDArray[np.float32]:
    """What `depth_factor` takes of the pixels at rest far from a contact; (4, 0) if they are few."""
    errors = record.depth_errors
    assert errors is not None
    height, width = record.depth_mm.shape
    y, x = np.ogrid[:height, :width]
    far = record.known & (np.hypot(x - circle_px[0], y - circle_px[1]) > FAR_RADII * circle_px[2])
    if np.count_nonzero(far) < LEAST_FAR_PX:
        return np.empty((4, 0), dtype=np.float32)
    unit = errors.spread / record.depth_factor**2
    maps = (errors.coarse.at_pixels(one) for one in (errors.own, unit, np.square(errors.common_mm)))
    return np.stack([one[far][::EVERY_FAR] for one in (np.square(record.depth_mm), *maps)])


def at_sample(values: NDArray[np.float32], sample: HeldOutSample) -> NDArray[np.float32]:
    """A map (H, W) at the pixels of a sample."""
    return values[sample.y_px.astype(np.intp), sample.x_px.astype(np.intp)]


def common_error(samples: Sequence[HeldOutSample], sigma: SlopeSigma) -> float:
    """Relative error that slopes of one size share around a press, RMS, beyond what errors of single slopes explain.

    A ball has slopes of all sizes, whose errors partly cancel in its height. Another object may stand on slopes of one size.
    """
    errors = [np.abs(one.errors) for one in samples if len(one.x_px)]
    if not errors:
        return 0.0
    single = float(np.quantile(np.concatenate(errors), ONE_SIGMA)) ** 2
    squares = [square for one in samples if len(one.x_px) for square in _ring_squares(one, sigma, single)]
    return max(sum(squares) / max(len(squares), 1), 0.0) ** 0.5


def _ring_squares(sample: HeldOutSample, sigma: SlopeSigma, single: float) -> Iterator[float]:
    """Square of each ring's mean error along the slope, less that of errors of variance `single`, over its slope's square.

    In the innermost ring slopes are too gentle for a relative error.
    """
    slopes = np.linalg.norm(sample.true_gradients.astype(np.float64), axis=1)
    rings = np.digitize(slopes, np.linspace(0, slopes.max(), RINGS + 1)[1:-1])
    for ring in range(1, RINGS):
        pixels = np.flatnonzero(rings == ring)
        if len(pixels) < RING_PIXELS[0]:
            continue
        along = sample.true_gradients[pixels] / slopes[pixels, None]
        error = float(np.sum(sample.errors[pixels] * along, axis=1).mean())
        some = slice(None, None, -(-len(pixels) // RING_PIXELS[1]))
        x, y = sample.x_px[pixels][some], sample.y_px[pixels][some]
        square_px = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
        alike = np.exp(-square_px / (2 * sigma.correlation_px**2)) * (along[some] @ along[some].T)
        share = sigma.correlated_share
        explained = single * (share * float(alike.mean()) + (1 - share) / len(pixels))
        yield (error**2 - explained) / float(slopes[pixels].mean()) ** 2
