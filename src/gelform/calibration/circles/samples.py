"""Samples: pixels of ball presses with known gradients, on which color models are fitted.

Inside the contact edge the gel follows the ball. Near the visible rim it has already left it, so a model trains only
inside the contact edge, which is measured on held-out presses (`circles.edge`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle
from gelform.result.metrics.ball import ball_gradients, followed_radius
from gelform.slopes.color_models import ColorModel, Samples

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
    """One press, ready to be fitted: its color change and its ball.

    Attributes
    ----------
    name : str
    color_change : (H, W, 3) float32, blurred
    size : (H, W) float32, |color change - its median|
    ball_radius_px : float
    usable : (H, W) bool, False on markers; None if all pixels are
    background : (H, W, 3) float32, the background image of all presses; or None
    contact_radius_ratio : radius of the contact edge over that of the visible circle; the same for all presses
    mark : (x, y, radius) px of the circle by a person; (x, y, None) of a stage's center; or None
    refused : the reason that the image is not of this background, or None
    """

    name: str
    color_change: NDArray[np.float32]
    size: NDArray[np.float32]
    ball_radius_px: float
    usable: NDArray[np.bool_] | None = None
    background: NDArray[np.float32] | None = None
    contact_radius_ratio: float = USUAL_EDGE
    mark: tuple[float, float, float | None] | None = None
    refused: str | None = None

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
