"""What an inspector measures on a result: steps, grooves, radii, angles, flatness, roughness, each with its sigma.

Nearly all of it follows from depth by a linear law, for small changes: `value + sum(weights * change of depth)`. The weights
decide which errors count. Errors of single slopes pass through the solver (`ShapeErrors.slope_sigma`); errors that slopes
share change the surface in proportion; the scale changes every length; and the blur of the image, as if it came once more,
lowers what is narrow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike

from gelform.arrays import Array, Mask, Numbers
from gelform.depth.coarse import coarse_of
from gelform.depth.sigma import DOUBTED
from gelform.errors import GelformError
from gelform.foundations.checks import check_choice, check_is, check_mask, check_numbers
from gelform.result.metrics import LEAST_PX, Roughness, angle_deg, areal_roughness
from gelform.result.record import Reconstruction

ROUND = {"ball": 4, "cylinder": 5}  # free parameters
UM_PER_MM = 1e3
Line = tuple[float, float, float, float]


@dataclass(frozen=True)
class Quantity:
    """One figure that was measured.

    Attributes
    ----------
    of : what it was measured on, such as "line 1", "region 2", or "region 2 - region 1"
    name : "step", "depth", "width", ...
    value : in the unit; None if it cannot be measured, and `doubts` says why
    sigma : one standard deviation; None if unknown
    unit : "mm", "um", "deg" or "%"
    doubts : sentences that say what the figure does not hold for
    """

    of: str
    name: str
    value: float | None
    sigma: float | None
    unit: str
    doubts: tuple[str, ...] = ()


@dataclass(frozen=True)
class Profile:
    """The depth along a line, and what was measured on it.

    Attributes
    ----------
    line : (x1, y1, x2, y2), px
    distance_mm, depth_mm : (N,), from the first end
    known : (N,) bool
    base_mm : (N,), depth of the surface beside the groove or ridge, continued across it; None if there is neither
    height_mm : of the ridge over the base, negative for a groove
    edges_mm : distances at half of it
    """

    line: Line
    distance_mm: Numbers
    depth_mm: Numbers
    known: Mask
    base_mm: Numbers | None = None
    height_mm: float | None = None
    edges_mm: tuple[float, float] | None = None


@dataclass(frozen=True)
class Measured:
    """All that was measured on a result: its figures, the profiles of its lines and the pixels of its regions."""

    quantities: tuple[Quantity, ...]
    profiles: tuple[Profile, ...]
    regions: tuple[Mask, ...]


def measure(
    result: Reconstruction,
    *,
    lines: Sequence[Sequence[float]] = (),
    regions: Sequence[ArrayLike] = (),
    radius: str | None = None,
) -> Measured:
    """Measure lines and regions of a result, each figure with its standard deviation.

    A line gives its length, how much deeper its second end is, and the groove or ridge that it crosses: depth or height,
    width at half of it, and the angles of its flanks. A region gives its depth, flatness and roughness, and, if asked for, the
    radius of a ball or cylinder. Each region after the first gives its step from the first one, and the angle that both
    faces enclose. Without lines and regions, the contact is the region.

    Parameters
    ----------
    result : with mm_per_px
    lines : (x1, y1, x2, y2) each, px, from one shoulder of a groove across it to the other, or the same with a ridge
    regions : (x1, y1, x2, y2) each, px, opposite corners, both included; or a mask (H, W) bool
    radius : "ball" or "cylinder", fitted to the pixels of each region

    Returns
    -------
    measured : Measured

    Raises
    ------
    ValueError, TypeError
        A line or region that is no four numbers or outside the image, a line shorter than two pixels, a region without ten
        known pixels, a radius of another name.
    GelformError
        The result has no scale, or its pixels are not square.

    Notes
    -----
    Depth and width of a groove are those of ISO 5436-1, types A1 and A2: a line through both shoulders and, over the middle
    third of the width, a parabola, fitted together by least squares. The shoulders are from one to two widths off the middle.
    Flatness is the distance of the highest and lowest point from the least-squares plane (ISO 12781). Roughness is that of
    `areal_roughness` (ISO 25178-2).
    """
    surface = _Surface(check_is(result, Reconstruction, "result"))
    if radius is not None:
        check_choice(radius, ROUND, "a radius")
    checked = [surface.line(one) for one in lines]
    masks = [surface.region(one) for one in regions]
    named = [f"region {k + 1}" for k in range(len(masks))]
    if not lines and not regions and result.contact.any():
        masks, named = [surface.region(result.contact)], ["contact"]
    quantities: list[Quantity] = []
    profiles = []
    for k, line in enumerate(checked):
        profile, found = _along(surface, line, f"line {k + 1}")
        profiles.append(profile)
        quantities += found
    for mask, name in zip(masks, named):
        quantities += _of_region(surface, mask, name, radius)
    for mask, name in zip(masks[1:], named[1:]):
        quantities += _between(surface, masks[0], mask, f"{name} - {named[0]}")
    return Measured(tuple(quantities), tuple(profiles), tuple(masks))


class _Surface:
    """The depth of a result, and the standard deviations of what follows from it."""

    def __init__(self, result: Reconstruction) -> None:
        self.result, self.z = result, result.depth_mm.astype(np.float64)  # raises without a scale
        if not isinstance(result.mm_per_px, float):
            raise GelformError(f"Expected square pixels to measure on, got mm_per_px={result.mm_per_px}.")
        self.pitch, self.known = result.mm_per_px, result.known
        self.scale = (result.mm_per_px_sigma or 0.0) / self.pitch
        self.errors = errors = result.shape_errors
        self.slopes_sigma = result.gradients_sigma
        if errors is not None and self.slopes_sigma is not None:
            at_pixels = coarse_of(result.shape).at_pixels
            self.common = [at_pixels(one) for one in errors.common_mm]
            # The camera and the gel blur the image as well; the change's blur was chosen to be no less.
            blur_px = np.sqrt(2) * errors.blur_px
            self.lost_to_blur = scipy.ndimage.gaussian_filter(self.z, blur_px, mode="nearest") - self.z
        else:
            self.errors = None

    def line(self, ends: Sequence[float]) -> Line:
        """The ends of a line, px, inside the image."""
        x1, y1, x2, y2 = self._inside(ends, "a line")
        if np.hypot(x2 - x1, y2 - y1) < 2:
            raise ValueError(f"Expected a line of at least 2 px, got {_said(ends)}.")
        return x1, y1, x2, y2

    def region(self, given: ArrayLike) -> Mask:
        """The known pixels (H, W) of a region."""
        if np.ndim(given) == 2:
            mask = check_mask(given, shape=self.z.shape, name="a region")
        else:
            x1, y1, x2, y2 = (round(one) for one in self._inside(given, "a region"))
            mask = np.zeros(self.z.shape, dtype=bool)
            mask[min(y1, y2) : max(y1, y2) + 1, min(x1, x2) : max(x1, x2) + 1] = True
        if np.count_nonzero(mask & self.known) < 10:
            raise ValueError(f"Expected a region of at least 10 known pixels, got {_said(given)}.")
        return np.asarray(mask & self.known)

    def _inside(self, ends: Any, what: str) -> tuple[float, ...]:
        found = tuple(float(one) for one in check_numbers(ends, what, 4))
        height, width = self.z.shape
        if not all(-0.5 <= x <= width - 0.5 and -0.5 <= y <= height - 0.5 for x, y in (found[:2], found[2:])):
            raise ValueError(
                f"Expected {what} X1,Y1,X2,Y2 in pixels of the image, 0-{width - 1} and 0-{height - 1}, got {_said(ends)}."
            )
        return found

    def quantity(
        self, of: str, name: str, value: float, weights: Numbers, unit: str = "mm", doubts: Sequence[str] = ()
    ) -> Quantity:
        """A figure that grows by `sum(weights * change of depth in mm)`; the weights (H, W) have the sum 0."""
        value = float(value)
        if self.errors is None or self.slopes_sigma is None:
            return Quantity(of, name, value, None, unit, tuple(doubts))
        errors, used = self.errors, weights != 0
        slopes = self.pitch * errors.slope_sigma(weights, self.slopes_sigma)
        common = np.sqrt(sum(float(np.sum(weights[used] * one[used])) ** 2 for one in self.common))
        gain = errors.gain_sigma * abs(float(np.sum(weights[used] * self.z[used])))
        blur = abs(float(np.sum(weights[used] * self.lost_to_blur[used])))
        scale = 0.0 if unit == "deg" else self.scale * abs(value)
        rest = np.sqrt(slopes**2 + max(common, gain) ** 2 + scale**2)
        if blur > rest:
            doubts = [*doubts, "It is as narrow as the image is sharp, so most of its sigma is the blur."]
        return Quantity(of, name, value, float(np.hypot(rest, blur)), unit, tuple(doubts))

    def doubts_of(self, mask: Mask) -> tuple[str, ...]:
        """What makes a figure of these pixels doubtful."""
        said = []
        if self.slopes_sigma is not None:
            steep = float(np.mean(self.slopes_sigma[mask].max(axis=-1) > DOUBTED))
            if steep > 0.5:
                said.append(
                    "Most of it is steeper than presses have shown, or of colors that no slope gives."
                )
        return tuple(said)


def _said(given: Any) -> str:
    return ",".join(f"{one:g}" for one in np.ravel(given)) if np.size(given) < 9 else "a mask"


def _along(surface: _Surface, line: Line, of: str) -> tuple[Profile, list[Quantity]]:
    """The profile of a line and its figures."""
    x1, y1, x2, y2 = line
    length_px = float(np.hypot(x2 - x1, y2 - y1))
    count = int(np.ceil(length_px)) + 1
    x, y = np.linspace(x1, x2, count), np.linspace(y1, y2, count)
    sampled = _Samples(surface, x, y)
    s = np.linspace(0, length_px * surface.pitch, count)
    profile = Profile(line, s, sampled.depth, sampled.known)
    apart = sampled.weights(np.eye(count)[-1] - np.eye(count)[0])
    rise = sampled.depth[-1] - sampled.depth[0]
    ends = () if sampled.known[[0, -1]].all() else ("Depth at an end is not known.",)
    quantities = [
        Quantity(of, "length", float(s[-1]), float(s[-1] * surface.scale) or None, "mm"),
        surface.quantity(of, "rise", rise, apart, doubts=ends),
    ]
    shape = _shape_on(s, sampled.depth)
    if shape is None:
        why = "It has no groove or ridge with both shoulders. Draw it across, from one shoulder to the other."
        return profile, [*quantities, Quantity(of, "depth", None, None, "mm", (why,))]
    doubts = list(surface.doubts_of(sampled.pixels))
    unknown = 1 - float(sampled.known.mean())
    if unknown > 0:
        doubts.append(f"Depth is not known on {100 * unknown:.0f} % of the line.")
    groove = shape.height < 0
    touched = float(surface.result.contact[sampled.rows[shape.middle], sampled.columns[shape.middle]].mean())
    untouched = (
        [] if touched > 0.5 else ["Nothing touches its middle: the gel spans it, so the object is deeper."]
    )
    name = "depth" if groove else "height"
    quantities.append(
        surface.quantity(
            of, name, abs(shape.height), np.sign(shape.height) * sampled.weights(shape.of_height),
            doubts=[*doubts, *(untouched if groove else [])],
        )
    )  # fmt: skip
    width = shape.right - shape.left
    crossing = sampled.crossing_deg(surface, shape)
    width_doubts = list(doubts)
    found = surface.quantity(of, "width", width, sampled.weights(shape.of_width), doubts=doubts)
    too_wide = width * (1 - np.cos(np.deg2rad(crossing)))
    if found.sigma is not None and too_wide > found.sigma:
        width_doubts.append(
            f"The line is {crossing:.0f}° off perpendicular, which makes it {too_wide:.3f} mm too wide."
        )
        found = surface.quantity(of, "width", width, sampled.weights(shape.of_width), doubts=width_doubts)
    quantities.append(found)
    for side, (flank, weights) in zip(("left", "right"), shape.flanks):
        pixels = sampled.pixels_of(weights != 0)
        quantities.append(
            surface.quantity(
                of, f"{side} flank", np.rad2deg(flank), np.rad2deg(sampled.weights(weights)), "deg",
                surface.doubts_of(pixels),
            )
        )  # fmt: skip
    found_profile = Profile(
        line, s, sampled.depth, sampled.known, shape.base, shape.height, (shape.left, shape.right)
    )
    return found_profile, quantities


class _Samples:
    """Depth (N,) at points of a line, linear between pixels."""

    def __init__(self, surface: _Surface, x: Numbers, y: Numbers) -> None:
        height, width = surface.z.shape
        x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
        column, row = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
        u, v = x - column, y - row
        self.shape, self.direction = surface.z.shape, np.array([x[-1] - x[0], y[-1] - y[0]])
        self.rows, self.columns = np.rint(y).astype(int), np.rint(x).astype(int)
        self._rows = np.stack([row, row, row + 1, row + 1])
        self._columns = np.stack([column, column + 1, column, column + 1])
        self._shares = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
        self.depth = np.sum(self._shares * surface.z[self._rows, self._columns], axis=0)
        self.known = surface.known[self.rows, self.columns]
        self.pixels = self.pixels_of(np.ones(len(x), dtype=bool))

    def pixels_of(self, chosen: Mask) -> Mask:
        """The pixels (H, W) next to chosen points (N,)."""
        pixels = np.zeros(self.shape, dtype=bool)
        pixels[self.rows[chosen], self.columns[chosen]] = True
        return pixels

    def weights(self, of_samples: Numbers) -> Numbers:
        """Weights (H, W) of depth in a sum of the samples with weights (N,)."""
        weights = np.zeros(self.shape)
        np.add.at(weights, (self._rows, self._columns), self._shares * of_samples)
        return weights

    def crossing_deg(self, surface: _Surface, shape: _Shape) -> float:
        """Angle, degrees, between the line and the steepest slope of both flanks."""
        chosen = (shape.flanks[0][1] != 0) | (shape.flanks[1][1] != 0)
        slopes = surface.result.gradients[self.rows[chosen], self.columns[chosen]].astype(np.float64)
        _, axes = np.linalg.eigh(slopes.T @ slopes)
        along = abs(float(axes[:, 1] @ self.direction)) / float(np.linalg.norm(self.direction))
        return float(np.rad2deg(np.arccos(min(along, 1.0))))


@dataclass(frozen=True)
class _Shape:
    """A groove or ridge of a profile (N,), and how its figures depend on each sample."""

    base: Numbers
    height: float  # negative for a groove
    of_height: Numbers
    left: float
    right: float
    of_width: Numbers
    flanks: tuple[tuple[float, Numbers], tuple[float, Numbers]]  # angle to the base, rad, > 0
    middle: Mask  # samples of its middle third


def _shape_on(s: Numbers, z: Numbers) -> _Shape | None:
    """The largest groove or ridge of a profile; None if it lacks a shoulder."""
    base = z[0] + (z[-1] - z[0]) * (s - s[0]) / (s[-1] - s[0])
    height = float((z - base)[np.argmax(np.abs(z - base))])
    for _ in range(3):
        edges = _edges(z - base, height)
        if edges is None:
            return None
        left, right = (s[k] + t * (s[1] - s[0]) for k, t in edges)
        center, width = (left + right) / 2, right - left
        off = np.abs(s - center) / width
        beside, middle = (off >= 1) & (off <= 2), off <= 1 / 6
        if not all(np.any(beside & (side * (s - center) > 0)) for side in (-1, 1)) or not middle.any():
            return None
        used, inside = beside | middle, middle.astype(float)
        terms = np.stack([np.ones_like(s), s - center, inside, inside * (s - center) ** 2], axis=1)
        terms = terms[:, : 4 if np.count_nonzero(middle) > 3 else 3]
        solve = np.zeros((terms.shape[1], s.size))
        solve[:, used] = np.linalg.pinv(terms[used])
        constant, tilt, height = (float(one) for one in (solve @ z)[:3])
        base = constant + tilt * (s - center)
    edges = _edges(z - base, height)
    if edges is None:
        return None
    of_base = solve[0] + np.outer(s - center, solve[1])  # (N, N), of the base at each sample by each sample
    each, step, places, of_places, flanks = np.eye(s.size), s[1] - s[0], [], [], []
    for k, t in edges:
        # The place where depth passes base + height / 2 moves by what depth there lacks, over the slope.
        at = (1 - t) * (each[k] - of_base[k]) + t * (each[k + 1] - of_base[k + 1]) - solve[2] / 2
        places.append(float(s[k] + t * step))
        of_places.append(-at / ((z[k + 1] - base[k + 1] - z[k] + base[k]) / step))
        flanks.append(_flank(s, z - base, height, k, tilt, solve[1]))
    return _Shape(
        base,
        height,
        solve[2],
        places[0],
        places[1],
        of_places[1] - of_places[0],
        (flanks[0], flanks[1]),
        middle,
    )


def _edges(over: Numbers, height: float) -> tuple[tuple[int, float], tuple[int, float]] | None:
    """Sample before each place where a profile over its base passes half the height, and the fraction up to the next one."""
    if height == 0:
        return None
    share = over / height
    top = int(np.argmax(share))
    below = np.flatnonzero(share < 0.5)
    before, after = below[below < top], below[below > top]
    if not (before.size and after.size):
        return None
    left, right = int(before[-1]), int(after[0]) - 1
    found = [(k, float((0.5 - share[k]) / (share[k + 1] - share[k]))) for k in (left, right)]
    return found[0], found[1]


def _flank(
    s: Numbers, over: Numbers, height: float, k: int, tilt: float, of_tilt: Numbers
) -> tuple[float, Numbers]:
    """Angle, rad, of the straight line through a flank's middle half with the base, and its weights (N,)."""
    share = over / height
    first = last = k
    while first > 0 and 0.25 <= share[first] <= 0.75:
        first -= 1
    while last + 1 < s.size and 0.25 <= share[last + 1] <= 0.75:
        last += 1
    inside = np.arange(min(first + 1, k), max(last, k + 1) + 1)
    of_slope = np.zeros(s.size)
    of_slope[inside] = (s[inside] - s[inside].mean()) / np.sum((s[inside] - s[inside].mean()) ** 2)
    slope = float(of_slope @ over) + tilt
    angle = np.arctan(slope) - np.arctan(tilt)
    return abs(float(angle)), np.sign(angle) * (of_slope / (1 + slope**2) - of_tilt / (1 + tilt**2))


