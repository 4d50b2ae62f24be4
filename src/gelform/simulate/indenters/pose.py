"""Where an indenter stands: its depth, place, turn and tilt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gelform.simulate.indenters.scene import MAX_TILT_DEG, Pair


@dataclass(frozen=True)
class Pose:
    """Where an indenter stands.

    Attributes
    ----------
    depth_mm : how far its foremost point stands in the gel; 0 or less: not pressed
    center_mm : (x, y) of its centre, x to the right, y down
    spin_deg, tilt_deg : as in `Posed`
    carried_mm : (x, y), how far the touched side of the indenter has travelled; None: as far as the centre
        (it slides). When it rolls, the touched side stays where it is.
    """

    depth_mm: float
    center_mm: Pair = (0.0, 0.0)
    spin_deg: float = 0.0
    tilt_deg: Pair = (0.0, 0.0)
    carried_mm: Pair | None = None

    def __post_init__(self) -> None:
        numbers = (self.depth_mm, *self.center_mm, self.spin_deg, *self.tilt_deg, *self.travel_mm)
        if not all(np.isfinite(numbers)):
            raise ValueError(f"Expected a pose of finite numbers, got {self}.")
        if max(map(abs, self.tilt_deg)) > MAX_TILT_DEG:
            raise ValueError(f"Expected tilt_deg within +-{MAX_TILT_DEG:g}, got {self.tilt_deg}.")

    @property
    def travel_mm(self) -> Pair:
        return self.center_mm if self.carried_mm is None else self.carried_mm
