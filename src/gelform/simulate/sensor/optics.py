"""The lens and what the camera computes: projection, distortion, response curve, exposure, JPEG."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Optics:
    """A camera over the middle of the gel.

    Attributes
    ----------
    height_mm : float or None
        Of a pinhole over the gel: pressed surface is nearer and looks larger. None: orthographic.
    distortion : (k1, k2)
        Radial, Brown's model: a point at distance r from the middle appears at r (1 + k1 r^2 + k2 r^4), r in
        units of half the image's diagonal; k1 < 0 is a barrel.
    response_gamma : float
        Grey level = 255 (linear level/255)^(1/gamma): 1 is linear, 2.2 about sRGB.
    exposure : float
        Times the light; noise follows, as its signal does.
    jpeg_quality : int 1-100, or None
        Of the camera's compression; None: none.
    """

    height_mm: float | None = None
    distortion: tuple[float, float] = (0.0, 0.0)
    response_gamma: float = 1.0
    exposure: float = 1.0
    jpeg_quality: int | None = None

    def __post_init__(self) -> None:
        if self.height_mm is not None and not 1 <= self.height_mm < np.inf:
            raise ValueError(f"Expected height_mm >= 1 or None (orthographic), got {self.height_mm}.")
        if np.shape(self.distortion) != (2,) or not np.all(np.isfinite(self.distortion)):
            raise ValueError(f"Expected distortion as (k1, k2), got {self.distortion}.")
        r = np.linspace(0, 1.2, 200)
        if np.any(np.diff(r * (1 + self.distortion[0] * r**2 + self.distortion[1] * r**4)) <= 0):
            raise ValueError(f"Expected distortion that does not fold the image over, got {self.distortion}.")
        if not 0.2 <= self.response_gamma <= 5:
            raise ValueError(f"Expected response_gamma in 0.2-5, got {self.response_gamma}.")
        if not 0 < self.exposure < np.inf:
            raise ValueError(f"Expected exposure > 0, got {self.exposure}.")
        if self.jpeg_quality is not None and not 1 <= self.jpeg_quality <= 100:
            raise ValueError(f"Expected jpeg_quality in 1-100 or None, got {self.jpeg_quality}.")

    @property
    def is_plain(self) -> bool:
        """Whether every pixel looks straight down at its own place."""
        return self.height_mm is None and self.distortion == (0.0, 0.0)
