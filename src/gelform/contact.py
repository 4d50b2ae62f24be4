"""depth -> contact: the regions where something touches the gel, and the measures of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.background.change import PreparedBackground
from gelform.color_models.seam import PreparedColorModel
from gelform.foundations.checks import as_array, check_map, check_mm_per_px, check_number, check_positive
from gelform.foundations.filters import LANES, MEDIAN_SAMPLES, SIGMA_OF_MEDIAN, blur_taps, medians_where

MOST_CONTACTS = 65_535  # labels are uint16
RUN_WORDS = 6  # 32-bit words; as in native/contact/runs.h
_label_regions = Kernel("label_regions", "bool[h,w] mask, out u16[h,w] labels, out i32[n] work")
_region_moments = Kernel("region_moments", "u16[h,w] labels, f32[h,w] depth, out f64[n,14] moments")


@dataclass(frozen=True)
class Contact:
    """One connected region of the contact mask.

    Measures in mm are None if the scale is unknown. Positions are (x, y) in pixels of the image: x to the right, y
    down, pixel centers at whole numbers.

    Attributes
    ----------
    label : value in the label map, from 1
    area_px : number of pixels
    centroid_px : (x, y), mean position of its pixels
    deepest_px : (x, y) of its deepest pixel
    angle_deg : direction of the major axis, from x (right) toward y (down), -90 to 90
    cut_by_border : whether it reaches the image's border; if so, its measures are those of the visible part
    area_mm2 : area, mm^2
    volume_mm3 : integral of the depth, mm^3
    deepest_mm : depth of its deepest pixel, mm
    axes_mm : full lengths of the major and minor axis of the ellipse with its second moments, mm
    """

    label: int
    area_px: int
    centroid_px: tuple[float, float]
    deepest_px: tuple[int, int]
    angle_deg: float
    cut_by_border: bool
    area_mm2: float | None = None
    volume_mm3: float | None = None
    deepest_mm: float | None = None
    axes_mm: tuple[float, float] | None = None


def contacts_from_mask(
    contact: ArrayLike, depth: ArrayLike, *, mm_per_px: float | Sequence[float] | None
) -> tuple[tuple[Contact, ...], NDArray[np.uint16]]:
    """The connected regions of a contact mask, the largest first, and the map of their labels.

    Pixels that touch at a corner are connected. Holes stay holes: a ring is one contact whose area and volume leave
    out the region that it encloses.

    Parameters
    ----------
    contact : (H, W) bool
    depth : (H, W), positive where pressed; mm if `mm_per_px` is not None
    mm_per_px : float or (x, y), mm; None where the scale is unknown

    Returns
    -------
    contacts : sorted by area, the largest first
    labels : (H, W) uint16, 0 where nothing touches

    Raises
    ------
    ValueError, TypeError
        Wrong shapes, NaN, or a pitch that is not positive.
    """
    height = check_map(depth, "depth")
    mask = as_array(contact, "contact")
    if height.ndim != 2 or mask.shape != height.shape:
        raise ValueError(
            f"Expected contact and depth of one frame, (H, W), got {mask.shape} and {height.shape}."
        )
    if mask.dtype != np.bool_:
        raise TypeError(f"Expected contact as bool, got {mask.dtype}. Convert it: contact > 0.")
    pitch = (1.0, 1.0) if mm_per_px is None else check_mm_per_px(mm_per_px)
    count, labels = labeled(mask)
    moments = np.empty((count, 14))
    _region_moments(labels, np.ascontiguousarray(height), moments)
    found = [_contact(k + 1, row, pitch, mask.shape, mm_per_px is not None) for k, row in enumerate(moments)]
    return tuple(sorted(found, key=lambda one: (-one.area_px, one.label))), labels


def labeled(mask: NDArray[np.bool_]) -> tuple[int, NDArray[np.uint16]]:
    """The number of connected regions of a mask (H, W), and the map of their labels in the order of their first pixels."""
    labels = np.empty(mask.shape, dtype=np.uint16)
    found = _label_regions(
        np.ascontiguousarray(mask), labels, np.empty(runs_work(labels.shape), dtype=np.int32)
    )
    if found > MOST_CONTACTS:
        raise ValueError(f"Expected at most {MOST_CONTACTS} separate contacts, got {found}: is this noise?")
    return found, labels


def runs_work(shape: tuple[int, ...]) -> int:
    """Words of memory for the largest number of runs of pixels that a map (H, W) can have."""
    return RUN_WORDS * shape[0] * ((shape[1] + 1) // 2)


def _contact(
    label: int, row: NDArray[np.float64], pitch: tuple[float, float], shape: tuple[int, ...], scaled: bool
) -> Contact:
    count, x, y, xx, xy, yy, volume, deepest, deepest_x, deepest_y, left, right, top, bottom = row.tolist()
    center = x / count, y / count
    # A pixel is a square, not a point: its own second moment is 1/12.
    covariance = np.array(
        [
            [xx / count - center[0] ** 2 + 1 / 12, xy / count - center[0] * center[1]],
            [xy / count - center[0] * center[1], yy / count - center[1] ** 2 + 1 / 12],
        ]
    )
    lengths, angle = _axes(covariance * np.outer(pitch, pitch))
    area = count * pitch[0] * pitch[1]
    in_mm = {
        "area_mm2": area,
        "volume_mm3": volume * pitch[0] * pitch[1],
        "deepest_mm": deepest,
        "axes_mm": lengths,
    }
    return Contact(
        label=label,
        area_px=int(count),
        centroid_px=center,
        deepest_px=(int(deepest_x), int(deepest_y)),
        angle_deg=angle,
        cut_by_border=left == 0 or top == 0 or right == shape[1] - 1 or bottom == shape[0] - 1,
        **(in_mm if scaled else {}),
    )


def _axes(covariance: NDArray[np.float64]) -> tuple[tuple[float, float], float]:
    """Full axes (4 standard deviations) of the ellipse of a covariance, and the angle of the major axis, degrees."""
    (a, b), (_, d) = covariance.tolist()
    mean, apart = (a + d) / 2, float(np.hypot((a - d) / 2, b))
    angle = float(np.rad2deg(np.arctan2(2 * b, a - d)) / 2)
    return (4 * float(np.sqrt(mean + apart)), 4 * float(np.sqrt(max(mean - apart, 0.0)))), angle


# Chosen on the simulated sensor three-edges and on drawn sensors, not on those that docs/contacts.md measures.
NOISE_FACTOR, MIN_AREA_MM2 = 4.0, 0.05  # defaults, in standard deviations and in mm^2
# Standard deviation, px, of the Gaussian that smooths before the Laplacian, and the fraction of the mean pressure around a
# pixel at which a contact ends. The first that leaves noise below QUIET, 1/mm, is used. A wider blur widens narrow contacts,
# so its fraction is larger.
SMOOTHINGS_PX, QUIET = {0.7: 0.65, 1.5: 0.7, 2.5: 0.8}, 0.06
# The same fraction for the next finer smoothing, which draws the outline where the mean pressure is so many times its noise.
FINER_HALF, FINER_SIGMAS = 0.6, 8.0
FRACTION_AT_REST = 0.3  # smallest fraction of a frame that is assumed to be at rest
# Standard deviation of a normal distribution, over the magnitude that 30 % of its values lie below.
SIGMA_OF_FRACTION = 2.595
SIGMAS_OF_DEPTH = 2.0  # standard deviations; only the part of a depth beyond them counts
STIFFEST = 25.0  # 1/mm^2; no gel relaxes within less than 0.2 mm
LEAST_FALLING = 50  # pixels next to a contact, the fewest for an estimate of the gel's relaxation
SEED = 1.4  # times the noise factor: a contact has a pixel above
NEIGHBORHOOD_PX = 4  # px, half the width of the surroundings of a pixel
LEAST_OF_BED = 0.35  # times z/L^2, because L is not known exactly and varies over the gel
# A pixel also belongs to a flat contact if z/L^2 exceeds FLAT of the mean pressure around, and the pressure OF_FLAT of
# z/L^2.
FLAT, OF_FLAT = 0.4, 0.75
LEAST_PRESSURE = 0.02  # 1/mm, the limit for a frame without noise
USUAL_LEVELS = 2.0  # gray levels, the noise if the calibration does not know the noise of its images
NOISE_BLUR_PX = 8.0  # px, standard deviation of the blur of the noise map
# Limits of the noise of a place over the median place; beyond them a color model says more of itself than of noise.
LEAST_NOISE, MOST_NOISE = 0.3, 4.0

_bent_surface = Kernel(
    "bent_surface",
    "f32[h,w] depth, f32[t] taps, out f32[h,w] smooth, out f32[h,w] bent, out f32[n] work, f32 along_x, f32 along_y, "
    "i64 margin",
)
_magnitude_of_share = Kernel(
    "magnitude_of_share",
    "f32[...] values, f32[...]? units, out f32[n] work, out f32[1] magnitude, i64 step, f64 share",
)
_median_below = Kernel("median_below", "f32[...] values, out f32[n] work, out f32[1] magnitude, i64 step")
_pressure_on_bed = Kernel(
    "pressure_on_bed",
    "f32[...]? sigma, out f32[...] bed, out f32[...] bent, out f32[n] work, f32 known, f32 every_sigma, f32 sigmas, "
    "f32 below, i64 least, f32 stiffest",
)
_contact_regions = Kernel(
    "contact_regions",
    "f32[h,w] pressure, f32[h,w] bed, f32[h,w] noise, f32[h,w]? finer, out bool[h,w] contact, out f32[n] work, "
    "i64 reach, f32 limit, f32 least_of_bed, f32 flat, f32 of_flat, f32 half, f32 finer_half, f32 finer_limit, "
    "f32 seed, f32 min_px",
)


class _Pressure(NamedTuple):
    """Pressure on the surface over its tension, 1/mm, (H, W), and the maps that it is estimated from."""

    pressure: NDArray[np.float32]
    bed: NDArray[np.float32]  # the bed's part z/L^2, from the depth that exceeds its noise
    finer: NDArray[np.float32] | None  # minus the Laplacian after the next finer smoothing, if there is one
    finer_noise: float
    half: float  # fraction of the mean pressure around, at which a contact ends


def contact_from_depth(
    depth_mm: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    depth_sigma_mm: ArrayLike | None = None,
    relaxation_mm: float | None = None,
    noise_factor: float = NOISE_FACTOR,
    min_area_mm2: float = MIN_AREA_MM2,
) -> NDArray[np.bool_]:
    """The pixels where an object holds the gel's surface up.

    Next to an object only the gel holds its surface: a membrane under tension on an elastic bed, whose depth z
    falls off as `laplace(z) = z/L^2` (Kerr, J. Appl. Mech. 31, 1964). The pressure over the membrane's tension,
    `p = z/L^2 - laplace(z)`, is 0 there and positive in the contact, for a ball as for a flat face. A contact starts where
    p exceeds 1.4 times `noise_factor` of its noise. It continues where p exceeds `noise_factor` of the noise and a third of
    z/L^2, and ends where p is about half of its mean around the pixel. So gel that an object draws down is no contact, and
    hollow contacts stay hollow. The depth is smoothed as much as its noise needs (0.7, 1.5 or 2.5 px). Where the pressure
    is far above the noise of the next finer smoothing, that smoothing draws the outline.

    Parameters
    ----------
    depth_mm : (H, W), mm, 0 at rest, positive where pressed
    mm_per_px : float or (x, y), mm
    depth_sigma_mm : (H, W), mm, standard deviation of the depth; only the part of a depth beyond twice that counts.
        The default is that of the negative depths, which no contact makes
    relaxation_mm : L, mm; a calibration holds its gel's as `settings["relaxation_mm"]`. By default L is read from the
        frame where the surface falls off. That is far less exact, and impossible where the surface hardly falls off
    noise_factor : number of standard deviations of the frame's noise that a contact exceeds
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
    if not (noise_factor > 0 and min_area_mm2 >= 0):
        raise ValueError(
            f"Expected noise_factor > 0 and min_area_mm2 >= 0, got {noise_factor} and {min_area_mm2}."
        )
    pitch = check_mm_per_px(mm_per_px)
    depth, sigma = np.ascontiguousarray(depth), None
    if depth_sigma_mm is not None:
        sigma = check_map(depth_sigma_mm, "depth_sigma_mm", shape=depth.shape, nonnegative=True)
        sigma = np.ascontiguousarray(sigma)
    prepared = PreparedContact(pitch, relaxation_mm, np.ones_like(depth), noise_factor, min_area_mm2)
    return prepared(depth, sigma)


