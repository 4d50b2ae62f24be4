"""Slopes of one frame -> depth, with weights and the anchor where the solver takes them."""

from __future__ import annotations

from typing import Any

from gelform.depth.anchor import RestAnchor
from gelform.depth.integrate import Integration, integrate_unchecked
from gelform.depth.solvers.inputs import takes_weights
from gelform.slopes.confidence import ReadSlopes


class FrameDepth:
    """Depth for the frames of one calibration. It is immutable; threads can share it.

    Parameters
    ----------
    shape : (H, W)
    pitch : mm per pixel
    solver : a checked name; one that treats all slopes alike uses neither weights nor anchor
    full_confidence_sigma : standard deviation of a slope of confidence 1, mm/mm
    """

    def __init__(
        self, shape: tuple[int, int], pitch: float, solver: str, full_confidence_sigma: float
    ) -> None:
        self.solver, self._pitch, self._full = solver, pitch, full_confidence_sigma
        self._anchor = RestAnchor(shape, pitch, full_confidence_sigma) if takes_weights(solver) else None

    def __call__(self, slopes: ReadSlopes) -> Integration:
        """The depth of a frame's slopes; it is 0 at rest."""
        how: dict[str, Any] = {"zero": slopes.at_rest}
        if self._anchor is not None:
            anchor = self._anchor(slopes.gradients, slopes.at_rest)
            how = {"weights": slopes.weights(self._full), "anchor": anchor}
        return integrate_unchecked(slopes.gradients, mm_per_px=self._pitch, solver=self.solver, **how)
