"""The gel: its surface follows the indenter in the contact, relaxes around it, and is dragged along.

The surface is a membrane under tension on an elastic bed, held up by the indenter: of all surfaces u that do
not enter the indenter's face g, the one of least energy

    min_u  integral |grad u|^2 + (u/L)^2      subject to  u >= g.

So u = g in the contact, L^2 laplace(u) = u around it (depth falls off over the relaxation length L), and the
slope is continuous at the rim: the gel leaves the indenter a little inside the circle where the undeformed
plane would cut it.

Rubber keeps its volume: the displaced part rises around the contact, over a length of about the gel's
thickness. With w the membrane, b the bulge and h the thickness, the surface is

    u = w - b,    b - h^2 laplace(b) = bulge w,    w the membrane over g + b.

The volume of u is (1 - bulge) times that of w; with `bulge` = 0 nothing rises.

The obstacle problem: Kinderlehrer and Stampacchia, An Introduction to Variational Inequalities, 1980; the
elastic bed: Kerr, Elastic and viscoelastic foundation models, J. Appl. Mech. 31, 1964.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import scipy  # its parts load at first use

from gelform._native import Handle, Kernel
from gelform.arrays import Array, Mask, Numbers
from gelform.errors import ConvergenceError
from gelform.foundations.checks import check_positive, check_within
from gelform.simulate.indenters import Ball, Indenter, Pose


@dataclass(frozen=True)
class Gel:
    """The material of the gel.

    Attributes
    ----------
    thickness_mm : the displaced gel rises within about this distance of the contact
    bulge : part of the displaced volume that rises around the contact, 0 to 0.95: 0 for a foam, near 1 for rubber
    friction : distance that the surface is dragged before it slips, per mm of depth; >= 0
    """

    thickness_mm: float = 3.0
    bulge: float = 0.0
    friction: float = 0.8

    def __post_init__(self) -> None:
        check_positive(self.thickness_mm, "thickness_mm")
        check_within(self.bulge, "bulge", 0, 0.95)
        if not 0 <= self.friction < np.inf:
            raise ValueError(f"Expected friction >= 0, got {self.friction}.")


NODES = 200  # of the differences that solve the bulge inside the contact; measured error 3e-6 of its height

_ball_surface = Kernel(
    "ball_surface",
    "f64[w] dx, f64[h] dy, f64[points] depth, f64[points] slope, out f64[h,w] z, out f64[h,w,2] gradients, "
    "out bool[h,w] touching, f64 radius, f64 top, f64 contact, f64 step",
)


@dataclass(frozen=True)
class BallPress:
    """A ball in the gel, as depth over the distance r from its axis.

    Inside the contact radius `z = depth - R + sqrt(R^2 - r^2)`, beyond it a sum of two Bessel functions K0.
    """

    radius_mm: float
    depth_mm: float
    contact_radius_mm: float  # of the circle in which they touch
    # Depth at the rim that falls off over `relaxation_mm`: the membrane, less the part of the bulge with the same length;
    # and height there of the part of the bulge that falls off over `thickness_mm`.
    tail_mm: float
    bulge_mm: float
    relaxation_mm: float
    thickness_mm: float

    def tail(self, r_mm: Array) -> tuple[Numbers, Numbers]:
        """Depth and slope at distances r >= contact radius."""
        depth, slope = np.zeros(np.shape(r_mm)), np.zeros(np.shape(r_mm))
        for size, length in ((self.tail_mm, self.relaxation_mm), (-self.bulge_mm, self.thickness_mm)):
            if size != 0:
                scale = size * np.exp((self.contact_radius_mm - r_mm) / length)
                scale = scale / scipy.special.k0e(self.contact_radius_mm / length)
                depth += scale * scipy.special.k0e(r_mm / length)
                slope -= scale * scipy.special.k1e(r_mm / length) / length
        return depth, slope


@lru_cache(maxsize=256)
def ball_press(radius_mm: float, depth_mm: float, relaxation_mm: float, gel: Gel) -> BallPress:
    """The press of a ball whose foremost point stands `depth_mm` in a gel; lengths in mm."""
    thickness_mm = _thickness(gel, relaxation_mm)

    def rim(a: float) -> tuple[float, float, float]:
        return _rim(a, radius_mm, depth_mm, relaxation_mm, thickness_mm, gel.bulge)

    def mismatch(a: float) -> float:
        return float(rim(a)[0] * np.sqrt(radius_mm**2 - a**2))

    limits = 1e-6 * radius_mm, radius_mm * (1 - 1e-12)
    a = float(scipy.optimize.brentq(mismatch, *limits, xtol=1e-12 * radius_mm))
    _, membrane, risen = rim(a)
    follows = gel.bulge * membrane / (1 - (thickness_mm / relaxation_mm) ** 2)
    return BallPress(radius_mm, depth_mm, a, membrane - follows, risen - follows, relaxation_mm, thickness_mm)


def depth_of_ball(radius_mm: float, rim_slope: float, relaxation_mm: float, gel: Gel) -> float:
    """Depth of a ball, mm, at which its slope at the contact's rim is `rim_slope`."""
    a, thickness_mm = rim_slope * radius_mm / np.hypot(1, rim_slope), _thickness(gel, relaxation_mm)
    at_0, at_1 = (_rim(a, radius_mm, d, relaxation_mm, thickness_mm, gel.bulge)[0] for d in (0.0, 1.0))
    return float(at_0 / (at_0 - at_1))  # the mismatch is linear in the depth


