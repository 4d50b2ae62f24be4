"""Errors on held-out presses, each reconstructed once by a calibration that was selected and fitted without it.

Some pixels of all presses are one table (`PIXEL`). It stays in the report of the run, unsaved; the report's statistics and
the factors of the deviation are made from it. The deviation by step and slope comes first, from slopes as the folds' models
read them, because it weighs the slopes that are solved.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gelform.arrays import Array, Map, Numbers
from gelform.calibration.circles.find import (
    LEAST_PIXELS,
    PRESS_PIXELS,
    REST_DISTANCE,
    ZONE,
    PreparedPress,
    change_settings,
    distances_px,
    scale_of,
)
from gelform.calibration.circles.locate import ROUNDS, Located, fit_model, recentered
from gelform.calibration.presses.press_set import Circle, Press
from gelform.calibration.selection import Candidate, Fitted, FittedSlopes, Fold, HeldOutPresses
from gelform.calibration_file import Calibration
from gelform.depth.sigma import squared_factor
from gelform.errors import Progress, no_progress
from gelform.image.background import PreparedBackground
from gelform.reconstruct import FrameRecord, Reconstructor
from gelform.result import Reconstruction
from gelform.result.metrics import (
    OFF_CONTACT,
    PressErrors,
    ball_center,
    ball_gradients,
    followed_radius,
    press_fit,
    score_slopes,
)
from gelform.slopes.budget import noise_at_rest
from gelform.slopes.color_models.forward_response import ForwardResponse, Step
from gelform.slopes.sigma import AT_REST, HELD_OUT, ONE_SIGMA, TWO_SIGMA, SlopeSigma

LENGTHS = 60  # correlation lengths that are tried
LAGS = 24  # steps, px at 240 rows; errors in a contact correlate over 3-10

# Pixels of presses, each solved by a model that has not seen its press.
PIXEL = np.dtype(
    [
        ("press", "i4"),  # index in its folder
        ("x_px", "f4"),
        ("y_px", "f4"),
        ("rho", "f8"),  # distance from the ball's center over the visible radius, or over `followed_radius`
        ("true", "f4", 2),  # the ball's slopes, mm/mm
        ("solved", "f4", 2),  # those of the solved depth
        ("stated", "f4"),  # standard deviation of the slopes as read; NaN if unknown
    ]
)


def table(columns: np.dtype[Any], rows: int, **values: Any) -> Array:
    """A structured array of so many rows, from the values of its columns."""
    made = np.empty(rows, columns)
    for name, column in values.items():
        made[name] = column
    return made


def by_press(pixels: Array) -> list[Array]:
    """The parts of a table that are of one press each, none of them empty."""
    parts = np.split(pixels, np.flatnonzero(np.diff(pixels["press"])) + 1)
    return [part for part in parts if len(part)]


def slope_sigma_from_folds(
    fits: Sequence[FittedSlopes], folds: Sequence[Fold], presses: Sequence[PreparedPress], noise: Map
) -> tuple[SlopeSigma, float]:
    """Standard deviation and correlation of the slopes, and the scale of the residual, on held-out presses.

    A fold's model has seen fewer presses than the final one, and is worse for it. So its errors are multiplied by the root
    of the fraction of presses, the rate at which errors of estimation fall. `noise` (H, W) is as `noise_at_rest` gives it.
    """
    step = max(1, round(scale_of(presses[0].size.shape)))
    measured = [
        press_errors_as_read(presses[i], fit.frame(presses[i]), noise, step)
        for fit, fold in zip(fits, folds)
        for i in fold.held_out
    ]
    contacts, at_rest, products, rest_products = zip(*measured)
    pixels = np.concatenate(contacts)
    pixels["error"] *= np.sqrt(fraction_trained(folds))
    length, fraction = correlation_from_products(np.mean(products, axis=0), step)
    rest_length, rest_fraction = rest_correlation(np.mean(rest_products, axis=0), length)
    fitted = SlopeSigma.fit(pixels, np.concatenate(at_rest), length, fraction)
    fitted = replace(fitted, rest_correlation_px=rest_length, rest_correlated_share=rest_fraction)
    # 95 % of squared residuals of 1 degree of freedom are below 3.84.
    return fitted, max(float(np.quantile(pixels["residual"], 0.95)) / 3.84, 1.0)


def fraction_trained(folds: Sequence[Fold]) -> float:
    """Mean fraction of the presses that train a fold's model."""
    return float(np.mean([len(f.training) / (len(f.training) + len(f.held_out)) for f in folds]))


