"""Sensors, indenters and presses that cannot be are refused with the reason."""

import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import (
    Ball,
    Coating,
    Coin,
    Cone,
    Cylinder,
    Gel,
    HeightMap,
    Led,
    Mesh,
    Optics,
    Placed,
    Pose,
    Posed,
    Several,
    SimulatedSensor,
    Timing,
    led_color,
    press_poses,
    simulate_background,
    simulate_ball_presses,
    simulate_press,
    simulate_sequence,
    text_relief,
)
from made.sensors import DRAGGED, PLAIN, SMALL, box

REFUSED = [
    (lambda: Coating(specular=-1), "specular"),
    (lambda: Coating(shininess=10), "power of two"),
    (lambda: Coating(scattering=1.0), "scattering"),
    (lambda: Coating(marker_pitch_mm=0.3), "marker_pitch_mm"),
    (lambda: Coating(albedo=np.full((3, 3), 2.0)), "albedo"),
    (lambda: Led((0, 0, 2), (1, 1, 1), beam_power=-1), "beam_power"),
    (lambda: Led((0, 0, 2), (1, 1, 1), aim_mm=(0, 0, 2)), "aim_mm"),
    (lambda: led_color(900), "peak_nm"),
    (lambda: Led((0, 0, -2), (1, 1, 1)), "z > 0 mm"),
    (lambda: Led((0, 0, 2), (0, 0, 0)), "color"),
    (lambda: Timing(readout_s=1.0), "readout_s"),
    (lambda: Timing(drop_probability=1.0), "drop_probability"),
    (lambda: Timing(frame_rate_hz=0), "frame_rate_hz"),
    (lambda: Optics(height_mm=0.1), "height_mm"),
    (lambda: Optics(distortion=(-0.6, 0)), "fold"),
    (lambda: Optics(jpeg_quality=0), "jpeg_quality"),
    (lambda: Optics(response_gamma=0), "response_gamma"),
    (lambda: replace(PLAIN, leds=(Led((1, 0, 1), (1, 1, 1)),)), "outside the gel"),
    (lambda: replace(PLAIN, shading=((1, 2),)), "shading"),
    (lambda: SimulatedSensor(()), "at least one LED"),
    (lambda: replace(SMALL, noise_sd=-1), "noise_sd >= 0"),
    (lambda: replace(SMALL, noise_gain=-0.1), "noise_gain >= 0"),
    (lambda: replace(SMALL, vignetting=1.0), "vignetting"),
    (lambda: replace(SMALL, crosstalk=((1, 0), (0, 1))), "crosstalk"),
    (lambda: replace(SMALL, mm_per_px=0.0), "mm_per_px"),
    (lambda: replace(SMALL, shape=(0, 3)), "shape"),
    (lambda: Ball(6000), "another unit"),
    (lambda: Ball(0), "radius_mm > 0"),
    (lambda: HeightMap(np.full((4, 4), np.nan), 0.1), "finite height_mm"),
    (lambda: HeightMap(np.zeros(4), 0.1), "height_mm"),
    (lambda: Cone(4, 180), "angle_deg in 0-180"),
    (lambda: Cylinder(6000, 1), "another unit"),
    (lambda: text_relief("  ", height_mm=2), "printable ASCII"),
    (lambda: text_relief("gél", height_mm=2), "printable ASCII"),
    (lambda: Mesh(box(1, 1, 1)[0], box(1, 1, 1)[1][:-1]), "3 edges that border only one triangle"),
    (lambda: Mesh(np.zeros((4, 3)), np.zeros((0, 3), dtype=int)), "an empty one"),
    (lambda: Mesh(box(1, 1, 1)[0] * 100000.0, box(1, 1, 1)[1]), "another unit"),
    (lambda: Mesh(box(1, 1, 1)[0] * 0.001, box(1, 1, 1)[1]), "meters x 1000"),
    (lambda: Mesh(box(1, 1, 1)[0], box(1, 1, 1)[1] + 5), "indices in 0-7"),
    (lambda: Mesh(box(1, 1, 1)[0] * np.nan, box(1, 1, 1)[1]), "finite vertices_mm"),
    (lambda: Pose(np.nan), "finite numbers"),
    (lambda: Pose(0.3, tilt_deg=(0, 90)), "tilt_deg within"),
    (lambda: Posed(Coin(), tilt_deg=(80, 0)), "within +-75"),
    (lambda: Several(()), "at least one part"),
    (lambda: Several((Placed(Ball(1), back_mm=-1),)), "back_mm >= 0"),
    (lambda: simulate_background(SMALL, None, frames=0), "frames"),
    (
        lambda: simulate_press(replace(PLAIN, gel=Gel(1.0)), Ball(3), depth_mm=1.2, rng=None),
        "gel's thickness",
    ),
    (lambda: simulate_press(SMALL, Ball(3), depth_mm=-1, rng=None), "depth_mm > 0"),
    (lambda: simulate_press(SMALL, Ball(3), depth_mm=1, rng=None, oversample=2), "odd"),
    (
        lambda: simulate_press(SMALL, Ball(3), depth_mm=1, center_mm=(99, 0), rng=None),
        "touches the gel within",
    ),
    (
        lambda: simulate_ball_presses(SMALL, ball_diameters_mm=[], count=3, rng=np.random.default_rng()),
        "a ball",
    ),
    (lambda: press_poses(0.4, 0), "count >= 1"),
    (lambda: list(simulate_sequence(DRAGGED, Ball(3), [Pose(2.5)], rng=None)), "gel's thickness"),
]


def test_bad_settings_are_refused_with_the_reason():
    for make, message in REFUSED:
        with pytest.raises(ValueError, match=re.escape(message)):
            make()