def _plane(surface: _Surface, mask: Mask) -> Numbers:
    """Weights (3, n) of the n depths of a region for their least-squares plane: depth at the middle, slopes dz/dx, dz/dy."""
    rows, columns = np.nonzero(mask)
    x, y = ((one - one.mean()) * surface.pitch for one in (columns, rows))
    return np.asarray(np.linalg.pinv(np.stack([np.ones_like(x), x, y], axis=1)))


def _of_region(surface: _Surface, mask: Mask, of: str, radius: str | None) -> list[Quantity]:
    """Depth, flatness, roughness and, if asked for, radius of a region."""
    result, doubts = surface.result, surface.doubts_of(mask)
    depth, sigma = surface.z[mask], None
    if result.depth_sigma_mm is not None:
        sigma = float(np.hypot(result.depth_sigma_mm[mask].mean(), surface.scale * depth.mean()))
    found = [Quantity(of, "depth", float(depth.mean()), sigma, "mm", doubts)]
    rows, columns = np.nonzero(mask)
    middle, slope_x, slope_y = _plane(surface, mask) @ depth
    x, y = ((one - one.mean()) * surface.pitch for one in (columns, rows))
    off = UM_PER_MM * (depth - middle - slope_x * x - slope_y * y)
    noise_um = _noise_um(surface, mask, 1)
    found.append(
        _beyond_noise(surface, of, "flatness", float(np.ptp(off)), "um", float(off.std()), noise_um, doubts)
    )
    if depth.size >= LEAST_PX:
        found += _roughness(surface, mask, of, doubts)
    if radius is not None:
        found.append(_radius(surface, mask, of, radius, doubts))
    return found


