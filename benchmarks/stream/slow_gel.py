"""A simulated sensor over minutes: LEDs warm up separately, the gel relaxes, a ball is pressed slowly."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.simulate import Ball, SimulatedSensor
from gelform.simulate.gel import Surface, flat_surface, surface_from_indenter
from gelform.simulate.light import render

DRIFT_TIME_S = 100.0, 300.0
RELAXED_MM, RELAXED_WIDTH_MM = (0.01, 0.03), (3.0, 8.0)


@dataclass(frozen=True)
class Touch:
    """A ball that descends from `start_s` on, stays for `hold_s` and is lifted within a second.

    Attributes
    ----------
    press_s : duration of the descent to `depth_mm`
    """

    start_s: float
    press_s: float
    hold_s: float
    depth_mm: float
    center_mm: tuple[float, float]
    radius_mm: float

    def depth_at(self, time_s: float) -> float:
        """Its depth in the gel, mm; 0 without contact."""
        after_s = time_s - self.start_s
        if after_s < self.press_s:
            return max(0.0, self.depth_mm * after_s / self.press_s)
        return self.depth_mm * max(0.0, 1 - max(0.0, after_s - self.press_s - self.hold_s))


@dataclass(frozen=True, eq=False)
class SlowGel:
    """Slow changes: each LED's light, exponentially to its own end; the surface at rest, a broad hill that sinks.

    Attributes
    ----------
    led_ends : (N,) final change of each LED, as a fraction of its light
    led_times_s : (N,) time constants
    hill_mm, hill_width_mm, hill_center_mm, hill_time_s : of the hill: height, standard deviation, place, time constant
    touches : the presses
    """

    sensor: SimulatedSensor
    led_ends: NDArray[np.float64]
    led_times_s: NDArray[np.float64]
    hill_mm: float
    hill_width_mm: float
    hill_center_mm: tuple[float, float]
    hill_time_s: float
    touches: tuple[Touch, ...] = ()

    @classmethod
    def drawn(
        cls,
        sensor: SimulatedSensor,
        rng: np.random.Generator,
        *,
        drift: float = 0.05,
        touches: tuple[Touch, ...] = (),
    ) -> SlowGel:
        """LEDs that change by `drift` on average, differently but in one direction; a gel that relaxes at random."""
        count = len(sensor.leds)
        half = np.array(sensor.shape[::-1]) * sensor.mm_per_px / 2
        x, y = rng.uniform(-half, half)
        return cls(
            sensor,
            rng.choice([-1, 1]) * drift * rng.uniform(0.6, 1.4, count),
            rng.uniform(*DRIFT_TIME_S, count),
            rng.choice([-1, 1]) * rng.uniform(*RELAXED_MM),
            rng.uniform(*RELAXED_WIDTH_MM),
            (float(x), float(y)),
            rng.uniform(*DRIFT_TIME_S),
            touches,
        )

    def image_at(self, time_s: float, rng: np.random.Generator | None) -> NDArray[np.uint8]:
        """The camera's image (H, W, 3) uint8; without noise if `rng` is None."""
        light = 1 + self.led_ends * -np.expm1(-time_s / self.led_times_s)
        leds = tuple(
            replace(led, color=tuple(share * part for part in led.color))
            for led, share in zip(self.sensor.leds, light)
        )
        sensor = replace(self.sensor, leds=leds)
        return np.asarray(render(sensor, self.surface_at(time_s), rng=rng).image, dtype=np.uint8)

    def surface_at(self, time_s: float) -> Surface:
        """The pressed gel on its hill; its height counts from time 0."""
        pressed = self.pressed_at(time_s)
        x, y = pressed.x_mm - self.hill_center_mm[0], pressed.y_mm - self.hill_center_mm[1]
        hill = np.exp(-(x**2 + y**2) / (2 * self.hill_width_mm**2))
        hill *= self.hill_mm * np.expm1(-time_s / self.hill_time_s)
        slopes = np.stack(np.broadcast_arrays(-x * hill, -y * hill), axis=-1) / self.hill_width_mm**2
        return replace(pressed, depth_mm=pressed.depth_mm + hill, gradients=pressed.gradients + slopes)

    def pressed_at(self, time_s: float) -> Surface:
        """The surface of the touches alone, which is the true depth."""
        grid = self.sensor.grid_mm()
        for touch in self.touches:
            depth = touch.depth_at(time_s)
            if depth > 1e-6:
                return surface_from_indenter(
                    Ball(touch.radius_mm),
                    *grid,
                    center_mm=touch.center_mm,
                    depth_mm=depth,
                    relaxation_mm=self.sensor.relaxation_mm,
                    gel=self.sensor.gel,
                )
        return flat_surface(*grid)
