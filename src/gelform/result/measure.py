"""What an inspector measures on a result: steps, grooves, radii, angles, flatness, roughness, each with its sigma.

A figure follows a small change of depth by a linear law, `sum(weights * change)`. Its weights decide which errors count:
errors of single slopes pass through the solver (`ShapeErrors.slope_sigma`), errors that slopes share change the surface in
proportion, the scale changes every length, and the blur of the image, as if it came once more, lowers what is narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import ArrayLike

from gelform.arrays import Array, Mask, Numbers
from gelform.depth.coarse import coarse_of
from gelform.depth.sigma import DOUBTED
from gelform.errors import GelformError
from gelform.foundations.checks import check_choice, check_is, check_mask, check_numbers
from gelform.result.metrics import LEAST_PX, angle_deg, areal_roughness
from gelform.result.record import Reconstruction

RADII = ("ball", "cylinder")
Doubts = tuple[str, ...]


@dataclass(frozen=True)
class Quantity:
    """One figure of a result."""

    of: str  # "line 1", "region 2", "region 2 - region 1", or "contact"
    name: str  # "step", "depth", "width", ...
    value: float | None  # None if it cannot be measured, and `doubts` say why
    sigma: float | None  # one standard deviation; None if unknown
    unit: str  # "mm", "um" or "deg"
    doubts: Doubts = ()  # sentences that say what it does not hold for

    def __str__(self) -> str:
        """The figure with its standard deviation, to two digits of that."""
        if self.value is None:
            return f"{self.name}: -"
        digits = max(0, 1 - int(np.floor(np.log10(self.sigma)))) if self.sigma else 3
        sigma = f" ± {self.sigma:.{digits}f}" if self.sigma else ""
        unknown = " (sigma unknown)" if self.sigma is None else ""
        return f"{self.name} {self.value:.{digits}f}{sigma} {self.unit}{unknown}"


@dataclass(frozen=True)
class Profile:
    """Depth (N,) along a line (x1, y1, x2, y2), px, and its groove or ridge, if there is one."""

    line: tuple[float, ...]
    distance_mm: Numbers  # from the first end
    depth_mm: Numbers
    known: Mask
    base_mm: Numbers | None = None  # the surface beside the groove or ridge, continued across it
    edges_mm: tuple[float, float] | None = None  # distances of both places at half its height


@dataclass(frozen=True)
class Measured:
    """The figures of a result, the profiles of its lines, and the pixels (H, W) of its regions."""

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
    """Measure along lines and in regions of a result, each figure with its standard deviation.

    A line gives its length, how much deeper its second end is, and the groove or ridge across it: depth or height, width at
    half of it, and the angles of both flanks. A region gives its depth, flatness and roughness, and the radius of a ball or
    cylinder if asked for. Each further region gives its step from the first one and the angle that both faces enclose.

    Parameters
    ----------
    result : with mm_per_px
    lines : (x1, y1, x2, y2) each, px, across a groove or ridge, from shoulder to shoulder
    regions : (x1, y1, x2, y2) each, px, opposite corners, both included; or a mask (H, W) bool. The contact if there are
        neither lines nor regions
    radius : "ball" or "cylinder", fitted to each region

    Raises
    ------
    ValueError, TypeError
        A line or region that is no four numbers or leaves the image, a line shorter than 2 px, a region of fewer than 10
        known pixels, another name of a radius.
    GelformError
        The result has no scale, or its pixels are not square.

    Notes
    -----
    A groove is measured as in ISO 5436-1, types A1 and A2: a line through both shoulders and a parabola over the middle
    third of the width are fitted together. Shoulders lie from one to two widths off the middle. Flatness is from the lowest
    to the highest point over the least-squares plane (ISO 12781-1). Roughness is that of ISO 25178-2.
    """
    surface = _Surface(check_is(result, Reconstruction, "result"))
    if radius is not None:
        check_choice(radius, RADII, "a radius")
    for name, given in (("lines", lines), ("regions", regions)):
        if not isinstance(given, list | tuple):
            raise TypeError(
                f"Expected {name} as a list, of x1, y1, x2, y2 each, got a {type(given).__name__}."
            )
    masks = {f"region {k + 1}": surface.region(one) for k, one in enumerate(regions)}
    profiles = [surface.along(one, f"line {k + 1}") for k, one in enumerate(lines)]
    if not lines and not regions and np.any(result.contact & result.known):
        masks = {"contact": surface.region(result.contact)}
    for of, mask in masks.items():
        surface.in_region(mask, of, radius)
    for of, mask in list(masks.items())[1:]:
        surface.between(masks["region 1"], mask, f"{of} - region 1")
    return Measured(tuple(surface.found), tuple(profiles), tuple(masks.values()))


class _Surface:
    """The depth of a result, and the figures that were found on it with their standard deviations."""

    def __init__(self, result: Reconstruction) -> None:
        self.result, self.z, self.found = result, result.depth_mm.astype(np.float64), list[Quantity]()
        if not isinstance(result.mm_per_px, float):
            raise GelformError(f"Expected square pixels to measure on, got mm_per_px={result.mm_per_px}.")
        self.pitch, self.known = result.mm_per_px, result.known
        self.scale = (result.mm_per_px_sigma or 0.0) / self.pitch
        self.errors, self.slopes_sigma = result.shape_errors, result.gradients_sigma
        self.lost_to_blur = np.zeros_like(self.z)
        if self.errors is not None:
            at_pixels = coarse_of(result.shape).at_pixels
            self.common, self.own = (
                [at_pixels(one) for one in maps] for maps in (self.errors.common_mm, self.errors.variance)
            )
            # The camera and the gel blur as well; the change's blur is meant to be no less.
            blur_px = np.sqrt(2) * self.errors.blur_px
            self.lost_to_blur = scipy.ndimage.gaussian_filter(self.z, blur_px, mode="nearest") - self.z

    def add(self, of: str, name: str, value: Any, sigma: Any, unit: str, doubts: Doubts = ()) -> None:
        """Note a figure."""
        value, sigma = (None if one is None else float(one) for one in (value, sigma))
        self.found.append(Quantity(of, name, value, sigma, unit, doubts))

    def linear(
        self, of: str, name: str, value: float, weights: Numbers, unit: str = "mm", doubts: Doubts = ()
    ) -> None:
        """Note a figure that grows by `sum(weights * change of depth in mm)`; the weights (H, W) have the sum 0."""
        if self.errors is None or self.slopes_sigma is None:
            return self.add(of, name, value, None, unit, doubts)
        slopes = self.pitch * self.errors.slope_sigma(weights, self.slopes_sigma)
        common = np.sqrt(sum(np.sum(weights * one) ** 2 for one in self.common))
        gain = self.errors.gain_sigma * abs(np.sum(weights * self.z))
        scale = 0.0 if unit == "deg" else self.scale * abs(value)
        sigma, blur = (
            np.sqrt(slopes**2 + max(common, gain) ** 2 + scale**2),
            np.sum(weights * self.lost_to_blur),
        )
        if abs(blur) > sigma:
            doubts = *doubts, "It is as narrow as the image is sharp: blur is most of its sigma."
        return self.add(of, name, value, np.hypot(sigma, blur), unit, doubts)

    def doubts(self, mask: Mask) -> Doubts:
        """What makes figures of these pixels (H, W) doubtful."""
        sigma = self.slopes_sigma
        if sigma is None or np.mean(sigma[mask].max(axis=-1) > DOUBTED) <= 0.5:
            return ()
        return ("Most of it is steeper than presses have shown, or of colors that no slope gives.",)

    def region(self, given: ArrayLike) -> Mask:
        """The known pixels (H, W) of a region."""
        if np.ndim(given) == 2:
            mask = check_mask(given, shape=self.z.shape, name="a region")
        else:
            x1, y1, x2, y2 = (round(one) for one in self._inside(given, "a region"))
            mask = np.zeros(self.z.shape, dtype=bool)
            mask[min(y1, y2) : max(y1, y2) + 1, min(x1, x2) : max(x1, x2) + 1] = True
        if (known := np.count_nonzero(mask & self.known)) < 10:
            raise ValueError(f"Expected a region of at least 10 known pixels, got {known}.")
        return np.asarray(mask & self.known)

    def _inside(self, given: Any, what: str) -> tuple[float, ...]:
        ends = tuple(float(one) for one in check_numbers(given, what, 4))
        height, width = self.z.shape
        if not all(-0.5 <= one <= size - 0.5 for one, size in zip(ends, (width, height) * 2)):
            said = ",".join(f"{one:g}" for one in ends)
            size = f"0-{width - 1} and 0-{height - 1}"
            raise ValueError(f"Expected {what} X1,Y1,X2,Y2 in pixels of the image, {size}, got {said}.")
        return ends

    def along(self, given: Sequence[float], of: str) -> Profile:
        """The profile of a line, linear between pixels; its figures are noted."""
        line = self._inside(given, "a line")
        along = np.array([line[2] - line[0], line[3] - line[1]])
        if (length_px := float(np.hypot(*along))) < 2:
            raise ValueError(f"Expected a line of at least 2 px, got {length_px:.2g} px.")
        s = np.linspace(0, length_px * self.pitch, int(np.ceil(length_px)) + 1)
        most = np.array(self.z.shape[::-1])[:, None] - 1
        x, y = places = np.clip(np.linspace(line[:2], line[2:], s.size).T, 0, most)
        column, row = (np.minimum(one.astype(int), n - 1) for one, n in zip(places, most))
        u, v = x - column, y - row
        shares = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
        at = row + np.array([[0], [0], [1], [1]]), column + np.array([[0], [1], [0], [1]])
        near = np.rint(y).astype(int), np.rint(x).astype(int)
        z, known = np.sum(shares * self.z[at], axis=0), self.known[near]

        def weights(of_samples: Array) -> Numbers:
            found = np.zeros(self.z.shape)
            np.add.at(found, at, shares * of_samples)
            return found

        doubts: Doubts = ()
        if not known.all():
            doubts = (f"Depth is not known on {100 * np.mean(~known):.0f} % of the line.",)
        unsure = None if self.result.mm_per_px_sigma is None else self.scale * s[-1]
        self.add(of, "length", s[-1], unsure, "mm")
        each = np.eye(s.size)
        self.linear(of, "rise", z[-1] - z[0], weights(each[-1] - each[0]), doubts=doubts)
        if (groove := _Groove.of(s, z)) is None:
            why = "There is no groove or ridge with both shoulders. Draw the line across it, from shoulder to shoulder."
            self.add(of, "depth", None, None, "mm", (why,))
            return Profile(line, s, z, known)
        doubts += self.doubts(weights(groove.inside) > 0)
        figures = groove.figures(z)
        height, width, *flanks = (
            weights(one) for one in (groove.figures(z + 1e-6 * each) - figures).T / 1e-6
        )
        if np.std((z - groove.base(z))[groove.shoulders]) > abs(figures[0]) / 4:
            doubts = *doubts, "The surface beside it is no straight line."
        (name, sign), of_depth = ("depth", -1) if figures[0] < 0 else ("height", 1), doubts
        if sign < 0 and not np.any(self.result.contact[near][groove.middle]):
            of_depth = *doubts, "Nothing touches its middle: the gel spans it, and the object is deeper."
        self.linear(of, name, sign * figures[0], sign * height, doubts=of_depth)
        self.linear(of, "width", figures[1], width, doubts=doubts)
        slopes = self.result.gradients[near][groove.flanks[0] | groove.flanks[1]].astype(np.float64)
        across = abs(np.linalg.eigh(slopes.T @ slopes)[1][:, 1] @ along) / length_px
        wide, wider = self.found[-1], figures[1] * max(1 - across, 0)
        if wide.sigma is not None and wider > wide.sigma:
            turn = f"{np.rad2deg(np.arccos(across)):.0f}° off perpendicular"
            said = f"The line is {turn}, which makes it {wider:.3f} mm wider."
            self.found[-1] = replace(wide, doubts=(*wide.doubts, said))
        for side, angle, by, flank in zip(("left", "right"), figures[2:], flanks, groove.flanks):
            steep = self.doubts(weights(flank) > 0)
            self.linear(of, f"{side} flank", np.rad2deg(angle), np.rad2deg(by), "deg", steep)
        return Profile(line, s, z, known, groove.base(z), groove.edges(z))

    def in_region(self, mask: Mask, of: str, radius: str | None) -> None:
        """Note depth, flatness, roughness and, if asked for, the radius of a region."""
        doubts, depth, stated = self.doubts(mask), self.z[mask], self.result.depth_sigma_mm
        sigma = None if stated is None else np.hypot(stated[mask].mean(), self.scale * depth.mean())
        self.add(of, "depth", depth.mean(), sigma, "mm", doubts)
        plane = self._terms(mask)[:3].T
        off_um = 1e3 * (depth - plane @ np.linalg.lstsq(plane, depth, rcond=None)[0])
        rows: list[Any] = [("flatness", np.ptp(off_um), off_um.std(), 0.0, self._noise_um(mask, 1))]
        if depth.size >= LEAST_PX:
            rough, blurred = (
                areal_roughness(z, mm_per_px=self.pitch, mask=mask)
                for z in (self.z, self.z + self.lost_to_blur)
            )
            noise_um = self._noise_um(mask, 2, rough.l_filter_mm)
            for name in ("Sa_um", "Sq_um", "Sz_um"):
                value, lost = getattr(rough, name), getattr(rough, name) - getattr(blurred, name)
                rows.append((name.removesuffix("_um"), value, rough.Sq_um, lost, noise_um))
        for name, value, rms_um, lost, noise_um in rows:
            # Errors raise it, so what goes without them is its sigma. Squares add up in means, extremes themselves.
            share = min(noise_um / rms_um, 1.0) if noise_um and rms_um else 0.0
            raised = share if name in ("flatness", "Sz") else 1 - np.sqrt(1 - share**2)
            gain = 0.0 if self.errors is None else self.errors.gain_sigma
            sigma = np.hypot(value * np.sqrt(raised**2 + gain**2 + self.scale**2), lost)
            mostly = (f"Errors alone give {noise_um:.2g} um RMS.",) if share > 0.5 else ()
            self.add(of, name, value, None if noise_um is None else sigma, "um", (*doubts, *mostly))
        if radius is not None:
            self._radius(mask, of, radius, doubts)

    def _terms(self, mask: Mask) -> Numbers:
        """1, x, y, x^2/2, x y, y^2/2 (6, n) of a region's pixels, mm from their middle."""
        x, y = (self.pitch * (one - one.mean()) for one in np.nonzero(mask)[::-1])
        return np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2])

    def _noise_um(self, mask: Mask, degree: int, l_filter_mm: float | None = None) -> float | None:
        """RMS, um, that errors give a flat region off its polynomial of a degree, after an L-filter; None if unknown.

        For errors of single slopes the region counts as its box, whose cosine waves up to `degree` half waves are the
        polynomial. The variance of depth has the longer waves.
        """
        if self.errors is None or self.slopes_sigma is None:
            return None
        filter_px = None if l_filter_mm is None else l_filter_mm / self.pitch
        height, width = (int(np.ptp(one)) + 1 for one in np.nonzero(mask))
        waves = self.errors.waves(height, width, filter_px)
        waves[np.add.outer(*(np.arange(n) for n in waves.shape)) <= degree] = 0
        single = self.pitch**2 * np.mean(np.square(self.slopes_sigma[mask])) * waves.mean()
        return 1e3 * float(np.sqrt(single + sum(one[mask].mean() for one in self.own)))

    def between(self, first: Mask, second: Mask, of: str) -> None:
        """Note how much deeper the second region is, and the angle that both faces enclose."""
        doubts = tuple(dict.fromkeys((*self.doubts(first), *self.doubts(second))))
        apart, turned = np.zeros((2, *self.z.shape))
        planes = [np.linalg.pinv(self._terms(mask)[:3].T)[1:] for mask in (first, second)]
        slopes = np.stack([plane @ self.z[mask] for plane, mask in zip(planes, (first, second))])
        angle = 180 - angle_deg(*slopes)
        for k, mask in enumerate((first, second)):
            apart[mask] += (2 * k - 1) / np.count_nonzero(mask)
            for axis in range(2):
                changed = slopes.copy()
                changed[k, axis] += 1e-6
                turned[mask] += (180 - angle_deg(*changed) - angle) / 1e-6 * planes[k][axis]
        self.linear(of, "step", np.sum(apart * self.z), apart, doubts=doubts)
        self.linear(of, "angle", float(angle), turned, "deg", doubts)

    def _radius(self, mask: Mask, of: str, kind: str, doubts: Doubts) -> None:
        """Note the radius of the ball or cylinder through a region, by least squares of the distances from it."""
        z, terms, weights = self.z[mask], self._terms(mask), np.zeros(mask.shape)
        *_, xx, xy, yy = np.linalg.lstsq(terms.T, z, rcond=None)[0]
        bends, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
        most = int(np.argmax(np.abs(bends)))
        if (bend := bends.mean() if kind == "ball" else bends[most]) == 0:
            return self.add(of, f"{kind} radius", None, None, "mm", (*doubts, "It is flat."))
        points, across = np.stack([*terms[1:3], z], axis=1), np.append(axes[:, most], 0)

        def off(t: Array) -> Numbers:
            """Vectors (n, 3) from the ball's middle (radius, z, x, y), or the axis (radius, z, place, turn, rise)."""
            if kind == "ball":
                return np.asarray(points - [t[2], t[3], t[1]])
            u = across + t[3] * np.array([-across[1], across[0], 0])
            u /= np.linalg.norm(u)
            axis = np.array([-u[1], u[0], t[4]]) / np.hypot(1, t[4])
            away = points - t[2] * u - [0, 0, t[1]]
            return np.asarray(away - np.outer(away @ axis, axis))

        start = [1 / abs(bend), z.mean() + 1 / bend, 0, 0] + [0] * (kind == "cylinder")
        fit = scipy.optimize.least_squares(lambda t: np.linalg.norm(off(t), axis=1) - t[0], start)
        away = off(fit.x)
        weights[mask] = -np.linalg.pinv(fit.jac)[0] * away[:, 2] / np.linalg.norm(away, axis=1)
        rms_um, noise_um = 1e3 * np.sqrt(np.mean(fit.fun**2)), self._noise_um(mask, 2)
        if noise_um is not None and rms_um > 2 * noise_um:
            doubts = *doubts, f"The surface is {rms_um:.2g} um RMS off it, more than its errors explain."
        return self.linear(of, f"{kind} radius", abs(fit.x[0]), weights, doubts=doubts)


