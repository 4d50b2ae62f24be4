"""Standard deviation of a slope, fitted to errors on held-out presses: two numbers as read, one after the solve."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.foundations.checks import check_values, check_within

SLOPE_BINS = 10  # bins of equal counts
ONE_SIGMA, TWO_SIGMA = (
    0.6827,
    0.9545,
)  # fractions of a normal distribution within one and two standard deviations
MIN_IN_BIN = 50  # pixels; fewer do not determine a quantile
CLEAN_FRACTION = 0.95  # fraction of the pixels in contact whose confidence is 1
# Quantiles of the slopes that presses have shown: beyond the first a model of other units is doubted, beyond the second
# every model. With 0.5 the faces of a cube's edge escape the doubt of a model whose own presses are deep, with 0.3 balls are
# doubted too; from 0.75 on, balls of the own unit were doubted in every second frame.
SHOWN = 0.4, 0.8
LEAST_SIGMA = 1e-5  # mm/mm, least deviation: float32 rounds slopes to less
LEAST_FACTOR = 0.3  # smallest factor of solved slopes; errors that have no curl stay

_RANGES = (
    ("rest", 1e-9, 1e3),
    ("rest_per_noise", 0, 1e3),
    ("per_step", 1e-9, 1e3),
    ("per_slope", 0, 1e4),
    ("solved_factor", 1e-3, 1e3),
    ("depth_factor", 1e-3, 1e4),
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
    rest : (M, 2) slopes read at rest, without their bias; they are all error
    rest_noise : (M,) variance there from the image's noise, by `noise_at_rest`
    stated : (N,) standard deviation by the step of the forward response; 1 without a step
    """

    slopes: NDArray[Any]
    errors: NDArray[Any]
    rest: NDArray[Any]
    rest_noise: NDArray[Any]
    stated: NDArray[Any] | float = 1.0


