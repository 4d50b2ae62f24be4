"""depth -> contact: the pixels where the pressure on the gel exceeds its own uncertainty, in regions that stand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.depth.contact.evidence import NOISE_FACTOR, Evidence, Regions
from gelform.depth.contact.regions import labeled, runs_work
from gelform.foundations.checks import (
    check_map,
    check_mm_per_px,
    check_number,
    check_positive,
    check_within,
)
from gelform.foundations.filters import LANES, MEDIAN_SAMPLES, SIGMA_OF_MEDIAN, blur_taps

MIN_AREA_MM2 = 0.05  # mm^2, area of the smallest contact
# px, standard deviations of the Gaussians that smooth before the Laplacian, the coarse one first, and the fractions of the
# mean pressure around a pixel at which a contact ends. A wider blur widens narrow contacts, so its fraction is larger.
SMOOTHINGS_PX, SHARES = (2.5, 0.7), (0.8, 0.65)
FINER = 2.3  # noise factors, mean pressure around pixels whose outline the finer smoothing draws
NEIGHBORHOOD_PX = 4  # px, half the width of the surroundings of a pixel
SIGMAS_OF_DEPTH = 2.0  # standard deviations; only the part of a depth beyond them presses on the bed
# mm, relaxation length of a gel that no press showed: the longest of six sensors (0.41 to 0.86). A shorter one than the
# gel's takes gel that is drawn down for contact.
USUAL_RELAXATION_MM = 0.86
FRACTION_AT_REST = (
    0.3  # smallest fraction of a frame that is taken to be at rest, where the noise is measured in it
)
SIGMA_OF_FRACTION = (
    2.595  # deviation of a normal distribution over the magnitude that 30 % of its values lie below
)
SIGMAS_OF_95 = 1.96  # standard deviations of a normal distribution that 95 % of its magnitudes lie below
LEAST_NOISE = 1e-3  # 1/mm, pressure of a depth without noise: what float32 rounds to

_bent_surface = Kernel(
    "bent_surface",
    "f32[h,w] depth, f32[t] taps, out f32[h,w] smooth, out f32[h,w] bent, out f32[n] work, f32 along_x, f32 along_y, "
    "i64 margin",
)
_magnitude_of_share = Kernel(
    "magnitude_of_share",
    "f32[...] values, f32[...] units, bool[...]? chosen, out f32[n] work, out f32[1] magnitude, i64 step, f64 share",
)
_median_below = Kernel("median_below", "f32[...] values, out f32[n] work, out f32[1] magnitude, i64 step")
_slope_variance = Kernel(
    "slope_variance",
    "f32[...] read, f32[...] solved, bool[...] at_rest, bool[...] known, out f32[...] variance, out f32[...] share",
)
_variance_of_known = Kernel("variance_of_known", "f32[...] total, f32[...] share, out f32[...] variance")
_contact_pressure = Kernel(
    "contact_pressure",
    "f32[...] smooth, f32[...] bent, f32[...] sigma, f32[...] variance, f32[...] noise, bool[...] at_rest, bool[...] known, "
    "out f32[...] pressure, f32 stiffness, f32 sigmas, f32 gain_at_rest, f32 gain_elsewhere, f32 factor",
)
_contact_outline = Kernel(
    "contact_outline",
    "f32[h,w] coarse, f32[h,w] finer, f32[h,w] noise, out bool[h,w] contact, out f32[n] work, i64 reach, f32 coarse_share, "
    "f32 finer_share, f32 limit",
)
_add_unknown = Kernel(
    "add_unknown", "bool[h,w] known, bool[h,w] pressed, out bool[h,w] contact, out i32[n] work"
)
_standing_regions = Kernel(
    "standing_regions",
    "u16[h,w] labels, bool[n] stands, i32[n,2] deepest, f32[h,w] surface, out bool[h,w] contact",
)


class SlopeDeviations(NamedTuple):
    """Standard deviations (H, W) of a frame's slopes, mm/mm, and where they hold.

    Attributes
    ----------
    read : of the slopes as they were read from the image; taken at rest
    solved : of the slopes of the solved depth; taken elsewhere
    at_rest : (H, W) bool, pixels at rest
    """

    read: NDArray[np.float32]
    solved: NDArray[np.float32]
    at_rest: NDArray[np.bool_]

    @classmethod
    def of(
        cls, read: NDArray[np.float32] | None, solved: NDArray[np.float32] | None, at_rest: NDArray[np.bool_]
    ) -> SlopeDeviations | None:
        """Those of a result's maps (H, W, 2), of whose components the larger counts; None if they are unknown."""
        return None if read is None or solved is None else cls(_larger(read), _larger(solved), at_rest)


