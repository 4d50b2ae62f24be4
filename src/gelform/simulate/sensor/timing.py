"""What changes from frame to frame: rate, rolling readout, flicker, drift of the LEDs, dropped frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_positive

Triple = tuple[float, float, float]


@dataclass(frozen=True)
class Timing:
    """A camera's clock and the LEDs' age.

    Attributes
    ----------
    frame_rate_hz : float
    readout_s : float
        From the first row's exposure to the last row's (rolling shutter); 0: all rows at once.
    flicker : float, 0-1, flicker_hz : float
        The LEDs' light swings by this part of its mean, at this rate.
    drift : (red, green, blue), drift_time_s : float
        The light moves by this part of itself in the end, exponentially with this time (warming up).
    drop_probability : float, 0-1
        Of each frame to be lost; its index is skipped.
    """

    frame_rate_hz: float = 25.0
    readout_s: float = 0.0
    flicker: float = 0.0
    flicker_hz: float = 100.0
    drift: Triple = (0.0, 0.0, 0.0)
    drift_time_s: float = 300.0
    drop_probability: float = 0.0

    def __post_init__(self) -> None:
        for name in ("frame_rate_hz", "flicker_hz", "drift_time_s"):
            check_positive(getattr(self, name), name)
        if not 0 <= self.readout_s <= 1 / self.frame_rate_hz:
            raise ValueError(
                "Expected readout_s between 0 and the frame's time "
                f"1/{self.frame_rate_hz:g} s, got {self.readout_s}."
            )
        if not 0 <= self.flicker < 1 or not 0 <= self.drop_probability < 1:
            raise ValueError(
                f"Expected flicker and drop_probability in 0-1 (1 excluded), got {self.flicker} and "
                f"{self.drop_probability}."
            )
        if np.shape(self.drift) != (3,) or min(self.drift) <= -1:
            raise ValueError(f"Expected drift as three numbers > -1, got {self.drift}.")

    def light_at(self, time_s: float, rows: int) -> NDArray[np.float64]:
        """The LEDs' light relative to time 0 without flicker, for each row and channel: (rows, 1, 3)."""
        warm = 1 + np.asarray(self.drift) * -np.expm1(-time_s / self.drift_time_s)
        when = time_s + self.readout_s * np.arange(rows) / rows
        swing = 1 + self.flicker * np.sin(2 * np.pi * self.flicker_hz * when)
        light: NDArray[Any] = swing[:, None, None] * warm
        return np.asarray(light, dtype=np.float64)
