"""Pixels of ball presses whose gradient is known: what color models are fitted on.

Inside the contact circle the gel follows the ball. Near the visible rim it has already left it, so a model
trains on r < zone * (contact radius) only; the zone is chosen on held-out presses.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.ball import ball_gradients, followed_radius
from gelform.calibration.circles.find import ContactCircle
from gelform.color_models import ColorModel, Samples

TOTAL_SAMPLES = 40_000
REST_WEIGHT = 0.3
REST_DISTANCE = 2.0


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
    depth_px : (H, W) float32, the depth that a plain model reads, px; None until a model asks for it
    followed : share of the visible radius inside which the gel follows the ball; the same for all presses
    """

    name: str
    color_change: NDArray[np.float32]
    size: NDArray[np.float32]
    ball_radius_px: float
    usable: NDArray[np.bool_] | None = None
    background: NDArray[np.float32] | None = None
    depth_px: NDArray[np.float32] | None = None
    followed: float = 1.0

    def followed_radius(self, contact: ContactCircle) -> float:
        """Radius, px, up to which the gel follows the ball."""
        visible = contact.radius_px
        return min(self.followed * visible, followed_radius(visible, self.ball_radius_px))

    def pixels(
        self, contact: ContactCircle, zone: float, count: int | None = None
    ) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Rows and columns of about `count` pixels inside `zone` of the followed radius, on a regular lattice."""
        radius = zone * self.followed_radius(contact)
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
        """The slopes that a model reads there; of the whole frame where a pixel alone does not tell it enough."""
        if getattr(model, "whole_frames", False):
            rest = np.zeros(self.color_change.shape) if self.background is None else self.background
            prepared = model.prepare(rest, rest.shape[:2])
            return prepared.gradients_from_color(self.color_change)[0][rows, cols].astype(np.float64)
        return model.gradients_at(self.color_change[rows, cols], cols, rows)

    def depths_at(self, rows: NDArray[np.intp], cols: NDArray[np.intp]) -> NDArray[np.float32]:
        """The depth there, px; none where it was not asked for."""
        return np.empty(0, np.float32) if self.depth_px is None else self.depth_px[rows, cols]


def contact_samples(
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    zone: float,
    *,
    total: int = TOTAL_SAMPLES,
) -> Samples:
    """Samples inside the contacts, labelled by the balls: about `total`, shared evenly by the presses."""
    parts = []
    for press, contact in zip(presses, contacts):
        rows, cols = press.pixels(contact, zone, max(200, total // len(presses)))
        gradients = press.ball_gradients(contact, rows, cols)
        parts.append((press.color_change[rows, cols], cols, rows, gradients, press.depths_at(rows, cols)))
    change, x, y, gradients, depth = (np.concatenate([part[i] for part in parts]) for i in range(5))
    first = presses[0]
    known = None if first.depth_px is None else depth
    return Samples(change, x, y, gradients, np.ones(len(x)), first.size.shape, first.background, known)


def with_rest_samples(
    samples: Samples, presses: Sequence[PreparedPress], contacts: Sequence[ContactCircle]
) -> Samples:
    """The samples and up to half as many from the untouched gel, where the gradient is 0, at a lower weight."""
    parts = []
    for press, contact in zip(presses, contacts):
        step = max(1, int(np.sqrt(2 * press.size.size * len(presses) / len(samples.x_px))))
        rows, cols = (
            axis.ravel() for axis in np.mgrid[: press.size.shape[0] : step, : press.size.shape[1] : step]
        )
        distance = np.hypot(cols - contact.x_px, rows - contact.y_px)
        far = distance > REST_DISTANCE * contact.radius_px
        if press.usable is not None:
            far &= press.usable[rows, cols]
        rows, cols = rows[far], cols[far]
        parts.append((press.color_change[rows, cols], cols, rows, press.depths_at(rows, cols)))
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
