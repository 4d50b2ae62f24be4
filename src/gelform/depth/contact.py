"""depth -> contact: the pixels where the pressure on the gel exceeds its own uncertainty, and the regions of that mask."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import atan2, degrees, hypot, sqrt
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.arrays import Floats, Map, Mask, Numbers
from gelform.depth.coarse import REST_SIGMA_MM
from gelform.errors import Finding
from gelform.foundations.checks import (
    as_array,
    check_map,
    check_mm_per_px,
    check_number,
    check_positive,
    check_within,
    value_range,
)
from gelform.foundations.filters import LANES, MEDIAN_SAMPLES, SIGMA_OF_MEDIAN, bessel_k, blur_taps
from gelform.foundations.pool import once
from gelform.image.background import CHANGE_OFFSET
from gelform.image.view import PIXEL_VARIANCE

_contact_moments = Kernel(
    "contact_moments",
    "bool[h,w] contact, f32[h,w] depth, out u16[h,w] labels, out f64[m,14] moments, out i32[n] work",
)
_touched_regions = Kernel(
    "touched_regions",
    "bool[h,w] contact, bool[h,w] known, bool[h,w] at_rest, bool[h,w]? hidden, f32[h,w] depth, f32[h,w]? sigma, "
    "out f64[m,4] sums, out i32[n] work, f32 factor, f32 least, f32 least_unknown",
)
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
    deepest_px : (x, y) of its deepest known pixel
    angle_deg : direction of the major axis, from x (right) toward y (down), -90 to 90
    cut_by_border : whether it reaches the image's border; if so, its measures are those of the visible part
    area_mm2 : area, mm^2
    volume_mm3 : integral of the depth, mm^3
    deepest_mm : depth of its deepest known pixel, mm
    axes_mm : full lengths of the major and minor axis of the ellipse with its second moments, mm
    at_least : whether unknown pixels of it are deeper or next to its deepest pixel, so that it may be deeper
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
    at_least: bool = False

    def __repr__(self) -> str:
        area = f"{self.area_px} px" if self.area_mm2 is None else f"{self.area_mm2:.3g} mm^2"
        deepest = (
            "" if self.deepest_mm is None else f", {at_least(self.at_least)}{self.deepest_mm:.3f} mm deep"
        )
        x, y = self.centroid_px
        cut = ", cut by the border" if self.cut_by_border else ""
        return f"Contact({self.label}: {area}{deepest}, around ({x:.0f}, {y:.0f}) px{cut})"


def at_least(unsure: bool) -> str:
    """What stands before a largest depth next to which depth is unknown."""
    return "at least " if unsure else ""


def may_be_deeper(unknown: Mask, depth: Map, place: tuple[int, int]) -> bool:
    """Whether unknown pixels (H, W) of a depth (H, W) are deeper than a known one at (x, y), or next to it."""
    x, y = place
    beside = unknown[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].any()
    return bool(beside) or bool(depth.max(where=unknown, initial=-np.inf) > depth[y, x])


def contacts_from_mask(
    contact: ArrayLike,
    depth: ArrayLike,
    *,
    mm_per_px: float | Sequence[float] | None,
    known: ArrayLike | None = None,
) -> tuple[tuple[Contact, ...], NDArray[np.uint16]]:
    """The connected regions of a contact mask, the largest first, and the map of their labels.

    Pixels that touch at a corner are connected. Holes stay holes: a ring is one contact whose area and volume leave
    out the region that it encloses. The depth (H, W) is positive where pressed, in mm if the scale is known. The deepest
    pixel is one of the `known` pixels (H, W), unless a contact has none; all are known by default. ValueError, TypeError:
    wrong shapes, NaN, or a pitch that is not positive.
    """
    z = check_map(depth, "depth")
    mask = as_array(contact, "contact")
    if z.ndim != 2 or mask.shape != z.shape:
        raise ValueError(f"Expected contact and depth of one frame, (H, W), got {mask.shape} and {z.shape}.")
    seen = np.ones(z.shape, dtype=np.bool_) if known is None else as_array(known, "known")
    if seen.shape != z.shape:
        raise ValueError(f"Expected known of the shape of depth, {z.shape}, got {seen.shape}.")
    for name, one in (("contact", mask), ("known", seen)):
        if one.dtype != np.bool_:
            raise TypeError(f"Expected {name} as bool, got {one.dtype}. Convert it: {name} > 0.")
    pitch = None if mm_per_px is None else check_mm_per_px(mm_per_px)
    return contacts_of(np.ascontiguousarray(mask), z, pitch, seen)


def contacts_of(
    mask: Mask, z: Map, pitch: tuple[float, float] | None, seen: Mask
) -> tuple[tuple[Contact, ...], NDArray[np.uint16]]:
    """`contacts_from_mask` of a depth (H, W) that is float32 and finite, and masks; all in C order."""
    most = min(mask_regions(mask.shape), MOST_LABELS)
    labels, moments = np.empty(mask.shape, np.uint16), np.empty((most, MOMENTS))
    count = _contact_moments(mask, z, labels, moments, np.empty(runs_work(mask.shape), np.int32))
    moments, unsure = moments[: _checked_count(count)], [False] * count
    if not seen.all():
        of_known = np.empty((count, MOMENTS))
        _region_moments(labels * seen, z, of_known)
        for k in np.flatnonzero(of_known[:, 0] < moments[:, 0]):  # regions with unknown pixels
            if of_known[k, 0]:
                moments[k, 7:10] = of_known[k, 7:10]
            place = int(moments[k, 8]), int(moments[k, 9])
            unsure[k] = may_be_deeper((labels == k + 1) & ~seen, z, place)
    rows = zip(moments, unsure)
    found = [_contact(k, row, pitch, mask.shape, deeper) for k, (row, deeper) in enumerate(rows, start=1)]
    return tuple(sorted(found, key=lambda one: (-one.area_px, one.label))), labels


def off_rest(
    depth: Map,
    range_mm: tuple[float, float],
    sigma: Map | None,
    contact: Mask,
    known: Mask,
    unknown: Sequence[Finding] = (),
) -> tuple[Finding, ...]:
    """One finding if depth (H, W) is off 0 where no contact (H, W) makes it so: a valley deeper than any contact, or a hill.

    Up to what gel that looks at rest is known to, `REST_SIGMA_MM`, nothing is said. `range_mm` is that of the known depth,
    `sigma` (H, W) its deviation. A hill is that of a touch where `unknown` contacts are found, which tell its height.
    """
    low, high = range_mm
    hill = 0.0 if contact.any() or unknown else high
    off_mm = max(hill, -low if -low > high else 0.0)
    if off_mm <= REST_SIGMA_MM:
        return ()
    what = "no contact is sure, yet the gel seems pressed in" if off_mm == hill else "the gel seems to rise"
    peak = _peak(depth if off_mm == hill else -depth, sigma, known)
    message = (
        f"Depth is off: {what} by {peak}. It is noise where light is weak, a border that is read wrong, or a touch too "
        "faint to tell."
    )
    return (Finding("off_rest", message, off_mm),)


def _peak(depth: Map, sigma: Map | None, known: Mask) -> str:
    """The largest known depth in words: its figure, its deviation if known, its place."""
    y, x = divmod(int(np.argmax(np.where(known, depth, 0))), depth.shape[1])
    sure = "" if sigma is None else f" +- {sigma[y, x]:.2f}"
    return f"{depth[y, x]:.2f}{sure} mm at ({x}, {y}) px"


UNKNOWN_SHARE = 1 / 3  # of a touched region, from which it is named


def unknown_contact(
    contact: Mask,
    depth: Map,
    sigma: Map | None,
    at_rest: Mask,
    known: Mask,
    is_touched: Callable[[], object],
    hidden: Mask | None = None,
    pitch: float = 1.0,
) -> tuple[Finding, ...]:
    """One finding for each touched region of which much is unknown, or one if many known pixels changed without a contact.

    A touched region is contact (H, W) with the unknown pixels that join it, or such pixels alone: their color is not that
    of rest, and the depth (H, W) filled in there exceeds its deviation. Those that are small beside another touched region,
    such as dust, and pixels that markers or lost parts hide (H, W) do not count.

    `is_touched` says whether the image has the structure of a touch: compressed video changes many colors a little.
    """
    found: tuple[Finding, ...] = ()
    if not known.all():
        found = _unknown_regions(contact, known, at_rest, hidden, depth, sigma, MIN_AREA_MM2 / pitch**2)
    if contact.any():
        return found
    if not found:
        touched = float(np.count_nonzero(known & ~at_rest)) / max(float(np.count_nonzero(known)), 1.0)
        if touched < 0.05 or not is_touched():  # noise leaves the color of rest at 0.1 %
            return ()
        message = (
            f"Something touches the gel: {100 * touched:.0f} % of it changed. Where it presses and how deep is not known, "
            "because the slopes there are not."
        )
        found = (Finding("contact_unknown", message, touched),)
    reads = f"Depth reads up to {_peak(depth, sigma, known)}."
    return replace(found[0], message=f"{found[0].message} {reads}"), *found[1:]


def _unknown_regions(
    contact: Mask,
    known: Mask,
    at_rest: Mask,
    hidden: Mask | None,
    depth: Map,
    sigma: Map | None,
    least_px: float,
) -> tuple[Finding, ...]:
    """The findings of touched regions of which `UNKNOWN_SHARE` or more is unknown, the largest region first."""
    size, words = depth.size, runs_work(depth.shape)
    sums, work = np.empty((int(size / max(least_px, 1)) + 1, 4)), np.empty(words + -(-size // 4), np.int32)
    # Regions stand as those of a contact do.
    count = _touched_regions(
        contact, known, at_rest, hidden, depth, sigma, sums, work, factor=2**0.5 * NOISE_FACTOR, least=least_px,
        least_unknown=UNKNOWN_SHARE * least_px,
    )  # fmt: skip
    pixels, unknown, x, y = sums[:count].T
    share = unknown / pixels
    named = np.flatnonzero((share >= UNKNOWN_SHARE) & (pixels > UNKNOWN_SHARE * pixels.max(initial=0)))
    order = [int(k) for k in named[np.argsort(-pixels[named], kind="stable")]]
    return tuple(
        Finding(
            "contact_unknown",
            f"{100 * share[k]:.0f} % of what touches the gel around ({x[k] / pixels[k]:.0f}, {y[k] / pixels[k]:.0f}) px are "
            "unknown, because the slopes there are. It may be deeper, and its area is not that of the contact.",
            float(share[k]),
        )
        for k in order
    )


def _checked_count(regions: int) -> int:
    if regions > MOST_LABELS:
        raise ValueError(f"Expected at most 65535 separate contacts, got {regions}: is this noise?")
    return regions


def runs_work(shape: tuple[int, ...]) -> int:
    """Words of memory for the largest number of runs of pixels that a map (H, W) can have: five a run, as in runs.h."""
    return 5 * shape[0] * ((shape[1] + 1) // 2)


def mask_regions(shape: tuple[int, ...]) -> int:
    """The largest number of regions that a mask (H, W) can have."""
    return ((shape[0] + 1) // 2) * ((shape[1] + 1) // 2)


def _contact(
    label: int, row: Numbers, pitch: tuple[float, float] | None, shape: tuple[int, ...], deeper: bool
) -> Contact:
    """A region of the moments that `region_moments` sums; without measures in mm if there is no pitch."""
    count, x, y, xx, xy, yy, volume, deepest, deepest_x, deepest_y, left, right, top, bottom = row.tolist()
    center, (x_mm, y_mm) = (x / count, y / count), pitch or (1.0, 1.0)
    # A pixel is a square, not a point: its own second moment is 1/12.
    a = (xx / count - center[0] ** 2 + PIXEL_VARIANCE) * (x_mm * x_mm)
    b = (xy / count - center[0] * center[1]) * (x_mm * y_mm)
    d = (yy / count - center[1] ** 2 + PIXEL_VARIANCE) * (y_mm * y_mm)
    mean, apart = (a + d) / 2, hypot((a - d) / 2, b)
    in_mm: dict[str, Any] = {
        "area_mm2": count * x_mm * y_mm,
        "volume_mm3": volume * x_mm * y_mm,
        "deepest_mm": deepest,
        "axes_mm": tuple(4 * sqrt(max(square, 0.0)) for square in (mean + apart, mean - apart)),
    }
    return Contact(
        label=label,
        area_px=int(count),
        centroid_px=center,
        deepest_px=(int(deepest_x), int(deepest_y)),
        angle_deg=degrees(atan2(2 * b, a - d)) / 2,
        cut_by_border=left == 0 or top == 0 or right == shape[1] - 1 or bottom == shape[0] - 1,
        at_least=deeper,
        **(in_mm if pitch else {}),
    )


_color_around = Kernel(
    "color_around",
    "u8[h,w,3]? pixels, f32[h,w,3]? levels, bool[h,w] contact, f32[r,c,3] gain, f32[r,c,3] rest, out f32[r,c,3] coarse, "
    "out f32[n] work, out f32[2] changes",
)


class Surround:
    """Compares the color around a contact with that inside it, for the images of one background (H, W, 3), 0-255.

    The images are as they came: correcting the exposure would hide the change of light around a large soft contact.
    """

    def __init__(self, background: Map) -> None:
        height, width = background.shape[:2]
        step = max(1, height // 40)  # to 40 rows: the measure is one of large areas
        shape = height // step, width // step, 3
        self._gain, self._at_rest = np.ones(shape, np.float32), np.zeros(shape, np.float32)
        rest, *_ = self._changes(background, np.zeros((height, width), np.bool_))
        self._gain = 1 / (rest + np.float32(CHANGE_OFFSET))
        self._at_rest = rest * self._gain

    def __call__(self, image: NDArray[np.number], contact: Mask) -> tuple[float | None, float | None]:
        """Median change outside a contact (H, W), mean change inside, RMS of a channel; None if there is no such part."""
        _, (outside, inside), parts = self._changes(image, contact)
        return outside if parts & 1 else None, inside if parts & 2 else None

    def _changes(self, image: NDArray[np.number], contact: Mask) -> tuple[Map, list[float], int]:
        """The coarse image, what changed, and which parts there are, as `color_around` says it."""
        # Means of four pixels: a mean of all would take thirty times as long, and the measures are of large areas.
        pixels = image if image.dtype == np.uint8 else None
        levels = np.ascontiguousarray(image, dtype=np.float32) if pixels is None else None
        coarse, changes = np.empty_like(self._gain), np.empty(2, np.float32)
        work = np.empty(coarse.size + 2 * coarse.shape[1], dtype=np.float32)
        parts = _color_around(pixels, levels, contact, self._gain, self._at_rest, coarse, work, changes)
        return coarse, changes.tolist(), parts


MOMENTS = 14  # sums of a region
MOST_LABELS = np.iinfo(np.uint16).max
# Chosen on every second or third press of six real sensors and on three simulated ones, so that one ball is one contact and
# frames at rest have none; docs/contacts.md shows the other frames.
NOISE_FACTOR = 3.5  # standard deviations: pressures over the noise at rest, depths of regions over their own
MIN_AREA_MM2 = 0.05  # mm^2, area of the smallest contact
SMOOTHING_PX = 0.7  # px, standard deviation of the Gaussian that smooths before the Laplacian
NEIGHBORHOOD_PX = 4  # px, half the width of the square around a pixel that means are taken over

_contact_mask = Kernel(
    "contact_mask",
    "f32[h,w] depth, f32[3,r,c]? variances, bool[h,w]? lost, out f32[2,h,w] sigmas, f32[h,w] noise, f32[h,w]? read, "
    "f32[h,w]? solved, bool[h,w]? at_rest, bool[h,w]? known, f32[t] taps, f64[4]? gains, f32[u] influence, "
    "out bool[h,w] contact, out f32[n] work, f64 least, f32 most, f32 along_x, f32 along_y, f32 stiffness, f32 factor, "
    "f32 reach, i64 margin, i64 join, i64 step",
)


class SlopeDeviations(NamedTuple):
    """Standard deviations (H, W) of a frame's slopes, mm/mm, and where they hold."""

    read: Map  # of the slopes as they were read from the image; taken at rest
    solved: Map  # of the slopes of the solved depth; taken elsewhere
    at_rest: Mask  # (H, W) bool, pixels at rest