@dataclass(frozen=True)
class SlopeSigma:
    """Standard deviation of a slope component: that of its step, times a factor that grows with the slope.

    Without a step, its deviation counts as 1 mm/mm. 68 % of the errors on held-out presses are within the stated deviations:
    they are fitted to that fraction, because a few bad pixels would dominate the variance.

    Attributes
    ----------
    rest, rest_per_noise : deviation of gel at rest: the root of `rest^2 + rest_per_noise^2 noise`, with the variance of
        the place by `noise_at_rest`. The first part is the model's and alike everywhere, the second is the camera's
    per_step, per_slope : deviation in contact: `per_step step sqrt(1 + (per_slope |gradient|)^2)`, with the step's own
    solved_factor : deviation of the solved depth's slopes over that of the slopes as read; a surface cannot follow errors
        that have curl
    depth_factor : deviation of depth far from contacts over the one that the slopes there make; see `gelform.depth.sigma`
    shown : (mm/mm, mm/mm) quantiles 0.4 and 0.8 of the slopes that presses have shown
    gain_sigma : relative error that slopes of one size share around a press, RMS over sizes and presses, beyond what errors
        of single slopes explain; depth is off in proportion
    full_confidence_sigma : deviation that 95 % of the pixels in contact stay under; confidence is 1 up to it
    correlation_px : over this distance the correlated part falls to exp(-1/2) (a Gaussian)
    correlated_share : fraction of the variance that is correlated; the rest is white
    rest_correlation_px, rest_correlated_share : the same for gel at rest, where the color change's blur correlates the
        noise over a pixel or two. The errors' correlation falls to exp(-1/2) over the first; the second, 0-1, is the
        share that is correlated over `correlation_px`. None: as in a contact, in calibrations without it
    """

    rest: float
    per_step: float
    full_confidence_sigma: float
    correlation_px: float
    per_slope: float = 0.0
    solved_factor: float = 1.0
    depth_factor: float = 10.0
    shown: tuple[float, float] = (0.4, 0.6)
    correlated_share: float = 1.0
    gain_sigma: float = 0.0
    rest_correlation_px: float = 0.0
    rest_correlated_share: float | None = None
    rest_per_noise: float = 0.0

    def __post_init__(self) -> None:
        for name, low, high in _RANGES:
            check_within(getattr(self, name), name, low, high)
        if self.rest_correlated_share is not None:
            check_within(self.rest_correlated_share, "rest_correlated_share", 0, 1)
        shown = check_values(self.shown, "shown")
        if not (shown.shape == (2,) and 0 <= shown[0] <= shown[1]):
            raise ValueError("Expected shown as two slopes >= 0 that grow, got others.")

    @classmethod
    def fit(cls, held_out: SlopeErrors, correlation_px: float, correlated_share: float) -> SlopeSigma:
        """Fit the law, so that 68 % of the held-out errors of slopes of any size lie within one sigma."""
        stated = np.broadcast_to(np.float64(held_out.stated), held_out.slopes.shape)
        slopes, error = held_out.slopes, np.abs(held_out.errors) / stated[:, None]
        order = np.array_split(np.argsort(slopes, kind="stable"), SLOPE_BINS)
        bins = [part for part in order if len(part) >= MIN_IN_BIN] or [np.arange(len(slopes))]
        squares = np.array([max(np.quantile(error[part], ONE_SIGMA), 1e-9) ** 2 for part in bins])
        sizes = np.array([np.mean(np.square(slopes[part])) for part in bins])
        constant, growing = _law(squares, sizes)
        per_step = max(constant**0.5, LEAST_SIGMA)
        law = np.sqrt(constant + growing * slopes**2) * stated
        rest, per_noise = per_step * float(np.median(stated)), 0.0
        if held_out.rest.size:
            rest, per_noise = _rest_law(held_out.rest, held_out.rest_noise)
        low, high = np.quantile(slopes, SHOWN)
        return cls(
            rest=max(rest, LEAST_SIGMA),
            per_step=per_step,
            per_slope=growing**0.5 / per_step,
            shown=(float(low), float(high)),
            full_confidence_sigma=max(float(np.quantile(law, CLEAN_FRACTION)), LEAST_SIGMA),
            correlation_px=float(correlation_px),
            correlated_share=float(correlated_share),
            rest_per_noise=per_noise,
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> SlopeSigma:
        """Make it from `dataclasses.asdict`."""
        kept = {name: value for name, value in values.items() if value is not None}
        return cls(**{**kept, "shown": tuple(kept["shown"])})

    def with_solved(self, errors: NDArray[Any], stated: NDArray[Any]) -> SlopeSigma:
        """With the factor that leaves 68 % of held-out errors (N, 2) of solved slopes within one sigma.

        `stated` (N,) are the deviations of the slopes as read at the same pixels. Too few pixels change nothing.
        """
        if len(stated) < MIN_IN_BIN:
            return self
        factor = float(np.quantile(np.abs(errors) / stated[:, None], ONE_SIGMA))
        return replace(self, solved_factor=max(factor, LEAST_FACTOR))

    @property
    def correlation(self) -> dict[str, Any]:
        """The correlation of the errors, as arguments of `PreparedContact`."""
        names = ("correlation_px", "correlated_share", "rest_correlation_px", "rest_correlated_share")
        return {name: getattr(self, name) for name in names}


def _law(squares: NDArray[Any], variable: NDArray[Any]) -> tuple[float, float]:
    """Constant and growing part of squared deviations, by nonnegative least squares, each relative to itself."""
    unit = max(float(variable.mean()), 1e-30)
    parts, _ = scipy.optimize.nnls(
        np.stack([1 / squares, variable / unit / squares], axis=1), np.ones(len(squares))
    )
    return float(parts[0]), float(parts[1] / unit)


def _rest_law(errors: NDArray[Any], noise: NDArray[Any]) -> tuple[float, float]:
    """The parts of the deviation at rest, from errors (M, 2) at pixels of that variance by noise (M,)."""
    order = np.array_split(np.argsort(noise, kind="stable"), SLOPE_BINS)
    bins = [part for part in order if len(part) >= MIN_IN_BIN] or [np.arange(len(noise))]
    squares = np.array([max(np.quantile(np.abs(errors[part]), ONE_SIGMA), 1e-9) ** 2 for part in bins])
    from_noise = np.array([np.mean(noise[part], dtype=np.float64) for part in bins])
    constant, growing = _law(squares, from_noise)
    return constant**0.5, growing**0.5
