"""Positions of the gel's markers in an image, and at rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_mm_per_px

_SHAPES = {"rest_px": (2,), "now_px": (2,), "seen": (), "sigma_px": ()}


@dataclass(frozen=True, eq=False)
class MarkerFlow:
    """The displacement of each marker of a gel from rest, which shows the shear of the surface.

    Markers keep their order from frame to frame.

    Attributes
    ----------
    rest_px : (N, 2) float32, x and y, positions at rest
    now_px : (N, 2) float32, positions in this image; that of an unseen marker is predicted from its neighbors
    seen : (N,) bool, whether the marker itself was measured
    sigma_px : (N,) float32, one standard deviation of `now_px`, for x and y alike; large if not seen
    mm_per_px : float or (x, y), mm; None if the scale is unknown
    """

    rest_px: NDArray[np.float32]
    now_px: NDArray[np.float32]
    seen: NDArray[np.bool_]
    sigma_px: NDArray[np.float32]
    mm_per_px: float | tuple[float, float] | None = None

    def __post_init__(self) -> None:
        count = len(self.rest_px)
        for name, columns in _SHAPES.items():
            got = np.shape(getattr(self, name))
            if got != (count, *columns):
                raise ValueError(f"Expected {name} of shape {(count, *columns)}, as rest_px, got {got}.")

    def __len__(self) -> int:
        return len(self.rest_px)

    def __repr__(self) -> str:
        return f"MarkerFlow({self.in_words()})"

    @property
    def displacement_px(self) -> NDArray[np.float32]:
        """Displacement (N, 2) of each marker from rest, x to the right and y down, pixels."""
        return self.now_px - self.rest_px

    @property
    def displacement_mm(self) -> NDArray[np.float32] | None:
        """Displacement (N, 2) on the gel, mm; None if the scale is unknown."""
        return None if self.mm_per_px is None else self.displacement_px * self._pitch

    @property
    def sigma_mm(self) -> NDArray[np.float32] | None:
        """One standard deviation (N,) of the displacement, mm; None if the scale is unknown."""
        return None if self.mm_per_px is None else self.sigma_px * self._pitch.max()

    def in_words(self) -> str:
        """One line for people: the number of seen markers, and their displacement."""
        if not self.seen.any():
            return f"none of {len(self)} seen"
        scaled = self.displacement_mm
        moved, unit = (self.displacement_px, "px") if scaled is None else (scaled, "mm")
        away = np.linalg.norm(moved[self.seen], axis=1)
        return (
            f"{np.count_nonzero(self.seen)} of {len(self)} seen, moved {np.median(away):.3f} {unit} (median), "
            f"{away.max():.3f} {unit} at most"
        )

    def facts(self) -> dict[str, Any]:
        """All of it, as values that JSON can hold; one list entry for each marker."""
        millimeters = self.displacement_mm
        return {
            "in_words": self.in_words(),
            **{name: values.tolist() for name, values in self.arrays().items()},
            "displacement_px": self.displacement_px.tolist(),
            "displacement_mm": None if millimeters is None else millimeters.tolist(),
        }

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The arrays of a file, by the names of the attributes."""
        return {name: getattr(self, name) for name in _SHAPES}

    @property
    def _pitch(self) -> NDArray[np.float32]:
        return np.array(check_mm_per_px(self.mm_per_px), dtype=np.float32)