def contact_from_depth(
    depth_mm: ArrayLike,
    *,
    mm_per_px: float | Sequence[float],
    depth_sigma_mm: ArrayLike | None = None,
    relaxation_mm: float | None = None,
    noise_factor: float = NOISE_FACTOR,
    min_area_mm2: float = MIN_AREA_MM2,
) -> Mask:
    """The pixels where something touches the gel.

    Beside an object only the gel holds its surface: a membrane under tension on an elastic bed, whose depth z
    falls off as `laplace(z) = z/L^2` (Kerr, J. Appl. Mech. 31, 1964). The pressure over the membrane's tension,
    `p = z/L^2 - laplace(z)`, is 0 there and positive in the contact, for a ball as for a flat face. A pixel counts where p
    exceeds its own standard deviation and `noise_factor` times the noise at rest; of a pressure that varies around the pixel
    no more than noise does, the mean counts (Lee, IEEE Trans. PAMI 2, 1980). A contact ends where p is two thirds of its
    mean around the pixel. So gel that an object draws down is no contact, and hollow contacts stay hollow. Narrow gaps
    and holes of any size where p is more than half of a plane face's, `z/L^2`, belong to the contact.

    A connected region of such pixels stands if its depth over the gel around exceeds `noise_factor` of its own standard
    deviations, and so do the evidence `p/sd(p)` of a pixel and the depth that the region's own pressure makes. A pressure
    makes the depth `K0(r/L)/(2 pi)` at the distance r. Negative depths tell how much noisier a frame is than
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
    if relaxation_mm is not None:
        length = check_positive(relaxation_mm, "relaxation_mm")
        check_within(length, "relaxation_mm", 1e-3, 1e3)  # mm; anything else is a typing error
    factor, area = check_number(noise_factor, "noise_factor"), check_number(min_area_mm2, "min_area_mm2")
    if not (factor > 0 and area >= 0):
        raise ValueError(
            f"Expected noise_factor > 0 and min_area_mm2 >= 0, got {noise_factor} and {min_area_mm2}."
        )
    pitch, noise, sigma = check_mm_per_px(mm_per_px), np.ones_like(depth), None
    if depth_sigma_mm is not None:
        sigma = check_map(depth_sigma_mm, "depth_sigma_mm", shape=depth.shape, nonnegative=True)
    return PreparedContact(pitch, relaxation_mm, noise, None, noise_factor, min_area_mm2)(depth, sigma)


class PreparedContact:
    """`contact_from_depth` for the frames of one sensor: float32, finite, in C order. Immutable; threads can share it.

    A region stands by its own uncertainty. Its depth has to exceed `noise_factor` of its standard deviations: its deepest
    depth, and the depth of the region's own pressure, as gel that another object draws down has depth without pressure of
    its own. So does the pressure of a pixel.

    No contact makes a negative depth. What negative depths have more than their standard deviations say, as of dust or of
    another light, is the frame's own noise, and counts as one more error of the depth that a region makes. Beside the
    deepest region it may be its reaction, so that region may have a deviation without it.
    """

    def __init__(
        self,
        pitch: tuple[float, float],  # (x, y), mm
        relaxation_mm: float | None,  # of the gel; None if unknown
        noise: Map,  # (H, W), variance of a slope at rest; without `correlation` only its ratios count
        correlation: Mapping[str, Any] | None = None,  # of `SlopeSigma`; None: each frame's noise is measured
        noise_factor: float = NOISE_FACTOR,
        min_area_mm2: float = MIN_AREA_MM2,
    ) -> None:
        # mm, of a gel that no press showed: the longest of six sensors (0.41 to 0.86). A shorter length than the gel's takes
        # gel that is drawn down for contact.
        length = relaxation_mm or 0.86
        reach_px = length / max(pitch)  # an object's depth reaches about as far beyond it
        self._pitch, self._length_mm = pitch, length
        # Beside a border, means are taken over fewer pixels that have a pressure of their own.
        side, inner = 2 * NEIGHBORHOOD_PX + 1, np.zeros_like(noise)
        margin = _margin(noise.shape)
        inner[margin : noise.shape[0] - margin, margin : noise.shape[1] - margin] = 1
        count = cv2.boxFilter(inner, -1, (side, side), normalize=False, borderType=cv2.BORDER_CONSTANT)
        self._noise = noise * (np.float32(side**2) / np.maximum(count, 1))
        # The square that means are taken over smooths once more, by its own standard deviation.
        smoothings = np.hypot(SMOOTHING_PX, [np.sqrt((side**2 - 1) * PIXEL_VARIANCE), 0])
        self._gains = None if correlation is None else _gains(pitch, smoothings, **correlation)
        self._taps = blur_taps(SMOOTHING_PX)
        self._numbers = {
            "least": min_area_mm2 / (pitch[0] * pitch[1]), "along_x": pitch[0] ** -2, "along_y": pitch[1] ** -2,
            "stiffness": length**-2, "factor": noise_factor, "reach": reach_px, "margin": margin, "join": NEIGHBORHOOD_PX,
            "step": max(1, noise.size // MEDIAN_SAMPLES),
        }  # fmt: skip
        # Three maps and labels, five maps and a mask, and what takes the most: sums of as many over squares, a sample, or
        # runs beyond four maps.
        size, maps, rows, width = noise.size, 5, 2 * NEIGHBORHOOD_PX + 4, noise.shape[1] + 2 * LANES
        sums, sample = (maps * rows + 2) * width, 2 * -(-size // self._numbers["step"])
        most = max(sums, sample, runs_work(noise.shape) - 4 * size)
        self._work_size = (3 + maps) * size + -(-size // 2) + -(-size // 4) + most

    def __call__(
        self,
        depth: Map,  # (H, W), mm
        sigma: Map | None,  # (H, W), mm, its standard deviation >= 0
        slopes: SlopeDeviations | None = None,
        known: Mask | None = None,  # (H, W), pixels whose depth was not filled in
    ) -> Mask:
        """The contact mask (H, W) of a depth."""
        if sigma is None:  # the median of negative depths tells the noise, as of half a Gaussian
            sample = depth.ravel()[:: max(1, depth.size // MEDIAN_SAMPLES)]
            below = sample[sample < 0]
            sigma = np.full_like(depth, -SIGMA_OF_MEDIAN * float(np.median(below)) if below.size else 0.0)
        return self._contact(depth, np.stack([sigma, sigma]), slopes, known)

    def judged(
        self,
        depth: Map,
        variances: Map,  # (3, r, c), mm^2: by which regions stand, outlines are drawn, and the deepest region stands
        most_mm: float,  # of their roots, and at lost pixels (H, W)
        lost: Mask | None,
        slopes: SlopeDeviations | None = None,
        known: Mask | None = None,
    ) -> tuple[Mask, Map]:
        """The contact mask (H, W) of a frame's depth whose errors are known, and the deviation (H, W) by which it stands."""
        sigmas = np.empty((2, *depth.shape), dtype=np.float32)
        return self._contact(depth, sigmas, slopes, known, variances, most_mm, lost), sigmas[0]

    def _contact(
        self,
        depth: Map,
        sigmas: Map,  # (2, H, W), by which regions stand, and outlines are drawn; made of variances if there are any
        slopes: SlopeDeviations | None,
        known: Mask | None,
        variances: Map | None = None,
        most_mm: float = np.inf,
        lost: Mask | None = None,
    ) -> Mask:
        of_slopes: tuple[Any, ...] = (None,) * 3 if slopes is None else slopes
        contact = np.empty(depth.shape, dtype=np.bool_)
        _checked_count(_contact_mask(
            depth, variances, lost, sigmas, self._noise, *of_slopes,
            None if known is None or known.all() else known, self._taps, self._gains, self._influence, contact,
            np.empty(self._work_size, dtype=np.float32), most=most_mm, **self._numbers,
        ))  # fmt: skip
        return contact

    @once
    def _influence(self) -> Floats:
        """Depth, mm, that a pressure of 1/mm on a pixel makes, by squared distance in pixels of mean size."""
        area = self._pitch[0] * self._pitch[1]
        # px^2. Beyond six relaxation lengths a pressure's depth is a thousandth; no contact is a thousand pixels wide. At 0
        # the logarithm is that of the mean over a disc of a pixel's area.
        reach = min((6 * self._length_mm) ** 2 / area, 1e6)
        squares = np.arange(int(reach) + 2, dtype=np.float64)
        squares[0] = 1 / (np.pi * np.e)
        depth = bessel_k(0, np.sqrt(squares * area) / self._length_mm) * area / (2 * np.pi)
        return np.asarray(depth, dtype=np.float32)

    def pressed_background(
        self,
        depth: Map,
        sigma: Map | None,
        slopes: SlopeDeviations | None = None,
        known: Mask | None = None,
        *,
        touched: bool = False,
    ) -> tuple[Finding, ...]:
        """One finding if a valley is deeper than any hill and looks like a contact turned over; arguments of `__call__`.

        `touched` is whether the frame has a contact.

        Such a valley is a contact of the background image. Beside a contact, the depth's errors are negative, too.
        """
        low, high = value_range(depth)
        if -low <= high:
            return ()
        turned = -depth
        valley = self(turned, sigma, slopes, known)
        # While something touches, a border that sinks is more likely read wrong, or drawn by the contact.
        valleys = contacts_from_mask(valley, turned, mm_per_px=1.0)[0]
        depths = [one.deepest_mm or 0.0 for one in valleys if not (touched and one.cut_by_border)]
        if not depths:
            return ()
        deepest = max(depths)
        message = (
            f"Something touches the gel in the background image: here the gel rises up to {deepest:.2g} mm over it, with a "
            "contact's outline. Take the background again, with nothing touching the gel."
        )
        return (Finding("background_pressed", message, deepest),)