def correlation_from_products(products: Numbers, step: float) -> tuple[float, float]:
    """Length (px) and fraction (0-1) of the correlated part of errors: `fraction exp(-lag^2 / (2 length^2))` from lag 1 on.

    The rest is white, with no correlation at the first lag. Products are at lags of 0, 1, 2 ... steps (px).
    """
    correlation = products / max(products[0], 1e-30)
    below = np.nonzero(correlation[1:] < 0.05)[0]
    last = max(3, int(below[0]) + 1 if below.size else LAGS)
    lags = step * np.arange(1, last)
    return _best_length(step * np.geomspace(0.7, LAGS, LENGTHS), lags, correlation[1:last])


def rest_correlation(products: Numbers, length: float) -> tuple[float, float]:
    """Short length (px), and fraction a, of errors of gel at rest: `(1 - a) exp(-lag^2/(2 short^2)) + a exp(...)`.

    The second term falls off over the given length, as errors in a contact do. Products are at lags of 0, 1, 2 ... px.
    """
    if products[0] <= 0:
        return 0.0, 0.0
    lags = np.arange(1, len(products))
    shortest = 0.3  # px, from what noise and blur cause on
    shorts = np.geomspace(shortest, max(length / 2, shortest), LENGTHS)
    far = np.exp(-(lags**2) / (2 * length**2))
    return _best_length(shorts, lags, products[1:] / products[0], far)


def _best_length(
    lengths: Numbers, lags: Array, wanted: Numbers, far: Numbers | None = None
) -> tuple[float, float]:
    """Length L and fraction a, 0-1, of `a g(L)` or `(1 - a) g(L) + a far` that are closest to a correlation at lags."""
    trials = []
    for length in lengths:
        shape = np.exp(-(lags**2) / (2 * length**2))
        base, along = (0.0 * shape, shape) if far is None else (shape, far - shape)
        fraction = float(np.clip(along @ (wanted - base) / max(along @ along, 1e-30), 0, 1))
        trials.append((float(np.square(base + fraction * along - wanted).sum()), float(length), fraction))
    return min(trials)[1:]


