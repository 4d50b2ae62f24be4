"""Standard deviation of a slope by its size and place, fitted to errors on held-out presses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.foundations.checks import check_values, check_within

SLOPE_BINS = 10  # bins of equal counts; the law is linear between them
PLACES = (3, 4)  # rows and columns of the factors by place
ONE_SIGMA = 0.6827  # fraction of a normal distribution within one standard deviation
MIN_IN_BIN = 50  # pixels; fewer do not determine a quantile
CLEAN_FRACTION = 0.95  # fraction of the pixels in contact whose confidence is 1
PRIOR_PRESSES = 2.0  # presses; a place's own factor counts by its number of presses over this
LAW_ROUNDS = 3  # rounds of law and factors, each computed from the other
LEAST_FACTOR = 0.3  # smallest factor of a place, over the law or the predicted deviation
# mm/mm between the slopes of neighboring solved factors; largest such factor.
LEAST_APART, MOST_FACTOR = 1e-6, 1e3

_RANGES = (
    ("rest", 1e-9, 1e3),
    ("rest_per_noise", 0, 1e3),
    ("full_confidence_sigma", 1e-9, 1e3),
    ("correlation_px", 1e-6, 1e4),
    ("correlated_share", 0, 1),
    ("gain_sigma", 0, 10),
    ("rest_correlation_px", 0, 1e4),
)


@dataclass(frozen=True)
class SlopeErrors:
    """Errors of slopes on presses that the model has not seen.

    Attributes
    ----------
    slopes : (N,) measured |gradient| in contact
    errors : (N, 2) of its components
    x, y : (N,) position in the frame, 0-1
    press : (N,) index of the press, because pixels of one press are not independent
    rest : (M, 2) slopes read at rest, without their bias; they are all error
    rest_noise : (M,) variance there from the image's noise, by `noise_at_rest`
    stated : (N,) standard deviation by the step of the forward response; 1 without a step
    """

    slopes: NDArray[Any]
    errors: NDArray[Any]
    x: NDArray[Any]
    y: NDArray[Any]
    press: NDArray[Any]
    rest: NDArray[Any]
    rest_noise: NDArray[Any]
    stated: NDArray[Any] | float = 1.0


@dataclass(frozen=True)
class SolvedErrors:
    """Errors of solved slopes on presses that the model has not seen.

    Attributes
    ----------
    slopes : (N,) |gradient| of the solved depth
    errors : (N, 2) of its components
    predicted : (N,) standard deviation by a `SolvedSigma` without factors
    extra : (N,) the part of it that does not come from the slopes as read
    x, y : (N,) position in the frame, 0-1
    press : (N,) index of the press
    """

    slopes: NDArray[Any]
    errors: NDArray[Any]
    predicted: NDArray[Any]
    extra: NDArray[Any]
    x: NDArray[Any]
    y: NDArray[Any]
    press: NDArray[Any]


@dataclass(frozen=True)
class SlopeSigma:
    """Standard deviation of a slope component: that of its step, times factors of slope and place.

    Without a step, its deviation counts as 1 mm/mm and the factors are the deviation. 68 % of the errors on held-out
    presses are within it: it is fitted to that fraction, because a few bad pixels would dominate the variance.

    Attributes
    ----------
    rest, rest_per_noise : deviation of gel at rest: the root of `rest^2 + rest_per_noise^2 noise`, with the variance of
        the place by `noise_at_rest`. The first part is the model's and alike everywhere, the second is the camera's
    slopes, sigmas : factors in contact, linear between these |gradient| and proportional beyond the last
    gain_sigma : relative error that slopes of one size share around a press, RMS over sizes and presses, beyond what errors
        of single slopes explain; depth is off in proportion
    solved_slopes, solved_places : (gentle, steep) and (2, rows, columns): deviation of the solved depth's slopes in contact
        over the one that a slope's reading and its neighbors predict, by slope and place; linear between the slopes,
        constant beyond. None: 1
    place : factors on a grid of 3 rows and 4 columns over the frame, interpolated between its cells' centers
    full_confidence_sigma : deviation that 95 % of the pixels in contact stay under; confidence is 1 up to it. Weighting the
        pixels of a contact against each other does not average out errors that many pixels share
    correlation_px : over this distance the correlated part falls to exp(-1/2) (a Gaussian)
    correlated_share : fraction of the variance that is correlated; the rest is white
    rest_correlation_px, rest_correlated_share : the same for gel at rest, where the color change's blur correlates the
        noise over a pixel or two. The errors' correlation falls to exp(-1/2) over the first; the second, 0-1, is the
        share that is correlated over `correlation_px`. None: as in a contact, in calibrations without it
    """

    rest: float
    slopes: tuple[float, ...]
    sigmas: tuple[float, ...]
    full_confidence_sigma: float
    correlation_px: float
    correlated_share: float = 1.0
    gain_sigma: float = 0.0
    place: tuple[tuple[float, ...], ...] = ((1.0,),)
    rest_correlation_px: float = 0.0
    rest_correlated_share: float | None = None
    solved_slopes: tuple[float, float] | None = None
    solved_places: tuple[tuple[tuple[float, ...], ...], ...] | None = None
    rest_per_noise: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in _RANGES:
            check_within(getattr(self, name), name, low, high)
        if self.rest_correlated_share is not None:
            check_within(self.rest_correlated_share, "rest_correlated_share", 0, 1)
        slopes, sigmas, place = (check_values(getattr(self, n), n) for n in ("slopes", "sigmas", "place"))
        if not (
            slopes.ndim == 1
            and slopes.shape == sigmas.shape
            and sigmas.min() > 0
            and np.all(np.diff(slopes) >= 0)
        ):
            raise ValueError("Expected slopes that grow and as many sigmas > 0, got others.")
        if not (place.ndim == 2 and place.min() > 0):
            raise ValueError("Expected place as rows of factors > 0, got others.")
        self._check_solved()

    def _check_solved(self) -> None:
        if self.solved_slopes is None and self.solved_places is None:
            return
        slopes, places = (check_values(getattr(self, n), n) for n in ("solved_slopes", "solved_places"))
        if not (slopes.shape == (2,) and 0 <= slopes[0] < slopes[1] and slopes[1] - slopes[0] >= LEAST_APART):
            raise ValueError("Expected solved_slopes as two slopes >= 0 that grow, got others.")
        if not (places.ndim == 3 and len(places) == 2 and places.min() > 0 and places.max() < MOST_FACTOR):
            raise ValueError("Expected solved_places as two grids of factors > 0, got others.")

    @classmethod
    def fit(cls, held_out: SlopeErrors, correlation_px: float, correlated_share: float) -> SlopeSigma:
        """Fit the law and the factors, so that 68 % of the held-out errors lie within one sigma everywhere."""
        stated = np.broadcast_to(np.float64(held_out.stated), held_out.slopes.shape)[:, None]
        slopes, error = held_out.slopes, np.abs(held_out.errors) / stated
        edges = np.unique(np.quantile(slopes, np.linspace(0, 1, SLOPE_BINS + 1)))
        bins = np.clip(np.digitize(slopes, edges[1:-1]), 0, len(edges) - 2)
        place = np.ones(PLACES)
        for _ in range(LAW_ROUNDS):
            factor = factor_at(place, held_out.x, held_out.y)[:, None]
            knots = [
                (float(slopes[bins == b].mean()), float(np.quantile((error / factor)[bins == b], ONE_SIGMA)))
                for b in range(len(edges) - 1)
                if np.count_nonzero(bins == b) >= MIN_IN_BIN
            ] or [(float(slopes.mean()), float(np.quantile(error, ONE_SIGMA)))]
            law = law_at(slopes, *np.array(knots).T)[:, None]
            place = place_factors(held_out, error / law, _size, PRIOR_PRESSES)
        rest, per_noise = knots[0][1] * float(np.median(stated)), 0.0
        if held_out.rest.size:
            rest, per_noise = _rest_law(held_out.rest, held_out.rest_noise)
        full_confidence_sigma = float(np.quantile(law * factor * stated, CLEAN_FRACTION))
        return cls(
            rest=max(rest, 1e-5),
            slopes=tuple(k[0] for k in knots),
            sigmas=tuple(max(k[1], 1e-5) for k in knots),
            full_confidence_sigma=max(full_confidence_sigma, 1e-5),
            correlation_px=float(correlation_px),
            correlated_share=float(correlated_share),
            place=tuple(tuple(float(v) for v in row) for row in place),
            rest_per_noise=per_noise,
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SlopeSigma:
        """Make it from `dataclasses.asdict`."""
        kept = {name: value for name, value in values.items() if value is not None}
        for name in ("slopes", "sigmas", "solved_slopes"):
            if name in kept:
                kept[name] = tuple(kept[name])
        if "place" in kept:
            kept["place"] = tuple(map(tuple, kept["place"]))
        if "solved_places" in kept:
            kept["solved_places"] = tuple(tuple(map(tuple, grid)) for grid in kept["solved_places"])
        return cls(**kept)

    @property
    def correlation(self) -> dict[str, Any]:
        """The correlation of the errors, as arguments of `DepthSigma`."""
        names = ("correlation_px", "correlated_share", "rest_correlation_px", "rest_correlated_share")
        return {name: getattr(self, name) for name in names}


def _rest_law(errors: NDArray[Any], noise: NDArray[Any]) -> tuple[float, float]:
    """The parts of the deviation at rest, from errors (M, 2) at pixels of that variance by noise (M,).

    Nonnegative least squares of the squared 68 % quantiles in bins of equal noise, each relative to itself.
    """
    order = np.array_split(np.argsort(noise, kind="stable"), SLOPE_BINS)
    bins = [part for part in order if len(part) >= MIN_IN_BIN] or [np.arange(len(noise))]
    squares = np.array([max(np.quantile(np.abs(errors[part]), ONE_SIGMA), 1e-9) ** 2 for part in bins])
    from_noise = np.array([np.mean(noise[part], dtype=np.float64) for part in bins])
    unit = max(float(from_noise.mean()), 1e-30)
    parts, _ = scipy.optimize.nnls(
        np.stack([1 / squares, from_noise / unit / squares], axis=1), np.ones(len(bins))
    )
    return float(np.sqrt(parts[0])), float(np.sqrt(parts[1] / unit))


def law_at(slopes: NDArray[Any], knots: NDArray[Any], sigmas: NDArray[Any]) -> NDArray[np.float64]:
    """Linear between the knots of the law, constant before the first, proportional to the slope beyond the last."""
    within = np.interp(slopes, knots, sigmas)
    return within * np.maximum(1.0, slopes / knots[-1] if knots[-1] > 0 else 1.0)


def factor_at(grid: NDArray[Any], x: NDArray[Any], y: NDArray[Any]) -> NDArray[np.float64]:
    """Factors at positions 0-1, bilinear between the cells' centers; x and y are broadcast against each other."""
    rows, columns = grid.shape
    column = np.clip(np.asarray(x) * columns - 0.5, 0, columns - 1).astype(np.float32)
    row = np.clip(np.asarray(y) * rows - 0.5, 0, rows - 1).astype(np.float32)
    left, top = (np.minimum(v.astype(int), max(n - 2, 0)) for v, n in ((column, columns), (row, rows)))
    right, bottom = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
    u, v = column - left, row - top
    upper = (1 - u) * grid[top, left] + u * grid[top, right]
    lower = (1 - u) * grid[bottom, left] + u * grid[bottom, right]
    value: NDArray[np.float64] = np.asarray((1 - v) * upper + v * lower)
    return value


def place_factors(
    held_out: SlopeErrors | SolvedErrors,
    ratio: NDArray[Any],
    size_of: Callable[[NDArray[Any]], float],
    prior: float,
    among: NDArray[np.bool_] | bool = True,
    whole: float = 1.0,
) -> NDArray[np.float64]:
    """Factors of `PLACES`, each pulled toward that of the whole frame if few presses touched the place.

    `ratio` (N, 2) are errors over predicted deviations; `size_of` computes the factor of some of them; `prior` presses count
    for the whole frame.
    """
    rows, columns = PLACES
    row = np.clip((held_out.y * rows).astype(int), 0, rows - 1)
    column = np.clip((held_out.x * columns).astype(int), 0, columns - 1)
    factors = np.full(PLACES, whole)
    for r, c in np.ndindex(PLACES):
        here = among & (row == r) & (column == c)
        if np.count_nonzero(here) >= MIN_IN_BIN:
            presses = len(np.unique(held_out.press[here]))
            trust = presses / (presses + prior)
            factors[r, c] = whole ** (1 - trust) * size_of(ratio[here]) ** trust
    return factors


def _size(ratio: NDArray[Any]) -> float:
    return max(float(np.quantile(ratio, ONE_SIGMA)), LEAST_FACTOR)
