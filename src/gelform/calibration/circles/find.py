"""Find the contact circle of a ball press without a click, and take samples with known gradients inside it.

Find the contact circle of a ball press without a click.

A ball's color change is antisymmetric about its center, because color is nearly odd in the gradient and the
gradient is odd about the center. So the color change convolved with itself is most negative at the center,
and the ring mean of its size falls most steeply at the visible rim.

Samples: pixels of ball presses with known gradients, on which color models are fitted.

Inside the contact edge the gel follows the ball. Near the visible rim it has already left it, so a model trains only
inside the contact edge, which is measured on held-out presses (`circles.locate`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import gaussian_filter1d

from gelform.calibration.presses.press_set import check_room
from gelform.result.metrics import ball_gradients, followed_radius
from gelform.slopes.color_models import ColorModel, Samples

MIN_ANTISYMMETRY = 0.2  # 0-1, for a ball with more than half inside the border
LOG_ASPECTS = np.linspace(-0.4, 0.4, 9)  # of imprints that are tried, log of width over height
MIN_SIGNAL = 2.0  # change inside over that outside; 1 if nothing is pressed
WEAK = 0.3  # antisymmetry under which other finders are asked; the lowest of 280 good presses on six sensors has 0.36
# Evidence of templates for a ball: 7-27 on home-made gels, up to 14 in frames without a press, 43 or more on other sensors.
MIN_EVIDENCE = 10.0
AGREES = 0.5  # radii; a circle by hand or a stage's center this near to a clear ball is of the same press


@dataclass(frozen=True)
class ContactCircle:
    """A contact circle."""

    x_px: float  # center, px; may lie outside the frame
    y_px: float
    radius_px: float  # at which the color change falls most steeply: the visible rim
    # 0-1, share of the color change's energy that is odd about the center; a ball cut by the border keeps less
    antisymmetry: float
    signal: float  # color change inside the circle over that outside; about 1 if nothing is pressed
    evidence: float | None = None  # of templates for a ball there, if they found it (`circles.prepare`)
    marked: bool = False  # whether its center is a person's or a stage's

    @property
    def is_weak(self) -> bool:
        """Whether the color change is hardly odd about the center, or hardly larger than around the circle."""
        return self.antisymmetry < WEAK or self.signal < MIN_SIGNAL

    @property
    def circle_px(self) -> tuple[float, float, float]:
        """(center x, center y, radius)."""
        return self.x_px, self.y_px, self.radius_px


def scale_of(shape: tuple[int, int]) -> float:
    """Factor for lengths in pixels: 1 for a frame whose shorter side is 240 px."""
    return min(shape) / 240


def find_contact(color_change: NDArray[np.float32]) -> ContactCircle:
    """Contact circle of one ball press, in a color change (H, W, 3) that is blurred by about 1.25 px at 240 rows.

    DataError: it is too small to hold a contact.
    """
    check_room(color_change.shape)
    change = about_median(color_change)
    x, y, antisymmetry = _antisymmetry_center(change)
    size = magnitude(change)
    radius = contact_radius(size, x, y)
    return ContactCircle(x, y, radius, antisymmetry, _signal(size, x, y, radius))


def about_median(color_change: NDArray[np.float32]) -> NDArray[np.float32]:
    """A color change (H, W, 3) minus its median over the image."""
    return np.asarray(color_change - np.median(color_change, axis=(0, 1)).astype(np.float32))


def marked_contact(
    found: ContactCircle, size: NDArray[np.float32], x_px: float, y_px: float, radius_px: float | None
) -> ContactCircle:
    """The contact about a center that a person or a stage gives, if the found one is weak or agrees; else the found one.

    The radius is measured about that center, near the given one if any.
    """
    apart = np.hypot(found.x_px - x_px, found.y_px - y_px)
    if not found.is_weak and apart > AGREES * (radius_px or found.radius_px):
        return found
    radius = contact_radius(size, x_px, y_px, radius_px)
    return replace(
        found, x_px=x_px, y_px=y_px, radius_px=radius, signal=_signal(size, x_px, y_px, radius), marked=True
    )


def why_no_contact(contact: ContactCircle) -> str | None:
    """The reason that a found circle is not a ball press, or None."""
    if contact.marked or (contact.evidence is not None and contact.evidence >= MIN_EVIDENCE):
        return None
    if contact.antisymmetry < MIN_ANTISYMMETRY:
        return (
            f"no ball found: too light, cut by the border, or no ball (antisymmetry {contact.antisymmetry:.2f}, expected "
            f"{MIN_ANTISYMMETRY} or more)"
        )
    if contact.signal < MIN_SIGNAL:
        return f"no contact found: the change inside is {contact.signal:.1f} times that outside (expected {MIN_SIGNAL:g})"
    return None


def magnitude(change: NDArray[np.float32]) -> NDArray[np.float32]:
    """Size (H, W) of a color change."""
    size: NDArray[np.float32] = np.sqrt(np.einsum("...c,...c->...", change, change))
    return size


def contact_radius(
    size: NDArray[np.float32], x_px: float, y_px: float, near_px: float | None = None
) -> float:
    """Radius of the steepest descent of the ring mean of |change| about a center; near a given one if any."""
    scale, last = scale_of(size.shape), int(0.6 * min(size.shape))
    low, high = 6 * scale, last - 5 * scale
    if near_px is not None:
        low, high = max(low, 0.6 * near_px), min(high, 1.4 * near_px + 2 * scale)
        last = min(last, int(max(low, high) + 9 * scale) + 3)  # the blur reaches 8 px at 240 rows
    slope = gaussian_filter1d(ring_mean(size, x_px, y_px, count=last), 2 * scale, order=1)
    start, stop = int(low), max(int(low) + 1, int(high))
    peak = start + int(np.argmin(slope[start:stop]))
    return peak + parabola_offset(slope, peak)


def steepest_radius(size: NDArray[np.float32], contact: ContactCircle) -> float:
    """Radius, px, at which the ring mean of |change| is largest, up to the visible circle; the gel is steepest there."""
    rings = gaussian_filter1d(ring_mean(size, contact.x_px, contact.y_px), 2 * scale_of(size.shape))
    return float(np.argmax(rings[: max(1, round(contact.radius_px))]))


def moved(contact: ContactCircle, size: NDArray[np.float32], x_px: float, y_px: float) -> ContactCircle:
    """The contact with another center, and its radius measured again about it."""
    radius = contact_radius(size, x_px, y_px, contact.radius_px)
    return replace(contact, x_px=x_px, y_px=y_px, radius_px=radius)


def imprint_aspect(size: NDArray[np.float32], contact: ContactCircle) -> float:
    """Width of an imprint over its height, from |change|: that of the ellipses at which the ring mean falls most steeply."""
    scale, falls = scale_of(size.shape), []
    low, high = int(0.6 * contact.radius_px), int(1.4 * contact.radius_px + 2 * scale)
    for aspect in np.exp(LOG_ASPECTS):
        slope = gaussian_filter1d(
            ring_mean(size, contact.x_px, contact.y_px, float(aspect)), 2 * scale, order=1
        )
        falls.append(-float(slope[low : min(high, len(slope) - int(5 * scale))].min(initial=0.0)))
    best = int(np.argmax(falls))
    step = float(LOG_ASPECTS[1] - LOG_ASPECTS[0])
    return float(np.exp(LOG_ASPECTS[best] + step * parabola_offset(np.array(falls), best)))


def ring_mean(
    values: NDArray[np.float32], x_px: float, y_px: float, aspect: float = 1.0, count: int | None = None
) -> NDArray[np.float64]:
    """Mean of a map on rings of 1 px about a center, `count` or out to 0.6 of the shorter side; of a width over height."""
    count = int(0.6 * min(values.shape)) if count is None else count
    reach = count * max(aspect, 1 / aspect) ** 0.5 + 1
    top, left = (int(np.clip(at - reach, 0, n)) for at, n in zip((y_px, x_px), values.shape))
    values = values[top : max(0, int(y_px + reach) + 2), left : max(0, int(x_px + reach) + 2)]
    height, width = values.shape
    columns = (np.arange(left, left + width, dtype=np.float32) - np.float32(x_px)) ** 2 / np.float32(aspect)
    rows = (np.arange(top, top + height, dtype=np.float32) - np.float32(y_px)) ** 2 * np.float32(aspect)
    ring = np.minimum(np.sqrt(rows[:, None] + columns) + 0.5, count).astype(np.intp).ravel()
    total = np.bincount(ring, values.ravel(), minlength=count + 1)[:count]
    pixels = np.bincount(ring, minlength=count + 1)[:count]
    return total / np.maximum(pixels, 1)


def _antisymmetry_center(change: NDArray[np.float32]) -> tuple[float, float, float]:
    """Center c that maximizes -sum_v d(c + v) . d(c - v), by one zero-padded FFT per channel."""
    height, width = change.shape[:2]
    padded = (next_fast_len(2 * height, True), next_fast_len(2 * width, True))
    spectrum = rfft2(change, s=padded, axes=(0, 1))
    odd = -irfft2(spectrum**2, s=padded, axes=(0, 1)).sum(axis=-1)[: 2 * height - 1, : 2 * width - 1]
    row, col = (int(i) for i in np.unravel_index(int(odd.argmax()), odd.shape))
    y = (row + parabola_offset(odd[:, col], row)) / 2
    x = (col + parabola_offset(odd[row], col)) / 2
    energy = float(np.square(change, dtype=np.float64).sum())
    return x, y, float(odd[row, col]) / max(energy, 1e-12)


def _signal(size: NDArray[np.float32], x: float, y: float, radius: float) -> float:
    height, width = size.shape
    rows, cols = np.ogrid[:height, :width]
    rho = np.hypot(cols - x, rows - y) / radius
    inside, outside = size[(rho > 0.4) & (rho < 0.9)], size[rho > 1.6]
    if not inside.size or not outside.size:
        return float("inf") if inside.size else 0.0
    return float(inside.mean() / max(float(np.percentile(outside, 80)), 1e-6))


def parabola_offset(values: NDArray[np.floating], index: int) -> float:
    """Sub-sample offset of an extremum from its two neighbors, within half a sample."""
    if not 0 < index < len(values) - 1:
        return 0.0
    before, here, after = (float(values[index + i]) for i in (-1, 0, 1))
    curvature = before - 2 * here + after
    return float(np.clip((before - after) / (2 * curvature), -0.5, 0.5)) if curvature else 0.0


TOTAL_SAMPLES = 40_000  # pixels of all presses; twice as many fit no better
TRIAL_SAMPLES = 15_000  # pixels of all presses for a fit that places circles or is tried on held-out presses
PRESS_PIXELS = 1_500  # pixels of a press that a model is compared with; neighbors are copies
ZONE = 0.95  # fraction of the contact radius that trains
# Fraction of the visible radius: 0.74-0.90 on five simulated sensors, 0.81-0.91 as measured on real ones.
USUAL_EDGE = 0.85
REST_WEIGHT = 0.3  # weight of a pixel at rest over that of one in a contact
REST_DISTANCE = 2.0  # visible radii


@dataclass(frozen=True)
class PreparedPress:
    """One press, ready to be fitted: its color change and its ball."""

    name: str
    color_change: NDArray[np.float32]  # (H, W, 3) float32, blurred
    size: NDArray[np.float32]  # (H, W) float32, |color change - its median|
    ball_radius_px: float
    usable: NDArray[np.bool_] | None = None  # (H, W) bool, False on markers; None if all pixels are
    background: NDArray[np.float32] | None = None  # (H, W, 3), the background image of all presses; or None
    # radius of the contact edge over that of the visible circle; the same for all presses
    contact_radius_ratio: float = USUAL_EDGE
    # (x, y, radius) px of the circle by a person; (x, y, None) of a stage's center; or None
    mark: tuple[float, float, float | None] | None = None
    refused: str | None = None  # the reason that the image is not of this background, or None

    def contact_radius(self, contact: ContactCircle) -> float:
        """Radius, px, up to which the gel follows the ball."""
        return self.contact_radius_ratio * followed_radius(contact.radius_px, self.ball_radius_px)

    def pixels(
        self, contact: ContactCircle, zone: float, count: int | None = None
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of about `count` pixels inside `zone` of the contact's radius, on a regular lattice."""
        radius = zone * self.contact_radius(contact)
        height, width = self.size.shape
        top, bottom = (int(np.clip(contact.y_px + side * (radius + 1), 0, height)) for side in (-1, 1))
        left, right = (int(np.clip(contact.x_px + side * (radius + 1), 0, width)) for side in (-1, 1))
        rows, cols = np.ogrid[top : bottom + 1, left : right + 1]
        inside = (cols - contact.x_px) ** 2 + (rows - contact.y_px) ** 2 < radius**2
        inside &= (rows < height) & (cols < width)
        if self.usable is not None:
            inside &= self.usable[np.minimum(rows, height - 1), np.minimum(cols, width - 1)]
        stride = 1 if count is None else int(max(1, round(np.count_nonzero(inside) / max(count, 1))))
        if stride > 1:
            inside &= (cols + 3 * rows) % stride == 0
        found_rows, found_cols = np.nonzero(inside)
        return found_rows + top, found_cols + left

    def ball_gradients(
        self, contact: ContactCircle, rows: NDArray[np.intp], cols: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """The ball's slopes at pixels."""
        return ball_gradients(cols, rows, (contact.x_px, contact.y_px), self.ball_radius_px)

    def gradients(
        self, model: ColorModel, rows: NDArray[np.intp], cols: NDArray[np.intp]
    ) -> NDArray[np.float64]:
        """The slopes that a color model reads there."""
        return model.gradients_at(self.color_change[rows, cols], cols, rows)

    def samples(
        self,
        rows: NDArray[np.intp],
        cols: NDArray[np.intp],
        gradients: NDArray[np.float64],
        weight: float,
        depth_px: NDArray[Any] | None = None,
    ) -> Samples:
        """Pixels of known gradients (N, 2), all of one weight, with their depths if those (H, W) are given."""
        weights, depth = np.full(len(rows), weight), None if depth_px is None else depth_px[rows, cols]
        change, shape = self.color_change[rows, cols], self.size.shape
        return Samples(change, cols, rows, gradients, weights, shape, self.background, depth)


def contact_samples(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float = ZONE,
    *,
    total: int = TOTAL_SAMPLES,
    depths_px: Sequence[NDArray[Any]] | None = None,
) -> Samples:
    """Samples inside the contacts, labeled by the balls: about `total`, shared evenly by the presses.

    `depths_px`, of each press (H, W), are kept as the samples' depths.
    """
    parts = []
    for k, (press, contact) in enumerate(zip(presses, contacts)):
        rows, cols = press.pixels(contact, zone, max(200, total // len(presses)))
        gradients, depth = (
            press.ball_gradients(contact, rows, cols),
            None if depths_px is None else depths_px[k],
        )
        parts.append(press.samples(rows, cols, gradients, 1.0, depth))
    return joined(parts)


def with_rest_samples(
    samples: Samples,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    depths_px: Sequence[NDArray[Any]] | None = None,
) -> Samples:
    """The samples and up to half as many of the gel at rest, where the gradient is 0, at a lower weight."""
    parts = [samples]
    for k, (press, contact) in enumerate(zip(presses, contacts)):
        step = max(1, int(np.sqrt(2 * press.size.size * len(presses) / len(samples.x_px))))
        rows, cols = (
            axis.ravel() for axis in np.mgrid[: press.size.shape[0] : step, : press.size.shape[1] : step]
        )
        distance = np.hypot(cols - contact.x_px, rows - contact.y_px)
        far = distance > REST_DISTANCE * contact.radius_px
        if press.usable is not None:
            far &= press.usable[rows, cols]
        rows, cols, depth = rows[far], cols[far], None if depths_px is None else depths_px[k]
        parts.append(press.samples(rows, cols, np.zeros((len(rows), 2)), REST_WEIGHT, depth))
    return joined(parts)


def joined(parts: Sequence[Samples]) -> Samples:
    """Samples of images of one sensor, one after the other."""
    names = ["color_change", "x_px", "y_px", "gradients", "weight"]
    names += [] if parts[0].depth_px is None else ["depth_px"]
    columns: dict[str, Any] = {name: np.concatenate([getattr(one, name) for one in parts]) for name in names}
    return replace(parts[0], **columns)
