"""Ready sensors with quite different lights, for tests of what a calibration can cope with."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gelform.simulate.sensor.sensor import Led, SimulatedSensor, Triple

RED: Triple = (1, 0, 0)
GREEN: Triple = (0, 1, 0)
BLUE: Triple = (0, 0, 1)


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


def _three_edges() -> SimulatedSensor:
    """As a GelSight Mini: rows of LEDs along the left and right edges and the lower one.

    Mean levels of the untouched image: 78, 95, 105, as of a real one.
    """
    leds = (
        *led_row((-18, -10, 12), (-18, 2, 12), RED, 4),
        *led_row((18, -10, 15), (18, 2, 15), GREEN, 4),
        *led_row((-7, 17, 13), (7, 17, 13), BLUE, 4),
    )
    return SimulatedSensor(
        leds,
        name="three-edges",
        white_balance=(67125.0, 70246.0, 79685.0),
        ambient=(0.0001, 0.00025, 0.00015),
        vignetting=0.6,
        crosstalk=((1, 0.06, 0.02), (0.08, 1, 0.12), (0.02, 0.15, 1)),
        blur_px=0.8,
        noise_sd=0.7,
        noise_gain=0.015,
    )


def _ring_120() -> SimulatedSensor:
    """Three far LEDs at 120 degrees: the textbook's photometric stereo. Mean levels 110."""
    return SimulatedSensor(
        led_ring(24, 22, (90, 210, 330)),
        name="ring-120",
        white_balance=(176860.0, 165520.0, 170150.0),
        vignetting=0.15,
        crosstalk=((1, 0.03, 0), (0.03, 1, 0.03), (0, 0.03, 1)),
        blur_px=0.5,
        noise_sd=0.8,
        relaxation_mm=0.4,
    )


def _homemade() -> SimulatedSensor:
    """Close, low lights of unequal places, much crosstalk, vignetting and noise: a first own build.

    Mean levels 85, 80, 75.
    """
    leds = (
        Led((-12.5, -3, 7.5), (1, 0.05, 0)),
        Led((10, -9.5, 8), (0, 1.2, 0.1)),
        Led((3, 11.5, 7), (0.05, 0.1, 0.9)),
    )
    return SimulatedSensor(
        leds,
        name="homemade",
        white_balance=(17603.0, 14560.0, 16165.0),
        mm_per_px=0.055,
        ambient=(0.0015, 0.0015, 0.0015),
        vignetting=0.5,
        crosstalk=((1, 0.2, 0.05), (0.15, 1, 0.25), (0.05, 0.2, 1)),
        blur_px=1.2,
        noise_sd=1.2,
        noise_gain=0.02,
        relaxation_mm=0.7,
    )


LAYOUTS: dict[str, SimulatedSensor] = {
    sensor.name: sensor for sensor in (_three_edges(), _ring_120(), _homemade())
}