def contact_from_depth(
    depth_mm: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    depth_sigma_mm: ArrayLike | None = None,
    relaxation_mm: float | None = None,
    noise_factor: float = NOISE_FACTOR,
    min_area_mm2: float = MIN_AREA_MM2,
) -> NDArray[np.bool_]:
    """The pixels where something touches the gel.

    Beside an object only the gel holds its surface: a membrane under tension on an elastic bed, whose depth z
    falls off as `laplace(z) = z/L^2` (Kerr, J. Appl. Mech. 31, 1964). The pressure over the membrane's tension,
    `p = z/L^2 - laplace(z)`, is 0 there and positive in the contact, for a ball as for a flat face. A pixel counts where p
    exceeds its own standard deviation and `noise_factor` times the noise at rest. A contact ends where p is about two
    thirds of its mean around the pixel. So gel that an object draws down is no contact, and hollow contacts stay hollow.

    A connected region of such pixels stands if its deepest depth exceeds `noise_factor` of its own standard deviations, and
    either the evidence `p/sd(p)` of a pixel is overwhelming, or the depth that the region's own pressure makes is sure.
    A pressure makes the depth `K0(r/L)/(2 pi)` at the distance r. Negative depths tell how much noisier a frame is than
    `depth_sigma_mm` says. Regions on the slope of one hill are joined along the way up; they are one contact.

    Parameters
    ----------
    depth_mm : (H, W), mm, 0 at rest, positive where pressed
    mm_per_px : float or (x, y), mm
    depth_sigma_mm : (H, W), mm, standard deviation of the depth; only the part of a depth beyond twice that counts.
        The default is that of the negative depths, which no contact makes
    relaxation_mm : L, mm; a calibration holds its gel's as `settings["relaxation_mm"]`. The default is that of a soft gel
    noise_factor : number of standard deviations that pressures and depths of a contact exceed
    min_area_mm2 : area of the smallest contact, mm^2

    Returns
    -------
    contact : (H, W) bool

    Raises
    ------
    ValueError, TypeError
        Wrong shape, NaN, or a setting outside its range.
    """
    depth = check_map(depth_mm, "depth_mm")
    if depth.ndim != 2:
        raise ValueError(f"Expected depth_mm of one frame, (H, W), got {depth.shape}.")
    for name, value in (("noise_factor", noise_factor), ("min_area_mm2", min_area_mm2)):
        check_number(value, name)
    if relaxation_mm is not None:
        check_positive(relaxation_mm, "relaxation_mm")
        check_within(relaxation_mm, "relaxation_mm", 1e-3, 1e3)  # mm; anything else is a typing error
    if not (noise_factor > 0 and min_area_mm2 >= 0):
        raise ValueError(
            f"Expected noise_factor > 0 and min_area_mm2 >= 0, got {noise_factor} and {min_area_mm2}."
        )
    pitch = check_mm_per_px(mm_per_px)
    depth, sigma = np.ascontiguousarray(depth), None
    if depth_sigma_mm is not None:
        sigma = check_map(depth_sigma_mm, "depth_sigma_mm", shape=depth.shape, nonnegative=True)
        sigma = np.ascontiguousarray(sigma)
    noise = np.ones_like(depth)
    return PreparedContact(pitch, relaxation_mm, noise, None, noise_factor, min_area_mm2)(depth, sigma)


