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

RADII = {"ball": 4, "cylinder": 5}  # free parameters
Line = tuple[float, ...]


@dataclass(frozen=True)
class Quantity:
    """One figure.

    Attributes
    ----------
    of : "line 1", "region 2", "region 2 - region 1", or "contact"
    name : "step", "depth", "width", ...
    value : in the unit; None if it cannot be measured, and `doubts` says why
    sigma : one standard deviation; None if unknown
    unit : "mm", "um" or "deg"
    doubts : sentences that say what it does not hold for
    """

    of: str
    name: str
    value: float | None
    sigma: float | None
    unit: str
    doubts: tuple[str, ...] = ()


def in_words(one: Quantity) -> str:
    """A figure with its standard deviation, to two digits of that."""
    if one.value is None:
        return f"{one.name}: -"
    digits = max(0, 1 - int(np.floor(np.log10(one.sigma)))) if one.sigma else 3
    sigma = f" ± {one.sigma:.{digits}f}" if one.sigma else ""
    return f"{one.name} {one.value:.{digits}f}{sigma} {one.unit}{' (sigma unknown)' if one.sigma is None else ''}"


@dataclass(frozen=True)
class Profile:
    """Depth along a line, and its groove or ridge.

    Attributes
    ----------
    line : (x1, y1, x2, y2), px
    distance_mm, depth_mm : (N,), from the first end
    known : (N,) bool
    base_mm : (N,), the surface beside the groove or ridge, continued across it; None if there is neither
    edges_mm : distances of both places at half its height
    """

    line: Line
    distance_mm: Numbers
    depth_mm: Numbers
    known: Mask
    base_mm: Numbers | None = None
    edges_mm: tuple[float, float] | None = None


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

    Returns
    -------
    measured : Measured

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
    along = [surface.along(one, f"line {k + 1}") for k, one in enumerate(lines)]
    named = {f"region {k + 1}": surface.region(one) for k, one in enumerate(regions)}
    if not lines and not regions and np.any(result.contact & result.known):
        named = {"contact": surface.region(result.contact)}
    quantities = [one for _, found in along for one in found]
    for of, mask in named.items():
        quantities += surface.in_region(mask, of, radius)
    (first, datum), *others = named.items() or [("", surface.known)]
    for of, mask in others:
        quantities += surface.between(datum, mask, f"{of} - {first}")
    return Measured(tuple(quantities), tuple(profile for profile, _ in along), tuple(named.values()))