def _surface_of_ball(
    press: BallPress, x_mm: Numbers, y_mm: Numbers, center_mm: tuple[float, float]
) -> Surface:
    length = max(press.relaxation_mm, press.thickness_mm) if press.bulge_mm else press.relaxation_mm
    table = _table(press, 16 * length)  # e^-16: beyond, the gel is at rest
    surface = flat_surface(x_mm, y_mm)
    dx, dy = np.ravel(x_mm) - center_mm[0], np.ravel(y_mm) - center_mm[1]
    _ball_surface(
        dx, dy, *table[1:], surface.depth_mm, surface.gradients, surface.contact, press.radius_mm, press.depth_mm,
        press.contact_radius_mm, table[0],
    )  # fmt: skip
    return surface


@lru_cache(maxsize=64)
def _table(press: BallPress, reach_mm: float) -> tuple[float, Numbers, Numbers]:
    """Step, depth and slope at 4096 distances beyond the contact; measured error 25 nm."""
    step = reach_mm / 4095
    return step, *press.tail(press.contact_radius_mm + step * np.arange(4096))


def _rim(
    a: float, radius_mm: float, depth_mm: float, length: float, thickness: float, bulge: float
) -> tuple[float, float, float]:
    """Slope of the gel just inside the rim minus that outside; membrane and bulge at the rim.

    Inside, the membrane is the ball's face g plus the bulge b: (1 - bulge) b - h^2 laplace(b) = bulge g, by
    second-order differences. Outside, both are Bessel functions.
    """
    r = np.linspace(0, a, NODES + 1)
    face = depth_mm - radius_mm + np.sqrt(radius_mm**2 - r**2)
    kl = scipy.special.k1e(a / length) / scipy.special.k0e(a / length) / length
    slope = -a / np.sqrt(radius_mm**2 - a**2)
    if bulge == 0:
        return float(slope + face[-1] * kl), float(face[-1]), 0.0
    kh = scipy.special.k1e(a / thickness) / scipy.special.k0e(a / thickness) / thickness
    follows = bulge / (1 - (thickness / length) ** 2)
    b, b_slope = _bulge_inside(face, a, thickness, bulge, follows * (kl - kh), kh)
    membrane = face[-1] + b
    return float(slope + b_slope + membrane * kl), float(membrane), b