class PreparedContact:
    """`contact_from_depth` for the frames of one sensor: float32, finite, in C order. Immutable; threads can share it.

    Parameters
    ----------
    pitch : (x, y), mm
    relaxation_mm : of the gel; None if unknown
    noise : (H, W) float32, variance of a slope at rest; without `correlation` only its ratios count
    correlation : of the slopes' errors, as in `DepthSigma`; None: noise is measured in each frame
    noise_factor, min_area_mm2 : as in `contact_from_depth`
    """

    def __init__(
        self,
        pitch: tuple[float, float],
        relaxation_mm: float | None,
        noise: NDArray[np.float32],
        correlation: Mapping[str, Any] | None = None,
        noise_factor: float = NOISE_FACTOR,
        min_area_mm2: float = MIN_AREA_MM2,
    ) -> None:
        length = relaxation_mm or USUAL_RELAXATION_MM
        self._pitch, self._noise, self._factor = pitch, noise, noise_factor
        self._stiffness, self._stands = length**-2, Evidence(pitch, length, noise_factor, min_area_mm2)
        self._gains = (
            None if correlation is None else [_gains(pitch, s, **correlation) for s in SMOOTHINGS_PX]
        )
        self._everywhere = np.ones(noise.shape, dtype=np.bool_)

    def __call__(
        self,
        depth: NDArray[np.float32],
        sigma: NDArray[np.float32] | None,
        slopes: SlopeDeviations | None = None,
        known: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.bool_]:
        """The contact mask (H, W) of a depth, mm, its standard deviation >= 0, that of its slopes, and its known pixels."""
        sigma = np.full_like(depth, _noise_mm(depth)) if sigma is None else sigma
        known = self._everywhere if known is None else known
        everywhere = bool(known.all())
        variance, at_rest, given = self._noise, self._everywhere, None
        if slopes is not None and self._gains is not None:
            at_rest, given = slopes.at_rest, self._gains
            variance = self._variance(slopes, known, everywhere)
        pressures: list[NDArray[np.float32]] = []
        surfaces: list[NDArray[np.float32]] = []
        gains: dict[str, float] = {}
        for k, (name, smoothing) in enumerate(zip(("coarse", "fine"), SMOOTHINGS_PX)):
            smooth, bent = self._smoothed(depth, smoothing)
            resting, elsewhere = self._gains_of_frame(bent, at_rest, None if given is None else given[k])
            gains |= {f"{name}_at_rest": resting, f"{name}_elsewhere": elsewhere}
            pressure = np.empty_like(depth)
            some = _contact_pressure(
                smooth, bent, sigma, variance, self._noise, at_rest, known, pressure, stiffness=self._stiffness,
                sigmas=SIGMAS_OF_DEPTH, gain_at_rest=resting, gain_elsewhere=elsewhere, factor=self._factor,
            )  # fmt: skip
            if not some and k == 0:
                return np.zeros(depth.shape, dtype=np.bool_)
            pressures.append(pressure)
            surfaces.append(smooth)
        coarse, fine = pressures
        contact = self._outlined(coarse, fine, gains["fine_at_rest"])
        if not everywhere:
            _add_unknown(known, contact.copy(), contact, np.empty(runs_work(depth.shape), dtype=np.int32))
        count, labels = labeled(contact)
        maps = {"depth": depth, "sigma": sigma, "variance": variance, "at_rest": at_rest}
        maps |= {"coarse": coarse, "fine": fine, "smooth": smooth, "bent": bent}
        stands, deepest = self._stands(Regions(count, labels, maps, gains))
        _standing_regions(labels, stands, deepest, surfaces[0], contact)
        return contact

    def _variance(
        self, slopes: SlopeDeviations, known: NDArray[np.bool_], everywhere: bool
    ) -> NDArray[np.float32]:
        """Variance (H, W) of the slopes that a pixel's pressure follows from: the known ones around it."""
        total, share, variance = (np.empty(known.shape, dtype=np.float32) for _ in range(3))
        _slope_variance(slopes.read, slopes.solved, slopes.at_rest, known, total, share)
        total, _ = self._smoothed(total, SMOOTHINGS_PX[0])
        if everywhere:
            return total
        share, _ = self._smoothed(share, SMOOTHINGS_PX[0])
        _variance_of_known(total, share, variance)
        return variance

    def _outlined(
        self, coarse: NDArray[np.float32], fine: NDArray[np.float32], fine_at_rest: float
    ) -> NDArray[np.bool_]:
        """Pixels (H, W) above a share of the mean pressure around: by the fine pressure where it is far above its noise."""
        contact, side = np.empty(coarse.shape, dtype=np.bool_), 2 * NEIGHBORHOOD_PX + 1
        work = np.empty((2 * side + 6) * (coarse.shape[1] + side + LANES), dtype=np.float32)
        limit = (FINER * self._factor) ** 2 * fine_at_rest
        _contact_outline(
            coarse, fine, self._noise, contact, work, reach=NEIGHBORHOOD_PX, coarse_share=SHARES[0],
            finer_share=SHARES[1], limit=limit,
        )  # fmt: skip
        return contact

    def _smoothed(
        self, values: NDArray[np.float32], smoothing: float
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """A smoothed map (H, W), and minus its Laplacian, 1/mm^2; pixels near borders get that of the next pixel inside."""
        taps = blur_taps(smoothing)
        margin = int(np.ceil(2 * smoothing))
        if min(values.shape) <= 2 * margin:
            margin = 0
        smooth, bent = np.empty_like(values), np.empty_like(values)
        rows, width = 2 * taps.size - 1, values.shape[1] + LANES
        work = np.empty((rows + 1) * width + rows, dtype=np.float32)
        along_x, along_y = (step**-2 for step in self._pitch)
        _bent_surface(values, taps, smooth, bent, work, along_x=along_x, along_y=along_y, margin=margin)
        return smooth, bent

    def _gains_of_frame(
        self, bent: NDArray[np.float32], at_rest: NDArray[np.bool_], known: list[float] | None
    ) -> list[float]:
        """Variance of the pressure at rest, and elsewhere, for a variance of slopes of 1.

        A frame may have more noise at rest than the calibration's presses, or larger outliers, as after compression: the
        larger counts. If nothing is known, the smallest magnitudes of the frame tell its noise.
        """
        if known is None:
            return 2 * [
                max(SIGMA_OF_FRACTION * self._magnitude(bent, None, FRACTION_AT_REST), LEAST_NOISE) ** 2
            ]
        return [max(known[0], (self._magnitude(bent, at_rest, 0.95) / SIGMAS_OF_95) ** 2), known[1]]

    def _magnitude(self, bent: NDArray[np.float32], chosen: NDArray[np.bool_] | None, share: float) -> float:
        step = max(1, bent.size // MEDIAN_SAMPLES)
        work = np.empty(2 * -(-bent.size // step), dtype=np.float32)
        magnitude = np.empty(1, dtype=np.float32)
        _magnitude_of_share(bent, self._noise, chosen, work, magnitude, step=step, share=share)
        return float(magnitude[0])


def _gains(
    pitch: tuple[float, float],
    smoothing: float,
    correlation_px: float,
    correlated_share: float,
    rest_correlation_px: float,
    rest_correlated_share: float | None,
) -> list[float]:
    """Variance of the pressure of gel at rest, and elsewhere, for a variance of the slopes of 1."""
    per_mm2 = (pitch[0] ** -2 + pitch[1] ** -2) / 2
    share_at_rest = correlated_share if rest_correlated_share is None else rest_correlated_share
    far = _divergence(correlation_px, smoothing)
    return [
        per_mm2 * (share * far + (1 - share) * _divergence(near, smoothing))
        for share, near in ((share_at_rest, rest_correlation_px), (correlated_share, 0.0))
    ]


def _divergence(length: float, smoothing: float) -> float:
    """Variance, 1/px^2, of the divergence of slopes of variance 1, correlated over a length and smoothed, both px.

    A Gaussian correlation gives `2 l^2 / (2 s^2 + l^2)^2`; white noise, a pixel wide, `1 / (4 pi s^4)`. A slope is the mean
    of two pixels' and the divergence a difference, which smooth by a quarter of a squared pixel.
    """
    square = smoothing**2 + 0.25
    return 2 * length**2 / (2 * square + length**2) ** 2 if length > 0.5 else 1 / (4 * np.pi * square**2)


def _larger(sigma: NDArray[np.float32]) -> NDArray[np.float32]:
    alike = sigma.strides[-1] == 0  # one map for both components, broadcast
    return np.ascontiguousarray(sigma[..., 0] if alike else sigma.max(axis=-1))


def _noise_mm(depth: NDArray[np.float32]) -> float:
    """Standard deviation of gel at rest, mm: from the median of its negative depths, as of half a Gaussian."""
    step = max(1, depth.size // MEDIAN_SAMPLES)
    work = np.empty(2 * -(-depth.size // step), dtype=np.float32)
    found = np.empty(1, dtype=np.float32)
    _median_below(depth, work, found, step)
    return SIGMA_OF_MEDIAN * float(found[0])