def _roughness(surface: _Surface, mask: Mask, of: str, doubts: tuple[str, ...]) -> list[Quantity]:
    """Sa, Sq and Sz of a region, as `gelform info` states them of the contact."""
    rough: Roughness = areal_roughness(surface.z, mm_per_px=surface.pitch, mask=mask)
    noise_um = _noise_um(surface, mask, 2)
    return [
        _beyond_noise(surface, of, name, getattr(rough, f"{name}_um"), "um", rough.Sq_um, noise_um, doubts)
        for name in ("Sa", "Sq", "Sz")
    ]


def _noise_um(surface: _Surface, mask: Mask, degree: int) -> float | None:
    """RMS, um, that errors of slopes give a flat region off its polynomial of a degree; None if unknown.

    The region counts as its box, whose cosine waves with up to `degree` half waves are the polynomial.
    """
    if surface.errors is None or surface.slopes_sigma is None:
        return None
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    height, width = int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    waves = surface.errors.waves(height, width)
    waves[np.add.outer(np.arange(height), np.arange(width)) <= degree] = 0
    slopes = float(np.mean(surface.slopes_sigma[mask].astype(np.float64) ** 2))
    return UM_PER_MM * surface.pitch * float(np.sqrt(slopes * waves.mean()))


def _beyond_noise(
    surface: _Surface, of: str, name: str, value: float, unit: str, rms_um: float, noise_um: float | None,
    doubts: tuple[str, ...],
) -> Quantity:  # fmt: skip
    """A figure of heights off their form, which noise can only raise: its sigma is what goes if noise is taken out."""
    if noise_um is None or surface.errors is None:
        return Quantity(of, name, value, None, unit, doubts)
    left = np.sqrt(max(1 - (noise_um / max(rms_um, noise_um)) ** 2, 0.0))
    sigma = value * np.sqrt((1 - left) ** 2 + surface.errors.gain_sigma**2 + surface.scale**2)
    if noise_um > rms_um / 2:
        doubts = (*doubts, f"Errors of slopes alone give {noise_um:.2g} um RMS.")
    return Quantity(of, name, value, float(sigma), unit, doubts)


