"""Dots followed from frame to frame, however far they move: what has memory of them, one per sequence."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_image
from gelform.markers.flow import MarkerFlow
from gelform.markers.follower import MarkerFollower

FAST = 0.05  # spacings a frame: slower dots are sought where they were last, noise is not carried on
DOUBTFUL = 0.1  # fraction of the dots lost since the last frame, from which rest is tried too


class MarkerTracker:
    """Follows the dots of one gel through a sequence of images.

    Each dot is sought where its motion so far puts it, so that it may move by many spacings; by less than about half of
    one from frame to frame. After a gap in which the gel sprang back it is found at rest again.

    Parameters
    ----------
    background : (H, W, 3), 0-255, the untouched gel; or a MarkerFollower of it, which can be shared
    mm_per_px : float or (x, y), mm; of a follower, its own
    """

    def __init__(
        self,
        background: ArrayLike | MarkerFollower,
        mm_per_px: float | tuple[float, float] | None = None,
    ) -> None:
        if not isinstance(background, MarkerFollower):
            background, mm_per_px = MarkerFollower(background, mm_per_px), None
        if mm_per_px is not None:
            raise ValueError("Expected mm_per_px of the follower itself, got another. Leave it out here.")
        self._follower = background
        self.reset()

    def __len__(self) -> int:
        return len(self._follower)

    def reset(self) -> None:
        """Forget all motion: the next image is sought from rest."""
        self._shift = self._velocity = np.zeros((len(self), 2))
        self._seen = len(self)

    def update(self, image: ArrayLike) -> MarkerFlow | None:
        """Where the dots are in the sequence's next image (H, W, 3), 0-255; None where the gel has no markers."""
        pixels = check_image(image)
        if not len(self):
            return None
        flow = self._followed(pixels)
        moved = flow.displacement_px - self._shift
        fast = np.linalg.norm(moved, axis=1) > FAST * self._follower.spacing_px
        self._velocity = np.where((fast & flow.seen)[:, None], moved, 0)
        self._shift, self._seen = flow.displacement_px.astype(np.float64), int(flow.seen.sum())
        return flow

    def _followed(self, pixels: NDArray[Any]) -> MarkerFlow:
        """The likeliest of the flows from where the dots should be and, where some are lost, from rest."""
        flow = self._follower(pixels, self._shift + self._velocity)
        if flow.seen.sum() >= self._seen - DOUBTFUL * len(self):
            return flow
        others = [self._follower(pixels, self._shift), self._follower(pixels)]
        return min((flow, *others), key=self._follower.unlikeliness)