@dataclass(frozen=True)
class PreparedContact:
    """`contact_from_depth` for the frames of one sensor: float32, finite, in C order.

    Attributes
    ----------
    pitch : (x, y), mm
    relaxation_mm : of the gel; None if unknown
    noise : (H, W) float32 > 0, noise of each place over that of the median place
    noise_factor, min_area_mm2 : as in `contact_from_depth`
    """

    pitch: tuple[float, float]
    relaxation_mm: float | None
    noise: NDArray[np.float32]
    noise_factor: float = NOISE_FACTOR
    min_area_mm2: float = MIN_AREA_MM2

    def __call__(self, depth: NDArray[np.float32], sigma: NDArray[np.float32] | None) -> NDArray[np.bool_]:
        """The contact mask (H, W) of a depth, mm, and its standard deviation >= 0."""
        found = _pressure(depth, sigma, self)
        limit = max(self.noise_factor * _noise(found.pressure, self.noise), LEAST_PRESSURE)
        return _regions(found, limit, self.noise, self.min_area_mm2 / (self.pitch[0] * self.pitch[1]))


def _pressure(
    depth: NDArray[np.float32], sigma: NDArray[np.float32] | None, sensor: PreparedContact
) -> _Pressure:
    """The pressure of a depth (H, W); sigma and L are estimated from the depth if they are not given."""
    tried: list[tuple[NDArray[np.float32], float]] = []
    for smoothing in SMOOTHINGS_PX:
        smooth, bent = _bent(depth, sensor.pitch, smoothing)
        noise = _noise(bent, sensor.noise)
        tried.append((bent, noise))
        if noise <= QUIET:
            break
    finer, finer_noise = tried[-2] if len(tried) > 1 else (None, 0.0)
    every = _noise_mm(depth) if sigma is None else 0.0
    work = np.empty(2 * depth.size, dtype=np.float32)
    rules = SIGMAS_OF_DEPTH, -4 * noise, LEAST_FALLING, STIFFEST
    known = 0.0 if sensor.relaxation_mm is None else max(sensor.relaxation_mm, STIFFEST**-0.5) ** -2
    _pressure_on_bed(sigma, smooth, bent, work, known, every, *rules)
    return _Pressure(bent, smooth, finer, finer_noise, SMOOTHINGS_PX[smoothing])