@dataclass(frozen=True)
class _Groove:
    """Where a profile (N,) has its groove or ridge: samples that stay the same for a small change of depth."""

    s: Numbers
    solve: Numbers  # (4, N): from depth to the base at the center, its tilt, the height, and the bend of the middle
    center: float
    before: tuple[int, int]  # samples before both places at half its height
    shoulders: Mask
    middle: Mask  # third of the width
    inside: Mask
    flanks: list[Mask]  # samples from a quarter to three quarters of the height, on either side

    @classmethod
    def of(cls, s: Numbers, z: Numbers) -> _Groove | None:
        """The largest groove or ridge; None if it lacks a shoulder."""
        over = z - z[0] - (z[-1] - z[0]) * s / s[-1]
        height, found = float(over[np.argmax(np.abs(over))]), None
        for _ in range(4):  # the base follows from the width, and the width from the base
            if height == 0:
                return None
            share = over / height
            top, low = int(np.argmax(share)), np.flatnonzero(share < 0.5)
            if not (np.any(low < top) and np.any(low > top)):
                return None
            before = int(low[low < top][-1]), int(low[low > top][0]) - 1
            left, right = (
                s[k] + (s[1] - s[0]) * (0.5 - share[k]) / (share[k + 1] - share[k]) for k in before
            )
            center = (left + right) / 2
            off = (s - center) / (right - left)
            shoulders, middle = (np.abs(off) >= 1) & (np.abs(off) <= 2), np.abs(3 * off) <= 0.5
            if not (shoulders[off < 0].any() and shoulders[off > 0].any() and middle.any()):
                return None
            terms = np.stack([np.ones_like(s), s - center, middle, middle * (s - center) ** 2], axis=1)
            solve = np.zeros((4, s.size))
            solve[:, shoulders | middle] = np.linalg.pinv(terms[shoulders | middle])
            flanks = []
            for k in before:
                near = (np.abs(share - 0.5) <= 0.25) | np.isin(np.arange(s.size), (k, k + 1))
                labels, _ = scipy.ndimage.label(near)
                flanks.append(labels == labels[k])
            found = cls(s, solve, center, before, shoulders, middle, np.abs(off) <= 0.5, flanks)
            over, height = z - found.base(z), float(solve[2] @ z)
        return found

    def base(self, z: Numbers) -> Numbers:
        """The line (..., N) through both shoulders of profiles (..., N)."""
        return np.asarray(z @ self.solve[0][:, None] + z @ self.solve[1][:, None] * (self.s - self.center))

    def edges(self, z: Numbers) -> Any:
        """Distances, mm, of both places at half the height."""
        over, step = z - self.base(z) - (z @ self.solve[2][:, None]) / 2, self.s[1] - self.s[0]
        return tuple(self.s[k] - step * over[..., k] / (over[..., k + 1] - over[..., k]) for k in self.before)

    def figures(self, z: Numbers) -> Numbers:
        """Height, width, and the angles, rad, of both flanks with the base (..., 4) of profiles (..., N)."""
        left, right = self.edges(z)
        tilt, found = z @ self.solve[1], [z @ self.solve[2], right - left]
        for flank in self.flanks:
            away = self.s[flank] - self.s[flank].mean()
            found.append(np.abs(np.arctan(z[..., flank] @ away / np.sum(away**2)) - np.arctan(tilt)))
        return np.stack(found, axis=-1)
