"""Ready sensors with quite different lights, for tests of what a calibration can cope with."""

from __future__ import annotations

from gelform.simulate.sensor.led import BLUE, GREEN, RED, Led, led_ring, led_row
from gelform.simulate.sensor.sensor import SimulatedSensor


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
    "three-edges": _three_edges(),
    "ring-120": _ring_120(),
    "homemade": _homemade(),
}