class _Surface:
    """The depth of a result, and the standard deviations of what follows from it."""

    def __init__(self, result: Reconstruction) -> None:
        self.result, self.z = result, result.depth_mm.astype(np.float64)
        if not isinstance(result.mm_per_px, float):
            raise GelformError(f"Expected square pixels to measure on, got mm_per_px={result.mm_per_px}.")
        self.pitch, self.known = result.mm_per_px, result.known
        self.scale = (result.mm_per_px_sigma or 0.0) / self.pitch
        self.errors, self.slopes_sigma = result.shape_errors, result.gradients_sigma
        if self.errors is not None:
            self.common = [coarse_of(result.shape).at_pixels(one) for one in self.errors.common_mm]
            # The camera and the gel blur as well; the change's blur is meant to be no less.
            blur_px = np.sqrt(2) * self.errors.blur_px
            self.lost_to_blur = scipy.ndimage.gaussian_filter(self.z, blur_px, mode="nearest") - self.z

    def quantity(
        self, of: str, name: str, value: Any, weights: Numbers, unit: str = "mm", doubts: Sequence[str] = ()
    ) -> Quantity:
        """A figure that grows by `sum(weights * change of depth in mm)`; the weights (H, W) have the sum 0."""
        if self.errors is None or self.slopes_sigma is None:
            return Quantity(of, name, float(value), None, unit, tuple(doubts))
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
        return Quantity(of, name, float(value), float(np.hypot(sigma, blur)), unit, tuple(doubts))

    def doubts(self, mask: Mask) -> tuple[str, ...]:
        """What makes figures of these pixels doubtful."""
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

    def _inside(self, given: Any, what: str) -> Line:
        ends = tuple(float(one) for one in check_numbers(given, what, 4))
        height, width = self.z.shape
        if not all(-0.5 <= one <= size - 0.5 for one, size in zip(ends, (width, height) * 2)):
            raise ValueError(
                f"Expected {what} X1,Y1,X2,Y2 in pixels of the image, 0-{width - 1} and 0-{height - 1}, got "
                f"{','.join(f'{one:g}' for one in ends)}."
            )
        return ends

    def along(self, given: Sequence[float], of: str) -> tuple[Profile, list[Quantity]]:
        """The profile of a line, linear between pixels, and its figures."""
        x1, y1, x2, y2 = line = self._inside(given, "a line")
        length_px = float(np.hypot(x2 - x1, y2 - y1))
        if length_px < 2:
            raise ValueError(f"Expected a line of at least 2 px, got {length_px:.2g} px.")
        height, width = self.z.shape
        count = int(np.ceil(length_px)) + 1
        s = np.linspace(0, length_px * self.pitch, count)
        x, y = (
            np.clip(np.linspace(*ends, count), 0, n - 1)
            for ends, n in (((x1, x2), width), ((y1, y2), height))
        )
        column, row = np.minimum(x.astype(int), width - 2), np.minimum(y.astype(int), height - 2)
        u, v = x - column, y - row
        at = row + np.array([[0], [0], [1], [1]]), column + np.array([[0], [1], [0], [1]])
        shares = np.stack([(1 - u) * (1 - v), u * (1 - v), (1 - u) * v, u * v])
        near = np.rint(y).astype(int), np.rint(x).astype(int)
        z, known = np.sum(shares * self.z[at], axis=0), self.known[near]

        def weights(of_samples: Array) -> Numbers:
            found = np.zeros(self.z.shape)
            np.add.at(found, at, shares * of_samples)
            return found

        def pixels(chosen: Mask) -> Mask:
            return np.asarray(weights(chosen) > 0)

        profile = Profile(line, s, z, known)
        doubts: tuple[str, ...] = (
            () if known.all() else (f"Depth is not known on {100 * np.mean(~known):.0f} % of the line.",)
        )
        quantities = [
            Quantity(
                of,
                "length",
                float(s[-1]),
                None if self.result.mm_per_px_sigma is None else float(s[-1] * self.scale),
                "mm",
            ),
            self.quantity(
                of, "rise", z[-1] - z[0], weights(np.eye(count)[-1] - np.eye(count)[0]), doubts=doubts
            ),
        ]
        if (groove := _Groove.of(s, z)) is None:
            why = "There is no groove or ridge with both shoulders. Draw the line across it, from shoulder to shoulder."
            return profile, [*quantities, Quantity(of, "depth", None, None, "mm", (why,))]
        doubts += self.doubts(pixels(groove.width_of))
        if groove.unlike(z):
            doubts = *doubts, "The surface beside it is no straight line."
        figures, by_sample = (
            groove.figures(z),
            (groove.figures(z + 1e-6 * np.eye(count)) - groove.figures(z)) / 1e-6,
        )
        name, sign = ("depth", -1) if figures[0] < 0 else ("height", 1)
        spans = name == "depth" and not np.any(self.result.contact[near][groove.middle])
        of_depth = (
            (*doubts, "Nothing touches its middle: the gel spans it, and the object is deeper.")
            if spans
            else doubts
        )
        quantities.append(
            self.quantity(of, name, sign * figures[0], sign * weights(by_sample[:, 0]), doubts=of_depth)
        )
        wide = self.quantity(of, "width", figures[1], weights(by_sample[:, 1]), doubts=doubts)
        slopes = self.result.gradients[near][groove.flanks[0] | groove.flanks[1]].astype(np.float64)
        across = np.linalg.eigh(slopes.T @ slopes)[1][:, 1]
        turn = float(np.arccos(np.minimum(abs(across @ [x2 - x1, y2 - y1]) / length_px, 1.0)))
        too_wide = figures[1] * (1 - np.cos(turn))
        if wide.sigma is not None and too_wide > wide.sigma:
            said = f"The line is {np.rad2deg(turn):.0f}° off perpendicular, which makes it {too_wide:.3f} mm wider."
            wide = replace(wide, doubts=(*wide.doubts, said))
        quantities.append(wide)
        for k, side in enumerate(("left", "right")):
            turned = np.rad2deg(figures[2 + k]), np.rad2deg(weights(by_sample[:, 2 + k]))
            steep = self.doubts(pixels(groove.flanks[k]))
            quantities.append(self.quantity(of, f"{side} flank", *turned, "deg", steep))
        return replace(profile, base_mm=groove.base(z), edges_mm=groove.edges(z)), quantities

    def in_region(self, mask: Mask, of: str, radius: str | None) -> list[Quantity]:
        """Depth, flatness, roughness and, if asked for, radius of a region."""
        doubts, depth, stated = self.doubts(mask), self.z[mask], self.result.depth_sigma_mm
        sigma = None if stated is None else float(np.hypot(stated[mask].mean(), self.scale * depth.mean()))
        x, y = self._places(mask)
        terms = np.stack([np.ones_like(x), x, y], axis=1)
        off_um = 1e3 * (depth - terms @ np.linalg.lstsq(terms, depth, rcond=None)[0])
        found = [
            Quantity(of, "depth", float(depth.mean()), sigma, "mm", doubts),
            self._of_heights(of, "flatness", np.ptp(off_um), off_um.std(), self._noise_um(mask, 1), doubts),
        ]
        if depth.size >= LEAST_PX:
            rough, noise_um = (
                areal_roughness(self.z, mm_per_px=self.pitch, mask=mask),
                self._noise_um(mask, 2),
            )
            for name, value in (("Sa", rough.Sa_um), ("Sq", rough.Sq_um), ("Sz", rough.Sz_um)):
                found.append(self._of_heights(of, name, value, rough.Sq_um, noise_um, doubts))
        return found if radius is None else [*found, self._radius(mask, of, radius, doubts)]

    def _places(self, mask: Mask) -> Numbers:
        """x and y (2, n), mm, of a region's pixels from their middle."""
        at = self.pitch * np.stack(np.nonzero(mask)[::-1]).astype(np.float64)
        return np.asarray(at - at.mean(axis=1, keepdims=True))

    def _noise_um(self, mask: Mask, degree: int) -> float | None:
        """RMS, um, that errors of slopes give a flat region off its polynomial of a degree; None if unknown.

        The region counts as its box, whose cosine waves up to `degree` half waves are the polynomial.
        """
        if self.errors is None or self.slopes_sigma is None:
            return None
        waves = self.errors.waves(*(int(np.ptp(one)) + 1 for one in np.nonzero(mask)))
        waves[np.add.outer(*(np.arange(n) for n in waves.shape)) <= degree] = 0
        return 1e3 * self.pitch * float(np.sqrt(np.mean(np.square(self.slopes_sigma[mask])) * waves.mean()))

    def _of_heights(
        self, of: str, name: str, value: float, rms_um: float, noise_um: float | None, doubts: tuple[str, ...]
    ) -> Quantity:
        """A figure, um, of heights off their form. Errors can only raise it: its sigma is what goes without them."""
        if noise_um is None or self.errors is None:
            return Quantity(of, name, float(value), None, "um", doubts)
        left = np.sqrt(1 - (noise_um / max(rms_um, noise_um)) ** 2) if noise_um else 1.0
        sigma = value * np.sqrt((1 - left) ** 2 + self.errors.gain_sigma**2 + self.scale**2)
        if left < 0.5:
            doubts = *doubts, f"Errors of slopes alone give {noise_um:.2g} um RMS."
        return Quantity(of, name, float(value), float(sigma), "um", doubts)

    def between(self, first: Mask, second: Mask, of: str) -> list[Quantity]:
        """How much deeper the second region is, and the angle that both faces enclose."""
        doubts = tuple(dict.fromkeys((*self.doubts(first), *self.doubts(second))))
        apart, turned = np.zeros((2, *self.z.shape))
        planes = []
        for mask, sign in ((first, -1), (second, 1)):
            apart[mask] += sign / np.count_nonzero(mask)
            x, y = self._places(mask)
            planes.append(np.linalg.pinv(np.stack([np.ones_like(x), x, y], axis=1))[1:])
        slopes = np.stack([plane @ self.z[mask] for plane, mask in zip(planes, (first, second))])
        angle = 180 - angle_deg(*slopes)
        for k, mask in enumerate((first, second)):
            for axis in range(2):
                changed = slopes.copy()
                changed[k, axis] += 1e-6
                turned[mask] += (180 - angle_deg(*changed) - angle) / 1e-6 * planes[k][axis]
        return [
            self.quantity(of, "step", np.sum(apart * self.z), apart, doubts=doubts),
            self.quantity(of, "angle", angle, turned, "deg", doubts),
        ]

    def _radius(self, mask: Mask, of: str, kind: str, doubts: tuple[str, ...]) -> Quantity:
        """The radius of the ball or cylinder through a region, by least squares of the distances from it."""
        z = self.z[mask]
        x, y = self._places(mask)
        terms = np.stack([np.ones_like(x), x, y, x * x / 2, x * y, y * y / 2], axis=1)
        *_, xx, xy, yy = np.linalg.lstsq(terms, z, rcond=None)[0]
        bends, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
        most = int(np.argmax(np.abs(bends)))
        if (bend := float(bends.mean() if kind == "ball" else bends[most])) == 0:
            return Quantity(of, f"{kind} radius", None, None, "mm", (*doubts, "It is flat."))
        points, across = np.stack([x, y, z], axis=1), np.append(axes[:, most], 0)

        def off(t: Array) -> Numbers:
            """Vectors (n, 3) from the ball's middle (radius, z, x, y), or the axis (radius, z, place, turn, rise)."""
            if kind == "ball":
                return np.asarray(points - [t[2], t[3], t[1]])
            u = across + t[3] * np.array([-across[1], across[0], 0])
            u /= np.linalg.norm(u)
            axis = np.array([-u[1], u[0], t[4]]) / np.hypot(1, t[4])
            away = points - t[2] * u - [0, 0, t[1]]
            return np.asarray(away - np.outer(away @ axis, axis))

        start = np.zeros(RADII[kind])
        start[:2] = 1 / abs(bend), z.mean() + 1 / bend
        fit = scipy.optimize.least_squares(lambda t: np.linalg.norm(off(t), axis=1) - t[0], start)
        away, weights = off(fit.x), np.zeros(mask.shape)
        weights[mask] = -np.linalg.pinv(fit.jac)[0] * away[:, 2] / np.linalg.norm(away, axis=1)
        rms_um, noise_um = 1e3 * float(np.sqrt(np.mean(fit.fun**2))), self._noise_um(mask, 2)
        if noise_um is not None and rms_um > 2 * noise_um:
            doubts = *doubts, f"The surface is {rms_um:.2g} um RMS off it, more than its errors explain."
        return self.quantity(of, f"{kind} radius", abs(fit.x[0]), weights, doubts=doubts)