def _bent(
    depth: NDArray[np.float32], pitch: tuple[float, float], smoothing: float
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """A smoothed depth (H, W), and minus its Laplacian, 1/mm.

    Pixels near the borders get the value of the next pixel inside.
    """
    taps = blur_taps(smoothing)
    margin = int(np.ceil(2 * smoothing))
    if min(depth.shape) <= 2 * margin:
        margin = 0
    smooth, bent = np.empty_like(depth), np.empty_like(depth)
    rows, width = 2 * taps.size - 1, depth.shape[1] + LANES
    work = np.empty((rows + 1) * width + rows, dtype=np.float32)
    _bent_surface(depth, taps, smooth, bent, work, 1 / pitch[0] ** 2, 1 / pitch[1] ** 2, margin)
    return smooth, bent


def _noise(values: NDArray[np.float32], by_place: NDArray[np.float32]) -> float:
    """Standard deviation of a map (H, W) at rest, at a place of unit noise: from its smallest magnitudes."""
    step = max(1, values.size // MEDIAN_SAMPLES)
    work = np.empty(2 * -(-values.size // step), dtype=np.float32)
    magnitude = np.empty(1, dtype=np.float32)
    _magnitude_of_share(values, by_place, work, magnitude, step, FRACTION_AT_REST)
    return SIGMA_OF_FRACTION * float(magnitude[0])


def _noise_mm(depth: NDArray[np.float32]) -> float:
    """Standard deviation of gel at rest, mm: from the median of its negative depths, as of half a Gaussian."""
    step = max(1, depth.size // MEDIAN_SAMPLES)
    work = np.empty(2 * -(-depth.size // step), dtype=np.float32)
    found = np.empty(1, dtype=np.float32)
    _median_below(depth, work, found, step)
    return SIGMA_OF_MEDIAN * float(found[0])


def _regions(found: _Pressure, limit: float, noise: NDArray[np.float32], min_px: float) -> NDArray[np.bool_]:
    """Regions where the pressure is above its limit and about half of its mean around, each with a sure start.

    A wide smoothing finds faint contacts and widens narrow ones; the next finer one draws the outlines within.
    """
    height, width = found.pressure.shape
    contact = np.empty((height, width), dtype=np.bool_)
    side = 2 * NEIGHBORHOOD_PX + 1
    sums = (2 * side + 6) * (width + side + LANES)
    work = np.empty(sums + runs_work(contact.shape), dtype=np.float32)
    shares = LEAST_OF_BED, FLAT, OF_FLAT, found.half, FINER_HALF, FINER_SIGMAS * found.finer_noise
    least = SEED * limit, min_px
    maps = found.pressure, found.bed, noise, found.finer, contact, work
    _contact_regions(*maps, NEIGHBORHOOD_PX, limit, *shares, *least)
    return contact


def noise_by_place(
    model: PreparedColorModel, untouched: PreparedBackground, levels: Sequence[float] | None
) -> NDArray[np.float32]:
    """Standard deviation of the slopes at rest at each place over its median, (H, W), from the image's noise.

    The slopes change when noise makes a channel brighter. The color model's derivative says by how much; it is one
    difference for each channel.

    Parameters
    ----------
    model : color model, ready for frames over this background
    untouched : the background image
    levels : standard deviation of a pixel's red, green and blue, gray levels; None if unknown
    """
    rest = model.gradients_from_color(np.zeros_like(untouched.background))[0].copy()
    variance = np.zeros(rest.shape[:2], dtype=np.float32)
    for channel, level in enumerate(levels or (USUAL_LEVELS,) * 3):
        brighter = untouched.background.copy()
        brighter[..., channel] += np.float32(level)
        off = model.gradients_from_color(untouched.change(brighter))[0] - rest
        variance += off[..., 0] ** 2 + off[..., 1] ** 2
    noise = np.sqrt(cv2.GaussianBlur(variance, (0, 0), NOISE_BLUR_PX, borderType=cv2.BORDER_REPLICATE))
    # np.median loads numpy.ma, which takes a tenth of the time of a first frame.
    median = float(medians_where(noise[..., None])[0][0])
    if median == 0:
        return np.ones_like(noise)
    return np.clip(noise / np.float32(median), LEAST_NOISE, MOST_NOISE, dtype=np.float32)