def press_errors_as_read(
    press: PreparedPress, frame: Step, noise: Map, step: int
) -> tuple[Array, Array, Numbers, Numbers]:
    """Some pixels of a held-out press (`HELD_OUT`), and some far from its contact (`AT_REST`), as a fold's model reads them.

    They are followed by the mean products of errors in the contact at lags of so many px, and at rest at lags of 1 px. The
    press's center is free, because labels are off by a pixel. At rest 0 is true, and the median is removed as in the
    Reconstructor.
    """
    found = press.found
    rows, cols = press.pixels(found, 1.0)
    gradients = frame.gradients[rows, cols].astype(np.float64)
    error = score_slopes(gradients, cols, rows, (found.x_px, found.y_px), press.ball_radius_px).errors
    box = np.full((int(np.ptp(rows)) + 1, int(np.ptp(cols)) + 1, 2), np.nan)
    box[rows - rows.min(), cols - cols.min()] = error
    thin = slice(None, None, max(1, len(rows) // PRESS_PIXELS))
    rows, cols = rows[thin], cols[thin]
    pixels = table(
        HELD_OUT,
        len(rows),
        slope=np.linalg.norm(gradients[thin], axis=-1),
        error=error[thin],
        stated=np.sqrt(frame.variance[rows, cols]),
        residual=frame.residual[rows, cols],
    )
    height, width = press.size.shape
    # Steps between the pixels at rest, and between the eight rows that tell how errors there correlate.
    every, apart = max(1, int(np.sqrt(height * width / PRESS_PIXELS))), max(1, height // 8)
    far = distances_px(press.size.shape, found.x_px, found.y_px) > (REST_DISTANCE + 1) * found.radius_px
    if press.usable is not None:
        far &= press.usable
    slopes = np.where(far[..., None], frame.gradients, np.nan).astype(np.float64)
    there = np.isfinite(slopes[::every, ::every, 0])
    known = slopes[::every, ::every][there]
    bias = np.median(known, axis=0) if len(known) else np.zeros(2)
    rest = table(AT_REST, len(known), error=known - bias, noise=noise[::every, ::every][there])
    return pixels, rest, _lag_products(box, step), _lag_products(slopes[apart // 2 :: apart] - bias, 1)


def _lag_products(error: Numbers, step: int) -> Numbers:
    """Mean product of errors `lag * step` pixels apart along a row, for lags 0 .. LAGS-1."""
    width = error.shape[1]
    products = np.zeros(LAGS)
    for lag in range(min(LAGS, (width - 1) // step)):
        product = error[:, lag * step :] * error[:, : width - lag * step]
        known = np.isfinite(product)
        products[lag] = product[known].mean() if known.any() else 0.0
    return products


@dataclass(frozen=True)
class Judged:
    """The errors of a fit on held-out presses."""

    # index of the press -> its errors through the whole path, with the candidate selected without its fold
    errors: Mapping[int, PressErrors]
    # the same by the saved model's kind, settings and zone, fitted without its fold
    saved_errors: Mapping[int, PressErrors]
    pixels: Array  # (N,) some of each press (`PIXEL`), with the candidate selected without its fold
    # index of the press -> (h, w) depth minus the ball's cap in the contact's box, as `errors_of` gives it
    caps_um: Mapping[int, Map]
    # standard deviation of the slopes of the chosen color model, and of those of the solved depth
    slope_sigma: SlopeSigma
    forward: ForwardResponse  # its residuals in the unit of those of held-out presses
    # index of the press -> standard deviations, px, of its circle's center and radius
    circle_sigmas: Mapping[int, tuple[float, float]]


def measure_held_out(fitted: Fitted, *, progress: Progress = no_progress) -> Judged:
    """Errors of every usable press with the candidate selected and fitted without its fold, and the deviation of slopes.

    The deviation of slopes as read comes from the errors of the folds' models, that of the solved depth's slopes from the
    errors of the reconstructed presses.
    """
    held_out, chosen, draft = fitted.held_out, fitted.selection.chosen, fitted.calibration
    folds, located = held_out.folds, held_out.located
    prepared, _ = held_out.prepared_for(chosen)
    fits = [held_out.fit(fold, [chosen])[0] for fold in folds]
    model = draft.color_model.prepare(draft.background, draft.image_shape)
    untouched = PreparedBackground(draft.background, draft.change)
    noise = noise_at_rest(model, untouched, draft.settings.image_noise)
    sigma, residual_scale = slope_sigma_from_folds(fits, folds, prepared, noise)
    assert draft.forward is not None
    forward = replace(draft.forward, residual_scale=residual_scale)
    # Held-out presses show what slopes there are; what these have in common counts in units of the error still to be found.
    unlimited = replace(sigma, shown=(1e3, 1e3), gain_sigma=1.0)
    draft = replace(draft, forward=forward, slope_sigma=unlimited)
    measured, saved, far = {}, {}, []
    for done, (fold, candidate) in enumerate(zip(folds, fitted.selection.by_fold)):
        for one in dict.fromkeys((candidate, chosen)):
            for i, circle, record, result in _reconstructed(draft, held_out, one, fold):
                how = circle, result, draft.known_mm_per_px, prepared[i].contact_radius_ratio
                press = errors_of(i, located.presses.presses[i], *how, stated=record.budget.read)
                if one == candidate:
                    measured[i] = press
                if one == chosen:  # the law of its slopes does not hold for another candidate's
                    saved[i] = press
                    far.append(_far_depth(record, circle))
        progress(done + 1, len(folds), "measuring on held-out presses")
    trained, ratio = fraction_trained(folds), draft.settings.contact_radius_ratio
    own = np.concatenate([pixels for _, pixels, _ in saved.values()])
    return Judged(
        {i: errors for i, (errors, _, _) in measured.items()},
        {i: errors for i, (errors, _, _) in saved.items()},
        np.concatenate([pixels for _, pixels, _ in measured.values()]),
        {i: cap_um for i, (_, _, cap_um) in measured.items()},
        with_factors(sigma, own, far, trained, ratio),
        forward,
        circle_sigmas(located, folds),
    )


def _reconstructed(
    draft: Calibration, held_out: HeldOutPresses, candidate: Candidate, fold: Fold
) -> Iterator[tuple[int, Circle, FrameRecord, Reconstruction]]:
    """Index, circle, record and result of each press of a fold, by a calibration that was fitted without the fold."""
    known, presses = draft.forward, held_out.located.presses
    ((reader, forward),) = held_out.fit(fold, [candidate])
    change = change_settings(presses, candidate.change_offset)
    prepared, _ = held_out.prepared_for(candidate)
    assert known is not None
    own = replace(known, step_sigma=None) if forward is None else forward
    own = replace(own, clipped=known.clipped, residual_scale=known.residual_scale)
    reconstruct = Reconstructor(replace(draft, color_model=reader.model, forward=own, change=change))
    for i in fold.held_out:
        record = reconstruct.record(presses.presses[i].image)
        result = reconstruct.result(record)
        # The circle found in the press alone, with the center of the solved slopes; its radius is not refined.
        found = prepared[i].found
        rows, cols = prepared[i].pixels(found, ZONE, PRESS_PIXELS)
        start, radius = (found.x_px, found.y_px), prepared[i].ball_radius_px
        center = ball_center(result.gradients[rows, cols], cols, rows, start, radius)
        yield i, (*center, found.radius_px), record, result


def errors_of(
    index: int,
    press: Press,
    circle_px: Circle,
    result: Reconstruction,
    mm_per_px: float,
    contact_radius_ratio: float,
    *,
    stated: Map | None = None,
) -> tuple[PressErrors, Array, Map]:
    """Errors of a reconstructed press with a visible circle (center x, y, radius, px), its pixels, and depth minus the cap.

    About `PRESS_PIXELS` pixels (`PIXEL`) up to the visible rim, about the fitted center as in `press_errors`. `stated`
    (H, W) is the deviation of the slopes as read. Depth minus the ball's cap is (h, w), um, in the contact's box, of mean 0
    and NaN outside it; empty if the fitted ball lies outside the frame.
    """
    ball_mm = press.ball_diameter_mm / 2
    fit = press_fit(result.depth_mm, result.gradients, circle_px, ball_mm, mm_per_px, contact_radius_ratio)
    ball_px, center = ball_mm / mm_per_px, fit.center_px
    y, x = np.ogrid[: result.shape[0], : result.shape[1]]
    rows, cols = np.nonzero(np.hypot(x - center[0], y - center[1]) < fit.reach_px)
    thin = (cols + 3 * rows) % max(-(-len(rows) // PRESS_PIXELS), 1) == 0
    rows, cols = rows[thin], cols[thin]
    pixels = table(
        PIXEL,
        len(rows),
        press=index,
        x_px=cols,
        y_px=rows,
        rho=np.hypot(cols - center[0], rows - center[1]) / followed_radius(circle_px[2], ball_px),
        true=ball_gradients(cols, rows, center, ball_px),
        solved=result.gradients[rows, cols],
        stated=np.nan if stated is None else stated[rows, cols],
    )
    square = (x - fit.surface_center_px[0]) ** 2 + (y - fit.surface_center_px[1]) ** 2
    error = 1e3 * (result.depth_mm - mm_per_px * np.sqrt(np.maximum(ball_px**2 - square, 0)))
    region = square < fit.reach_px**2
    if not region.any():
        return fit.errors, pixels, np.empty((0, 0), dtype=np.float32)
    cap_um: Map = np.where(region, error - error[region].mean(), np.nan).astype(np.float32)
    rows, cols = np.nonzero(region)
    return fit.errors, pixels, cap_um[rows.min() : rows.max() + 1, cols.min() : cols.max() + 1]


def with_factors(
    sigma: SlopeSigma, pixels: Array, far: Sequence[Map], trained: float, contact_radius_ratio: float | None
) -> SlopeSigma:
    """The deviation of slopes with the factors of the solved depth's slopes and of depth, and the common error of slopes.

    As in `slope_sigma_from_folds`, the common error is multiplied by the root of the fraction of presses that a fold has
    seen; the factors are those of the folds, because little of the other errors falls with more presses. `pixels` are
    `PIXEL`, `far` what `depth_factor` takes.
    """
    inner = pixels[pixels["rho"] < (contact_radius_ratio or 1.0)]
    sigma = replace(sigma, gain_sigma=float(np.sqrt(trained)) * common_error(inner, sigma))
    sigma = sigma.with_solved(inner["solved"] - inner["true"], inner["stated"])
    return replace(sigma, depth_factor=depth_factor(far, sigma.gain_sigma, sigma.depth_factor))


def depth_factor(far: Sequence[Map], gain_sigma: float, usual: float) -> float:
    """The smallest factor that leaves 68 % of depth far from contacts within one sigma and 95 % within two.

    `far` has (4, N) for each press, mm^2: squared depth, twice that of negative depths, the variance by the slopes and a
    factor of 1, and that which slopes have in common for a `gain_sigma` of 1. Presses count alike; some may have no pixels.
    """
    far = [one for one in far if one.size]
    if not far:
        return usual
    sizes = np.array([np.mean(one[0] / one[2]) for one in far])
    # Something lay on the gel where a press has over 5 times the usual RMS.
    some = [one for one, size in zip(far, sizes) if size <= 25 * np.median(sizes)]
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


def _far_depth(record: FrameRecord, circle_px: Circle) -> Map:
    """What `depth_factor` takes of each seventh pixel at rest beyond 2.5 radii of a contact; (4, 0) for too few pixels."""
    errors = record.depth_errors
    assert errors is not None
    far = record.known & (distances_px(record.depth_mm.shape, *circle_px[:2]) > OFF_CONTACT * circle_px[2])
    unit = errors.spread / record.fixed.slope_sigma.depth_factor**2
    maps = (errors.coarse.at_pixels(one) for one in (errors.own, unit, np.square(errors.common_mm)))
    found = np.stack([one[far][::7] for one in (np.square(record.depth_mm), *maps)])
    return found if found.shape[1] >= LEAST_PIXELS else found[:, :0]


def at_pixels(values: Map, pixels: Array) -> Map:
    """A map (H, W) at the places of a table."""
    return values[pixels["y_px"].astype(np.intp), pixels["x_px"].astype(np.intp)]


def common_error(pixels: Array, sigma: SlopeSigma) -> float:
    """Relative error that slopes of one size share around a press, RMS, beyond what errors of single slopes explain.

    A ball has slopes of all sizes, whose errors partly cancel in its height. Another object may stand on slopes of one size.
    """
    if not pixels.size:
        return 0.0
    single = float(np.quantile(np.abs(pixels["solved"] - pixels["true"]), ONE_SIGMA)) ** 2
    squares = [square for press in by_press(pixels) for square in _ring_squares(press, sigma, single)]
    return max(sum(squares) / max(len(squares), 1), 0.0) ** 0.5


def _ring_squares(press: Array, sigma: SlopeSigma, single: float) -> Iterator[float]:
    """Square of each ring's mean error along the slope, less that of errors of variance `single`, over its slope's square.

    Rings are equal steps of slope: for each of their sizes an object of its own. In the innermost one slopes are too gentle
    for a relative error.
    """
    count = 6
    slopes = np.linalg.norm(press["true"].astype(np.float64), axis=1)
    rings = np.digitize(slopes, np.linspace(0, slopes.max(), count + 1)[1:-1])
    for ring in range(1, count):
        member = np.flatnonzero(rings == ring)
        if len(member) < 10:
            continue
        pixels, size = press[member], slopes[member]
        along = pixels["true"] / size[:, None]
        error = float(np.sum((pixels["solved"] - pixels["true"]) * along, axis=1).mean())
        some = slice(None, None, -(-len(pixels) // 200))  # pixels of which pairs are taken
        x, y = pixels["x_px"][some], pixels["y_px"][some]
        square_px = (x[:, None] - x) ** 2 + (y[:, None] - y) ** 2
        alike = np.exp(-square_px / (2 * sigma.correlation_px**2)) * (along[some] @ along[some].T)
        share = sigma.correlated_share
        explained = single * (share * float(alike.mean()) + (1 - share) / len(pixels))
        yield (error**2 - explained) / float(size.mean()) ** 2


def circle_sigmas(located: Located, folds: Sequence[Fold]) -> dict[int, tuple[float, float]]:
    """Standard deviations, px, of each accepted press's center (either axis) and of its visible radius.

    It is a delete-a-group jackknife (B. Efron, The Jackknife, SIAM 1982, eq. 3.6) of the joint refinement: each circle is
    refined without each fold; without its own fold, it is fitted to a model that has not seen it. An error common to all
    refinements is not in it; on simulated presses distances to the truth are about 1.5 times as large.
    """
    circles: dict[int, list[Circle]] = {}
    for fold in folds:
        for i, contact in zip(fold.training, fold.contacts):
            circles.setdefault(i, []).append(contact.circle_px)
        if fold.training:
            model = fit_model([located.prepared[i] for i in fold.training], fold.contacts, located.refined_by)
            for i in fold.held_out:
                contact = located.prepared[i].found
                for _ in range(ROUNDS):
                    contact = recentered(located.prepared[i], contact, model)
                circles.setdefault(i, []).append(contact.circle_px)
    return {i: _jackknife(np.array(known)) for i, known in circles.items() if len(known) > 1}


def _jackknife(circles: Numbers) -> tuple[float, float]:
    count = len(circles)
    variance = (count - 1) / count * np.sum((circles - circles.mean(axis=0)) ** 2, axis=0)
    return float(np.sqrt(variance[:2].mean())), float(np.sqrt(variance[2]))