def _margin(shape: tuple[int, ...]) -> int:
    """Width of the border, px, where the smoothed depth has no bend of its own."""
    margin = int(np.ceil(2 * SMOOTHING_PX))
    return margin if min(shape) > 2 * margin else 0


def _gains(
    pitch: tuple[float, float],
    smoothings: Floats,
    correlation_px: float,
    correlated_share: float,
    rest_correlation_px: float,
    rest_correlated_share: float | None,
) -> Numbers:
    """Variance of the pressure of gel at rest, and elsewhere, for a variance of the slopes of 1; of each smoothing."""
    per_mm2 = (pitch[0] ** -2 + pitch[1] ** -2) / 2
    share_at_rest = correlated_share if rest_correlated_share is None else rest_correlated_share
    found = [
        per_mm2 * (share * _divergence(correlation_px, s) + (1 - share) * _divergence(near, s))
        for s in smoothings
        for share, near in ((share_at_rest, rest_correlation_px), (correlated_share, 0.0))
    ]
    return np.array(found, dtype=np.float64)


def _divergence(length: float, smoothing: float) -> float:
    """Variance, 1/px^2, of the divergence of slopes of variance 1, correlated over a length and smoothed, both px.

    A Gaussian correlation gives `2 l^2 / (2 s^2 + l^2)^2`; white noise, a pixel wide, `1 / (4 pi s^4)`. A slope is the mean
    of two pixels' and the divergence a difference, which smooth by a quarter of a squared pixel.
    """
    square = smoothing**2 + 0.25
    return 2 * length**2 / (2 * square + length**2) ** 2 if length > 0.5 else 1 / (4 * np.pi * square**2)
