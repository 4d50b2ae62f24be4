"""LEDs: where each is, how strong in each channel and where it shines; rows and rings of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Triple = tuple[float, float, float]
RED: Triple = (1, 0, 0)
GREEN: Triple = (0, 1, 0)
BLUE: Triple = (0, 0, 1)


@dataclass(frozen=True)
class Led:
    """A small light near the gel; unless it has a beam it shines alike in all directions.

    Attributes
    ----------
    position_mm : (x, y, z)
        From the gel's centre; x to the right, y down, z towards the camera: z > 0.
    color : (red, green, blue)
        Strength in each channel, >= 0: grey levels that a white surface facing it gives at 1 mm.
    beam_power : int, 0-64
        Falls off beside its axis with this power of the cosine: 0 not at all, 1 Lambert's emitter, more:
        narrow.
    aim_mm : (x, y, z)
        The point that its axis goes through; the gel's centre unless said.
    size_mm : float
        Its diameter; only cast shadows know it: larger is softer.
    """

    position_mm: Triple
    color: Triple
    beam_power: int = 0
    aim_mm: Triple = (0.0, 0.0, 0.0)
    size_mm: float = 1.0

    def __post_init__(self) -> None:
        position, color = _triple(self.position_mm, "position_mm"), _triple(self.color, "color")
        if position[2] <= 0:
            raise ValueError(
                f"Expected an LED on the camera's side of the gel (z > 0 mm), got position_mm="
                f"{self.position_mm}. "
                "z points from the gel towards the camera."
            )
        if min(color) < 0 or max(color) == 0:
            raise ValueError(f"Expected color >= 0 and not all 0, got {self.color}.")
        if np.all(_triple(self.aim_mm, "aim_mm") == position):
            raise ValueError(f"Expected aim_mm away from the LED itself, got {self.aim_mm}.")
        if int(self.beam_power) != self.beam_power or not 0 <= self.beam_power <= 64:
            raise ValueError(f"Expected beam_power as a whole number in 0-64, got {self.beam_power}.")
        if not 0 <= self.size_mm < np.inf:
            raise ValueError(f"Expected size_mm >= 0, got {self.size_mm}.")


def led_row(start_mm: Triple, end_mm: Triple, color: Triple, count: int) -> tuple[Led, ...]:
    """`count` equal LEDs from one point to another; together as strong as `color`."""
    share: Triple = (color[0] / count, color[1] / count, color[2] / count)
    points = np.linspace(start_mm, end_mm, count)
    return tuple(Led((float(x), float(y), float(z)), share) for x, y, z in points)


def led_ring(
    distance_mm: float,
    height_mm: float,
    angles_deg: Sequence[float],
    colors: Sequence[Triple] = (RED, GREEN, BLUE),
) -> tuple[Led, ...]:
    """One LED of each colour around the gel's centre; 0 degrees is to the right, 90 is down."""
    angles = np.deg2rad(angles_deg)
    return tuple(
        Led((float(distance_mm * np.cos(a)), float(distance_mm * np.sin(a)), height_mm), color)
        for a, color in zip(angles, colors)
    )


def led_color(peak_nm: float, width_nm: float = 25.0) -> tuple[float, float, float]:
    """Strength in the three channels of an LED of unit power with a Gaussian spectrum.

    The channels' sensitivities are taken as Gaussians about 600, 540 and 465 nm, 45, 45 and 35 nm wide (standard
    deviations): round figures, measured on no camera. The product of two Gaussians integrates in closed form.

    Parameters
    ----------
    peak_nm : 380-750
    width_nm : full width at half maximum
    """
    if not 380 <= peak_nm <= 750 or not 0 < width_nm < 400:
        raise ValueError(f"Expected peak_nm in 380-750 and width_nm in 0-400, got {peak_nm} and {width_nm}.")
    sd = width_nm / 2.3548
    centers, widths = np.array([600.0, 540.0, 465.0]), np.array([45.0, 45.0, 35.0])
    total = widths**2 + sd**2
    seen = widths / np.sqrt(total) * np.exp(-((peak_nm - centers) ** 2) / (2 * total))
    return float(seen[0]), float(seen[1]), float(seen[2])


def _triple(values: Any, name: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != (3,) or not np.all(np.isfinite(array)):
        raise ValueError(f"Expected {name} as three finite numbers, got {values}.")
    return array
