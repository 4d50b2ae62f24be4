"""A guided calibration on a station: its frames, and presses of the simulated sensor."""

from __future__ import annotations

import time

from gelform.calibration.guide import Guide
from gelform.live.shown import Shown
from gelform.live.station import Station

DEPTH_RATIO = 0.9  # of simulated presses: depth over radius x fraction^2 (0.5 for a spherical cap)
RIM_FRACTIONS = (0.45, 0.6, 0.52)  # contact radius over ball radius of successive simulated presses
GAP_S = 0.5  # s between simulated presses
HELD_S = 20.0  # s, longest simulated press; it is lifted once accepted, which takes long on a slow machine


class GuideSession:
    """One guided calibration on one station.

    Parameters
    ----------
    station : gives the frames
    guide : receives them
    """

    def __init__(self, station: Station, guide: Guide) -> None:
        self.guide = guide
        self._station = station
        self._pressed_s, self._pressed = 0.0, -1
        self._simulated = station.simulated
        if self._simulated is not None:
            self._simulated.rest()
        station.taps.append(self._tap)

    def close(self) -> None:
        """Stop receiving frames; the simulated sensor continues its program."""
        if self._tap in self._station.taps:
            self._station.taps.remove(self._tap)
        if self._simulated is not None:
            self._simulated.rest(False)

    def _tap(self, shown: Shown) -> None:
        self.guide.look_at(shown.frame)
        if self.guide.step == "press":
            self._press_simulated()

    def _press_simulated(self) -> None:
        """Press the simulated sensor at the suggested place, once for each target."""
        guide, target, now = self.guide, self.guide.target, time.monotonic()
        waiting = now - self._pressed_s < HELD_S and self._pressed == guide.count
        if self._simulated is None or target is None or waiting or guide.enough:
            return
        if self._pressed != guide.count:
            self._pressed, self._pressed_s = guide.count, now - HELD_S + GAP_S
            self._simulated.lift()
            return
        self._pressed_s = now
        radius = guide.ball_diameter_mm / 2
        fraction = RIM_FRACTIONS[guide.count % len(RIM_FRACTIONS)]
        depth = DEPTH_RATIO * radius * fraction**2 + 0.05
        self._simulated.press_at(target.x_px, target.y_px, depth, ball_diameter_mm=2 * radius, held_s=HELD_S)
