"""Ready sensors: layouts with different lights, for tests of calibration, and models of real sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from gelform.simulate.gel import Gel
from gelform.simulate.light import exposed
from gelform.simulate.sensor import (
    BLUE,
    GREEN,
    RED,
    Coating,
    Led,
    Optics,
    SimulatedSensor,
    Timing,
    led_ring,
    led_row,
)

LAYOUTS: dict[str, SimulatedSensor] = {
    # Like a GelSight Mini: rows of LEDs along the left and right edges and the lower one; mean levels of the background
    # image 78, 95, 105, as of a real one.
    "three-edges": SimulatedSensor(
        (
            *led_row((-18, -10, 12), (-18, 2, 12), RED, 4),
            *led_row((18, -10, 15), (18, 2, 15), GREEN, 4),
            *led_row((-7, 17, 13), (7, 17, 13), BLUE, 4),
        ),
        name="three-edges",
        white_balance=(67125.0, 70246.0, 79685.0),
        ambient=(0.0001, 0.00025, 0.00015),
        vignetting=0.6,
        crosstalk=((1, 0.06, 0.02), (0.08, 1, 0.12), (0.02, 0.15, 1)),
        blur_px=0.8,
        noise_sd=0.7,
        noise_gain=0.015,
    ),
    # Three far LEDs at 120 degrees: the textbook's photometric stereo; mean levels 110.
    "ring-120": SimulatedSensor(
        led_ring(24, 22, (90, 210, 330)),
        name="ring-120",
        white_balance=(176860.0, 165520.0, 170150.0),
        vignetting=0.15,
        crosstalk=((1, 0.03, 0), (0.03, 1, 0.03), (0, 0.03, 1)),
        blur_px=0.5,
        noise_sd=0.8,
        relaxation_mm=0.4,
    ),
    # Close, low lights at uneven places, much crosstalk, vignetting and noise: a first home-made sensor; levels 85, 80, 75.
    "homemade": SimulatedSensor(
        (
            Led((-12.5, -3, 7.5), (1, 0.05, 0)),
            Led((10, -9.5, 8), (0, 1.2, 0.1)),
            Led((3, 11.5, 7), (0.05, 0.1, 0.9)),
        ),
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
    ),
}


@lru_cache(maxsize=1)
def gelsight_mini() -> SimulatedSensor:
    """A GelSight Mini without markers, 240x320.

    Lights and shading were fitted to the ratio of light under press to light at rest in 23 ball presses of a real one, and
    to its background. The positions explain the picture; they are not those of the LEDs.
    """
    leds = (
        *led_row((-9.95, -9.45, 8.51), (-0.89, -13.69, 8.51), (1094.4, 4.8, 1.6), 3),
        *led_row((22.29, -20.32, 4.01), (27.71, -11.92, 4.01), (1942.0, 580.8, 7.2), 3),
        *led_row((9.81, 4.01, 9.97), (2.11, 10.39, 9.97), (0.8, 142.0, 4375.2), 3),
    )
    # fmt: off
    shading = (
        (34.0619, 0.1564, 0.7991, -0.6587, 0.048, -0.7143, -0.1049, -0.381,
         -0.0972, -0.3962, 0.1431, -0.0588, 0.1729, -0.0738, 0.3057),
        (107.3763, -0.4137, -0.3851, -0.3031, -0.0509, -0.1293, 0.086, 0.2042,
         0.0885, 0.1151, 0.1666, 0.0262, 0.0029, 0.0158, -0.0128),
        (4.1243, -0.3606, -0.4866, -0.3673, -0.0378, -0.5825, 0.1709, 0.1768,
         0.1525, 0.2114, 0.0935, 0.0048, 0.0934, -0.0119, 0.3204),
    )
    # fmt: on
    return SimulatedSensor(
        leds,
        ambient=(1.216, 0.473, 20.085),
        shading=shading,
        name="gelsight-mini",
        mm_per_px=0.0634,
        blur_px=1.0,
        noise_sd=1.8,
        relaxation_mm=0.35,
        gel=Gel(thickness_mm=3.5, bulge=0.5),
        coating=Coating(scattering=0.15, scattering_mm=0.4, roughness=0.004, scratches=2, dust=2, seed=7),
        timing=Timing(frame_rate_hz=25.0),
    )


@lru_cache(maxsize=1)
def digit() -> SimulatedSensor:
    """A DIGIT, 320x240: three strong lights and their triangular cast shadows.

    It was fitted like the GelSight Mini, to 21 ball presses whose scale is not verified.
    """
    leds = (
        *led_row((21.83, -18.68, 11.4), (23.07, -17.12, 11.4), (1669.6, 0.8, 568.4), 3),
        *led_row((-25.67, -21.72, 14.44), (-24.33, -23.2, 14.44), (224.4, 1518.8, 0.8), 3),
        *led_row((2.77, 24.93, 9.87), (0.77, 25.07, 9.87), (1.2, 286.8, 2970.0), 3),
    )
    # fmt: off
    shading = (
        (95.5746, -0.98, -0.3596, -0.0176, 0.0783, -0.397, 0.2097, 0.1815,
         0.5362, 0.4217, -0.0201, 0.0297, -0.0162, -0.232, -0.0909),
        (125.4948, 0.6298, -0.3543, 0.0309, -0.278, -0.622, -0.178, 0.0501,
         -0.4134, 0.3681, -0.1014, 0.0093, 0.1188, 0.347, 0.128),
        (42.7263, -0.4256, -0.2613, -0.2162, 0.2671, -0.246, 0.0827, 0.0837,
         0.0878, -0.403, 0.106, -0.0746, -0.1381, -0.0741, 0.3085),
    )
    # fmt: on
    return SimulatedSensor(
        leds,
        ambient=(0.54, 0.391, 0.722),
        shading=shading,
        name="digit",
        shape=(320, 240),
        mm_per_px=0.05107,
        blur_px=1.2,
        noise_sd=1.9,
        relaxation_mm=0.6,
        gel=Gel(thickness_mm=3.0, bulge=0.3),
        coating=Coating(scattering=0.2, scattering_mm=0.5, roughness=0.004, dust=4, seed=3),
        timing=Timing(frame_rate_hz=30.0),
        cast_shadows=True,
    )


@lru_cache(maxsize=1)
def gelslim() -> SimulatedSensor:
    """A sensor like GelSlim 3.0: low light from the edges, markers, a lens with distortion; 240x320.

    The idea is that of Taylor, Dong and Rodriguez, GelSlim 3.0, ICRA 2022. The figures are guesses, neither taken from the
    paper nor fitted, because no images of one were available.
    """
    leds = (
        *led_row((-17, -8, 4), (-17, 8, 4), (1, 0.05, 0.02), 4),
        *led_row((17, -8, 4), (17, 8, 4), (0.03, 1, 0.08), 4),
        *led_row((-10, 14, 5), (10, 14, 5), (0.02, 0.1, 1), 4),
    )
    sensor = SimulatedSensor(
        leds,
        name="gelslim",
        mm_per_px=0.07,
        ambient=(0.0006, 0.0006, 0.0006),
        vignetting=0.4,
        crosstalk=((1, 0.1, 0.02), (0.1, 1, 0.1), (0.02, 0.12, 1)),
        blur_px=1.0,
        noise_sd=1.5,
        noise_gain=0.01,
        relaxation_mm=0.5,
        gel=Gel(thickness_mm=2.5, bulge=0.4),
        coating=Coating(scattering=0.2, roughness=0.01, marker_pitch_mm=2.0, marker_radius_mm=0.2, seed=5),
        optics=Optics(height_mm=40.0, distortion=(0.06, 0.0)),
        timing=Timing(frame_rate_hz=60.0),
        cast_shadows=True,
    )
    return exposed(sensor, (90, 95, 90))


@lru_cache(maxsize=1)
def first_build() -> SimulatedSensor:
    """A first home-made sensor: the layout `homemade` with all its usual faults."""
    return replace(
        LAYOUTS["homemade"],
        name="first-build",
        gel=Gel(thickness_mm=4.0, bulge=0.5),
        coating=Coating(
            specular=0.15,
            shininess=16,
            scattering=0.3,
            interreflection=0.1,
            roughness=0.02,
            scratches=6,
            dust=15,
        ),
        optics=Optics(height_mm=22.0, distortion=(-0.08, 0.0), jpeg_quality=85),
        timing=Timing(readout_s=0.03, flicker=0.01, drift=(0.04, 0.02, 0.01), drop_probability=0.02),
        cast_shadows=True,
    )
