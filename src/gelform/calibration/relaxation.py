"""How far the gel is drawn down beside an object: from the slopes around the contacts of the balls that calibrate it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import ColorModel

LENGTHS_MM = np.geomspace(0.15, 2.0, 53)
BLURRED_PX = 4.0  # beside a contact the blurred image still shows the ball
REACH_MM = 3.0
LEAST_SEEN = 0.75  # of a ring's pixels: over a whole ring a tilt of all slopes cancels
LEAST_RINGS = 5
LEAST_EXPLAINED = 0.5  # of the slopes' sum of squares
MOST_PRESSES = 24


def relaxation_from_presses(
    model: ColorModel,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: NDArray[np.float32],
    mm_per_px: float,
) -> float | None:
    """The gel's relaxation length L in mm; None where the surroundings of the contacts do not tell.

    Around a ball's contact a membrane under tension on an elastic bed, `laplace(z) = z/L^2` (Kerr, J. Appl. Mech. 31,
    1964), has the depth A K0(r/L) and the slope -A/L K1(r/L) at the distance r of the ball's axis. One L is fitted to the
    slopes of all presses by least squares, and an A to each.

    Parameters
    ----------
    model : fitted on the presses
    presses, contacts : prepared, and their circles
    background : (H, W, 3), the untouched image
    mm_per_px : mm
    """
    prepared, step = model.prepare(background, presses[0].size.shape), -(-len(presses) // MOST_PRESSES)
    errors, squares = np.zeros(LENGTHS_MM.size), 0.0
    for press, contact in zip(presses[::step], contacts[::step]):
        slopes = prepared.gradients_from_color(np.ascontiguousarray(press.color_change))[0]
        r, slope, pixels = slopes_around(slopes, contact, press.usable, mm_per_px)
        if r.size >= LEAST_RINGS:
            errors += [_misfit(r, slope, pixels, length) for length in LENGTHS_MM]
            squares += float(pixels @ slope**2)
    best = int(np.argmin(errors))
    told = 0 < best < errors.size - 1 and errors[best] < (1 - LEAST_EXPLAINED) * squares
    return float(LENGTHS_MM[best]) if told else None


def slopes_around(
    gradients: NDArray[np.float32], contact: ContactCircle, usable: NDArray[np.bool_] | None, mm_per_px: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Distance (mm), mean outward slope and number of pixels of rings around a contact, 1 px wide, that are seen."""
    height, width = gradients.shape[:2]
    dx = np.arange(width, dtype=np.float32) - np.float32(contact.x_px)
    dy = (np.arange(height, dtype=np.float32) - np.float32(contact.y_px))[:, None]
    r = np.hypot(dx, dy)
    outward = (gradients[..., 0] * dx + gradients[..., 1] * dy) / np.maximum(r, 1)
    ring = r.astype(np.intp)
    first, last = int(contact.radius_px + BLURRED_PX) + 1, int(contact.radius_px + REACH_MM / mm_per_px)
    inside = (ring >= first) & (ring < last) & (True if usable is None else usable)
    at, size = ring[inside] - first, max(last - first, 1)
    count, sums, far = (
        np.bincount(at, weights=of, minlength=size)
        for of in (None, outward[inside].astype(np.float64), r[inside].astype(np.float64))
    )
    seen = count > LEAST_SEEN * 2 * np.pi * (first + np.arange(size) + 0.5)
    n = count[seen].astype(np.float64)
    return far[seen] / n * mm_per_px, sums[seen] / n, n


def _misfit(
    r_mm: NDArray[np.float64], slope: NDArray[np.float64], weight: NDArray[np.float64], length_mm: float
) -> float:
    """Sum of squares that the best -A K1(r/L) with A >= 0 leaves."""
    shape = scipy.special.k1e(r_mm / length_mm) * np.exp((r_mm[0] - r_mm) / length_mm)
    size = max(-float(weight @ (slope * shape)) / float(weight @ shape**2), 0.0)
    return float(weight @ (slope + size * shape) ** 2)