def _bulge_inside(
    face: Array, a: float, thickness: float, bulge: float, coupling: float, kh: float
) -> tuple[float, float]:
    """The bulge and its slope at the rim, where it obeys `b' = -coupling (g + b) - kh b`."""
    step = a / NODES
    stiffness = (thickness / step) ** 2
    i = np.arange(1, NODES + 1)
    lower, upper = np.empty(NODES + 1), np.empty(NODES + 1)
    diagonal, right = np.full(NODES + 1, 1 - bulge + 2 * stiffness), bulge * face
    lower[1:], upper[1:] = -stiffness * (1 - 0.5 / i), -stiffness * (1 + 0.5 / i)
    diagonal[0], upper[0] = 1 - bulge + 4 * stiffness, -4 * stiffness
    ghost = upper[-1]  # the node beyond the rim, eliminated by the condition there
    lower[-1] += ghost
    diagonal[-1] -= ghost * 2 * step * (coupling + kh)
    right[-1] += ghost * 2 * step * coupling * face[-1]
    bands = np.stack([np.roll(upper, 1), diagonal, np.roll(lower, -1)])
    # Never singular: with a bulge below 1 the diagonal outweighs the rest of each row.
    b = float(scipy.linalg.solve_banded((1, 1), bands, right, check_finite=False)[-1])
    return b, -coupling * (float(face[-1]) + b) - kh * b


def _thickness(gel: Gel, relaxation_mm: float) -> float:
    """The thickness, changed by a thousandth if it equals the relaxation length, because the formula has a pole there."""
    apart = abs(gel.thickness_mm / relaxation_mm - 1)
    return relaxation_mm * (1 + 1e-3) if apart < 1e-3 else gel.thickness_mm


TOLERANCE = 1e-5  # largest change by a cycle over the deepest point: 5 nm for a press 0.5 mm deep
MAX_CYCLES = 100  # V-cycles before a solution fails

_membrane_cycles = Kernel(
    "membrane_cycles",
    "membrane* grids, out f64[gh,gw] u, out f64[gh,gw] before, f64[h,w] lowest, out bool[h,w] may_move, "
    "out f64[1] change, f64 spring, f64 target, i32 cycles",
)


def membrane_over(
    obstacle: Array, *, relaxation_px: float, bulge: float = 0.0, bulge_px: float = 1.0, guess: bool = False
) -> tuple[Numbers, Numbers]:
    """The membrane w of least energy over an obstacle and the bulge b of its gel; no force across the border.

    Solves `w >= g + b`, `4 w - sum of neighbors + w/L^2 >= 0`, one of the two an equality at every sample. b is
    `bulge` times w spread over the length `bulge_px` by the kernel K0(r/h)/(2 pi h^2), whose integral is 1:
    `b - h^2 laplace(b) = bulge w`. The surface is w - b: the obstacle where they touch, and its volume over the
    whole grid is (1 - bulge) times that of w.

    The first guess comes from the grid of half the resolution; cycles go on until the change is below the tolerance. A guess
    (`guess`) may stop before that, because on a coarse relief two contacts can alternate forever.

    R. Kornhuber, Monotone multigrid methods for elliptic variational inequalities I, Numer. Math. 69, 1994,
    truncated: coarse grids correct only samples without contact. The smoother is C. W. Cryer's projected
    relaxation (SIAM J. Control 9(3), 1971), red-black.

    `obstacle` (H, W) is g, below 0 where the gel would be touched only if it rises; `relaxation_px` and `bulge_px` are L and
    h in samples; `bulge` is 0 (compressible) to 1 (incompressible), 1 excluded. Returns w and b (H, W); without a bulge w is
    the obstacle itself bit for bit where they touch. ConvergenceError: the cycles did not converge.
    """
    g = np.ascontiguousarray(obstacle, dtype=np.float64)
    u, b = _coarse_guess(g, relaxation_px, bulge, bulge_px)
    grids = _Grids(g.shape, relaxation_px)
    np.maximum(g + b, 0, out=grids.lowest)
    grids.u[:] = np.maximum(u, grids.lowest)
    target = TOLERANCE * max(float(g.max()), 1e-12)
    most = MAX_CYCLES // 4 if guess else MAX_CYCLES
    if bulge == 0:
        change = grids.cycle(target, most)
    for _ in range(most if bulge > 0 else 0):
        change = grids.cycle(target, 1)
        risen = spread(grids.u, bulge_px) * bulge
        change = max(change, float(np.abs(risen - b).max()))
        b = risen
        np.maximum(g + b, 0, out=grids.lowest)
        if change <= target:
            break
    if change > target and not guess:
        raise ConvergenceError(
            f"The gel's surface did not settle in {MAX_CYCLES} cycles (change {change:.3g}). "
            f"Its relaxation length is {relaxation_px:.3g} samples: simulate with another oversample."
        )
    return np.maximum(grids.u, grids.lowest), b


