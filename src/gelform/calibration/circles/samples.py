"""Pixels of ball presses whose gradient is known: what color models are fitted on.

Inside the contact the gel follows the ball. Near the visible rim it has already left it, so a model trains inside the
contact's edge only, which is measured on held-out presses (`circles.edge`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.ball import ball_gradients, followed_radius
from gelform.calibration.circles.find import ContactCircle
from gelform.color_models import ColorModel, Samples

TOTAL_SAMPLES = 40_000
ZONE = 0.95  # of the contact's radius: what trains
USUAL_EDGE = (
    0.85  # of the visible radius: 0.74-0.90 on five simulated sensors, 0.81-0.91 where measured on real ones
)
REST_WEIGHT = 0.3
REST_DISTANCE = 2.0  # visible radii


@dataclass(frozen=True)
class PreparedPress:
    """One press, ready to be fitted: its color change and the ball that made it.

    Attributes
    ----------
    name : str
    color_change : (H, W, 3) float32, blurred
    size : (H, W) float32, |color change - its median|
    ball_radius_px : float
    usable : (H, W) bool, False on marker dots; None where all pixels are
    background : (H, W, 3) float32, the untouched image that all presses share; or None
    contact_radius_ratio : radius at which the gel leaves the ball over that of the visible circle; the same for all presses
    """

    name: str
    color_change: NDArray[np.float32]
    size: NDArray[np.float32]
    ball_radius_px: float
    usable: NDArray[np.bool_] | None = None
    background: NDArray[np.float32] | None = None
    contact_radius_ratio: float = USUAL_EDGE

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


def contact_samples(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float = ZONE,
    *,
    total: int = TOTAL_SAMPLES,
    depths_px: Sequence[NDArray[Any]] | None = None,
) -> Samples:
    """Samples inside the contacts, labelled by the balls: about `total`, shared evenly by the presses.

    `depths_px`, of each press (H, W), are kept as the samples' depths.
    """
    parts = []
    for k, (press, contact) in enumerate(zip(presses, contacts)):
        rows, cols = press.pixels(contact, zone, max(200, total // len(presses)))
        gradients = press.ball_gradients(contact, rows, cols)
        parts.append(
            (press.color_change[rows, cols], cols, rows, gradients, _depths_at(depths_px, k, rows, cols))
        )
    change, x, y, gradients, depth = (np.concatenate([part[i] for part in parts]) for i in range(5))
    first = presses[0]
    known = None if depths_px is None else depth
    return Samples(change, x, y, gradients, np.ones(len(x)), first.size.shape, first.background, known)


def _depths_at(
    depths_px: Sequence[NDArray[Any]] | None, press: int, rows: NDArray[np.intp], cols: NDArray[np.intp]
) -> NDArray[np.float32]:
    return np.empty(0, np.float32) if depths_px is None else depths_px[press][rows, cols]


def with_rest_samples(
    samples: Samples,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    depths_px: Sequence[NDArray[Any]] | None = None,
) -> Samples:
    """The samples and up to half as many from the untouched gel, where the gradient is 0, at a lower weight."""
    parts = []
    for k, (press, contact) in enumerate(zip(presses, contacts)):
        step = max(1, int(np.sqrt(2 * press.size.size * len(presses) / len(samples.x_px))))
        rows, cols = (
            axis.ravel() for axis in np.mgrid[: press.size.shape[0] : step, : press.size.shape[1] : step]
        )
        distance = np.hypot(cols - contact.x_px, rows - contact.y_px)
        far = distance > REST_DISTANCE * contact.radius_px
        if press.usable is not None:
            far &= press.usable[rows, cols]
        rows, cols = rows[far], cols[far]
        parts.append((press.color_change[rows, cols], cols, rows, _depths_at(depths_px, k, rows, cols)))
    change, x, y, depth = (np.concatenate([part[i] for part in parts]) for i in range(4))
    return replace(
        samples,
        color_change=np.concatenate([samples.color_change, change]),
        x_px=np.concatenate([samples.x_px, x]),
        y_px=np.concatenate([samples.y_px, y]),
        gradients=np.concatenate([samples.gradients, np.zeros((len(x), 2))]),
        weight=np.concatenate([samples.weight, np.full(len(x), REST_WEIGHT)]),
        depth_px=None if samples.depth_px is None else np.concatenate([samples.depth_px, depth]),
    )