def _between(surface: _Surface, first: Mask, second: Mask, of: str) -> list[Quantity]:
    """How much deeper the second region is, and the angle that both faces enclose."""
    doubts = tuple(dict.fromkeys((*surface.doubts_of(first), *surface.doubts_of(second))))
    apart = np.zeros(first.shape)
    apart[second] = 1 / np.count_nonzero(second)
    apart[first] -= 1 / np.count_nonzero(first)
    step = surface.quantity(of, "step", float(np.sum(apart * surface.z)), apart, doubts=doubts)
    planes = [_plane(surface, one)[1:] for one in (first, second)]
    slopes = np.concatenate([one @ surface.z[mask] for one, mask in zip(planes, (first, second))])

    def enclosed(given: Numbers) -> float:
        return 180 - float(angle_deg(given[:2], given[2:]))

    weights, small = np.zeros(first.shape), 1e-4
    for k, change in enumerate(small * np.eye(4)):
        by_slope = (enclosed(slopes + change) - enclosed(slopes - change)) / (2 * small)
        weights[(first, second)[k // 2]] += by_slope * planes[k // 2][k % 2]
    return [step, surface.quantity(of, "angle", enclosed(slopes), weights, "deg", doubts)]


def _radius(surface: _Surface, mask: Mask, of: str, kind: str, doubts: tuple[str, ...]) -> Quantity:
    """The radius of the ball or cylinder through a region, by least squares of the distances from it."""
    name = f"{kind} radius"
    rows, columns = np.nonzero(mask)
    x, y = ((one - one.mean()) * surface.pitch for one in (columns, rows))
    z = surface.z[mask]
    terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
    *_, xx, xy, yy = np.linalg.lstsq(terms, z, rcond=None)[0]
    bends, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    most = int(np.argmax(np.abs(bends)))
    bend = float(bends.mean() if kind == "ball" else bends[most])
    if bend == 0:
        return Quantity(of, name, None, None, "mm", (*doubts, "It is flat."))
    across = axes[:, most]
    points = np.stack([x, y, z], axis=1)

    def away(t: Array) -> Numbers:
        """Vectors (n, 3) from the ball's middle or the cylinder's axis."""
        if kind == "ball":
            return np.asarray(points - t[1:])
        turned, rise = t[3], t[4]
        u = np.array([np.cos(turned) * across[0] - np.sin(turned) * across[1],
                      np.sin(turned) * across[0] + np.cos(turned) * across[1], 0.0])  # fmt: skip
        along = np.array([-u[1], u[0], rise]) / np.hypot(1, rise)
        off = points - t[1] * u - np.array([0, 0, t[2]])
        return np.asarray(off - np.outer(off @ along, along))

    def distances(t: Array) -> Numbers:
        return np.asarray(np.linalg.norm(away(t), axis=1) - t[0])

    start = np.zeros(ROUND[kind])
    start[0], middle = 1 / abs(bend), float(z.mean()) + 1 / bend
    start[3 if kind == "ball" else 2] = middle
    fit = scipy.optimize.least_squares(distances, start)
    off = away(fit.x)
    by_depth = off[:, 2] / np.linalg.norm(off, axis=1)
    weights = np.zeros(mask.shape)
    weights[mask] = -np.linalg.pinv(fit.jac)[0] * by_depth
    found = surface.quantity(of, name, abs(float(fit.x[0])), weights, doubts=doubts)
    rms_um = UM_PER_MM * float(np.sqrt(np.mean(fit.fun**2)))
    noise_um = _noise_um(surface, mask, 2)
    if noise_um is not None and rms_um > 2 * noise_um:
        said = f"The surface is off a {kind} by {rms_um:.2g} um RMS, more than its errors explain."
        found = surface.quantity(of, name, abs(float(fit.x[0])), weights, doubts=(*doubts, said))
    return found