class _Grids:
    """The grids of a multigrid solution, from the finest to one on which relaxation alone is fast."""

    def __init__(self, shape: tuple[int, ...], relaxation_px: float) -> None:
        height, width = shape
        self._handle = Handle("membrane", height, width)
        self._spring = relaxation_px**-2  # the bed's stiffness for a sample
        self._ghosted = np.zeros((height + 2, width + 2))  # the surface, with a border that the kernel fills
        self._before = np.empty_like(self._ghosted)
        self._change = np.zeros(1)
        self.u = self._ghosted[1:-1, 1:-1]
        self.lowest = np.full(shape, -np.inf)
        self.free = np.ones(shape, dtype=bool)

    def cycle(self, target: float, most: int) -> float:
        """Up to `most` V-cycles, until one changes `u` by no more than `target`; the last one's largest change."""
        _membrane_cycles(
            self._handle, self._ghosted, self._before, self.lowest, self.free, self._change,
            self._spring, target, most,
        )  # fmt: skip
        return float(self._change[0])


def spread(values: Numbers, length_px: float) -> Numbers:
    """Values smoothed by K0(r/h)/(2 pi h^2), mirrored at the border, so that their sum is preserved.

    By cosine transform on a coarser grid: the result is smooth over the length.
    """
    factor = max(1, int(length_px / 12))  # twelve samples per length are enough
    height, width = values.shape
    size = max(2, width // factor), max(2, height // factor)
    small = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
    rows, columns = small.shape
    ky = 2 - 2 * np.cos(np.pi * np.arange(rows) / rows)
    kx = 2 - 2 * np.cos(np.pi * np.arange(columns) / columns)
    hy, hx = length_px * rows / height, length_px * columns / width
    damping = 1 + hy**2 * ky[:, None] + hx**2 * kx[None, :]
    smooth = scipy.fft.idctn(scipy.fft.dctn(small, type=2) / damping, type=2)
    if smooth.shape == values.shape:
        return np.asarray(smooth, dtype=np.float64)
    return np.asarray(cv2.resize(smooth, (width, height), interpolation=cv2.INTER_CUBIC), dtype=np.float64)


def carried_along(values: Numbers, fixed: Mask, length_px: float) -> Numbers:
    """Values kept where `fixed` and falling off over a length elsewhere: v = h^2 laplace(v), no flux at the border.

    The values that are not fixed are the first guess; the result is good to a thousandth of the largest value.
    """
    grids = _Grids(values.shape, length_px)
    grids.u[:] = values
    np.logical_not(fixed, out=grids.free)
    target = 1e-3 * max(float(np.abs(values).max()), 1e-9)
    if grids.cycle(target, MAX_CYCLES) > target:
        raise ConvergenceError(f"The gel's drag did not settle in {MAX_CYCLES} cycles.")
    return grids.u.copy()


def _coarse_guess(g: Numbers, relaxation_px: float, bulge: float, bulge_px: float) -> tuple[Numbers, Numbers]:
    """The solution on a grid of half the resolution, interpolated to this one."""
    if relaxation_px < 2 or min(g.shape) < 8:
        return np.zeros(g.shape), np.zeros(g.shape)
    height, width = g.shape
    even = np.pad(g, ((0, height % 2), (0, width % 2)), mode="edge")
    halved = even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).max(axis=(1, 3))
    coarse = membrane_over(
        halved, relaxation_px=relaxation_px / 2, bulge=bulge, bulge_px=bulge_px / 2, guess=True
    )
    fine = [cv2.resize(part, even.shape[::-1], interpolation=cv2.INTER_LINEAR) for part in coarse]
    return np.asarray(fine[0][:height, :width]), np.asarray(fine[1][:height, :width])