@dataclass(frozen=True)
class _Groove:
    """Where a profile (N,) has its groove or ridge: samples that stay the same for a small change of depth."""

    s: Numbers
    solve: Numbers  # (4, N): depth at the middle, tilt and height over them from depth
    center: float
    before: tuple[int, int]  # samples before both places at half its height
    middle: Mask
    width_of: Mask  # samples between its edges
    flanks: tuple[Mask, Mask]  # its middle half on either side

    @classmethod
    def of(cls, s: Numbers, z: Numbers) -> _Groove | None:
        """The largest groove or ridge; None if it lacks a shoulder."""
        over = z - z[0] - (z[-1] - z[0]) * s / s[-1]
        height, found = float(over[np.argmax(np.abs(over))]), None
        for _ in range(4):
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
            shoulders, middle = (
                [(side * off >= 1) & (side * off <= 2) for side in (-1, 1)],
                np.abs(off) <= 1 / 6,
            )
            if not (shoulders[0].any() and shoulders[1].any() and middle.any()):
                return None
            used = shoulders[0] | shoulders[1] | middle
            terms = np.stack([np.ones_like(s), s - center, middle, middle * (s - center) ** 2], axis=1)
            solve = np.zeros((4, s.size))
            solve[:, used] = np.linalg.pinv(terms[used])
            half = (share >= 0.25) & (share <= 0.75)
            flanks = []
            for k in before:
                labels, _ = scipy.ndimage.label(half | np.isin(np.arange(s.size), (k, k + 1)))
                flanks.append(labels == labels[k])
            found = cls(s, solve, center, before, middle, np.abs(off) <= 0.5, (flanks[0], flanks[1]))
            over, height = z - found.base(z), float(solve[2] @ z)
        return found

    def base(self, z: Numbers) -> Numbers:
        """The line (..., N) through both shoulders of profiles (..., N)."""
        return np.asarray(z @ self.solve[0][:, None] + z @ self.solve[1][:, None] * (self.s - self.center))

    def unlike(self, z: Numbers) -> bool:
        """Whether the shoulders leave the base by more than a quarter of the height (RMS)."""
        shoulders = np.any(self.solve != 0, axis=0) & ~self.middle
        return bool(np.std((z - self.base(z))[shoulders]) > abs(self.solve[2] @ z) / 4)

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
            slope = z[..., flank] @ away / np.sum(away**2)
            found.append(np.abs(np.arctan(slope) - np.arctan(tilt)))
        return np.stack(found, axis=-1)