def relaxation_from_gel(tension_n_per_m: float, stiffness_kpa: float, thickness_mm: float) -> float:
    """Relaxation length in mm of a coating under tension T on a gel of Young's modulus E: sqrt(T h/E).

    The bed's spring constant per area is E/h (Winkler), the membrane's equation `T laplace(u) = E/h u`.
    """
    tension = check_positive(tension_n_per_m, "tension_n_per_m")
    stiffness = check_positive(stiffness_kpa, "stiffness_kpa")
    return float(np.sqrt(tension * check_positive(thickness_mm, "thickness_mm") / stiffness))


@dataclass(frozen=True)
class Surface:
    """A gel surface on a regular grid."""

    x_mm: Numbers  # (1, W), coordinates of the samples
    y_mm: Numbers  # (H, 1)
    depth_mm: Numbers  # (H, W) float64, positive where pressed, negative where the gel rises around
    gradients: Numbers  # (H, W, 2) float64, mm/mm
    contact: Mask  # (H, W), where gel and indenter touch

    def sampled(self, at: slice) -> Surface:
        """The surface at given rows, and at the same of its columns."""
        whole = self.depth_mm, self.gradients, self.contact
        maps: list[Any] = [np.ascontiguousarray(one[at, at]) for one in whole]
        return Surface(self.x_mm[:, at], self.y_mm[at], *maps)

    def middles(self, stride: int) -> Surface:
        """The surface at the middle of each `stride` samples, for an odd number per pixel: at the pixels' centers."""
        return self if stride == 1 else self.sampled(slice(stride // 2, None, stride))


def flat_surface(x_mm: Numbers, y_mm: Numbers) -> Surface:
    """The surface of the gel at rest."""
    shape = (y_mm.size, x_mm.size)
    return Surface(x_mm, y_mm, np.zeros(shape), np.zeros((*shape, 2)), np.zeros(shape, dtype=bool))


def surface_from_indenter(
    indenter: Indenter,
    x_mm: Numbers,
    y_mm: Numbers,
    *,
    center_mm: tuple[float, float],
    depth_mm: float,
    relaxation_mm: float,
    gel: Gel | None = None,
) -> Surface:
    """The pressed gel under an indenter: the membrane solved on the grid, its slopes by central differences.

    The grid must extend some relaxation lengths beyond the region of interest, because no force acts across its border.
    Under a ball the surface is known in closed form: a cap, then Bessel functions K0 of r over the gel's lengths.
    """
    gel = gel or Gel()
    if isinstance(indenter, Ball):
        press = ball_press(indenter.radius_mm, depth_mm, relaxation_mm, gel)
        return _surface_of_ball(press, x_mm, y_mm, center_mm)
    face = depth_mm + indenter.face_mm(x_mm - center_mm[0], y_mm - center_mm[1])
    pitch = float(x_mm[0, 1] - x_mm[0, 0])
    obstacle = np.maximum(face, -depth_mm if gel.bulge else 0)  # the gel never rises that far
    membrane, bulge = membrane_over(
        obstacle, relaxation_px=relaxation_mm / pitch, bulge=gel.bulge, bulge_px=gel.thickness_mm / pitch
    )
    tolerance = TOLERANCE * depth_mm if gel.bulge else 0
    touching = (membrane > 0) & (membrane <= obstacle + bulge + tolerance)
    depth = np.where(touching, obstacle, membrane - bulge)
    slope_y, slope_x = np.gradient(depth, pitch, edge_order=2)
    return Surface(x_mm, y_mm, depth, np.stack([slope_x, slope_y], axis=-1), touching)


class Drag:
    """The surface's sideways displacement during a sequence. It has memory, so each sequence needs its own.

    In the contact the surface sticks to the indenter until it has been dragged `friction` times the local
    depth (Coulomb: the bed's pressure grows with the depth); then it slips. Around the contact the
    displacement falls off over the gel's thickness. Displaced gel flows sideways by `-h grad b` (b the bulge):
    the layer's mean flow that keeps its volume where bulge = 1.
    """

    def __init__(self, gel: Gel) -> None:
        self.gel = gel
        self._last: tuple[Numbers, Mask, Pose] | None = None  # displacement, contact and pose

    def __call__(self, surface: Surface, pose: Pose) -> Numbers:
        """Displacement (h, w, 2) in mm, x and y, on the surface's grid."""
        x, y, shape = surface.x_mm, surface.y_mm, surface.depth_mm.shape
        pitch = float(x[0, 1] - x[0, 0])
        stuck, touched, last = self._last or (np.zeros((*shape, 2)), np.zeros(shape, dtype=bool), pose)
        if stuck.shape[:2] != shape:
            raise ValueError("Expected surfaces on one grid, got another: use one Drag per sequence.")
        # Sideways motion of the indenter's surface since the last pose, at each point.
        turn = np.deg2rad(pose.spin_deg - last.spin_deg)
        dx, dy = np.broadcast_arrays(x - pose.center_mm[0], y - pose.center_mm[1])
        step_x = pose.travel_mm[0] - last.travel_mm[0] - np.sin(turn) * dy + (np.cos(turn) - 1) * dx
        step_y = pose.travel_mm[1] - last.travel_mm[1] + np.sin(turn) * dx + (np.cos(turn) - 1) * dy
        still = (surface.contact & touched)[..., None]
        moved = np.where(still, stuck + np.stack([step_x, step_y], axis=-1), stuck)
        limit = self.gel.friction * np.maximum(surface.depth_mm, 0)
        length = np.linalg.norm(moved, axis=-1)
        moved *= np.minimum(1, limit / np.maximum(length, 1e-12))[..., None]
        thickness_px = self.gel.thickness_mm / pitch
        if surface.contact.any():
            parts = [carried_along(moved[..., k], surface.contact, thickness_px) for k in (0, 1)]
            moved = np.stack(parts, axis=-1)
        else:
            moved = np.zeros_like(moved)
        self._last = moved, surface.contact, pose
        bulge = self.gel.bulge * spread(np.maximum(surface.depth_mm, 0), thickness_px)
        slope_y, slope_x = np.gradient(bulge, pitch)
        return moved - self.gel.thickness_mm * np.stack([slope_x, slope_y], axis=-1)


def displacement_at(displacement_mm: Numbers, surface: Surface, points_mm: Numbers) -> Numbers:
    """A displacement field (h, w, 2) at points (N, 2), bilinear; the nearest value outside the border."""
    pitch_x = float(surface.x_mm[0, 1] - surface.x_mm[0, 0])
    pitch_y = float(surface.y_mm[1, 0] - surface.y_mm[0, 0])
    column = ((points_mm[:, 0] - surface.x_mm[0, 0]) / pitch_x).astype(np.float32)
    row = ((points_mm[:, 1] - surface.y_mm[0, 0]) / pitch_y).astype(np.float32)
    found = cv2.remap(
        displacement_mm, column[:, None], row[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(found[:, 0], dtype=np.float64)
