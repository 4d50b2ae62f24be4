"""Where the camera sees points of the gel."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Optics, simulate_press
from gelform.simulate.sensor.projection import maps_from_depth, px_seen
from made.sensors import PLAIN


def test_a_pinhole_sees_what_is_pressed_larger():
    sensor = replace(PLAIN, optics=Optics(height_mm=10.0))
    ball = {"depth_mm": 0.9, "center_mm": (1.5, 1.0), "rng": None, "oversample": 1}
    straight, pinhole = simulate_press(PLAIN, Ball(3), **ball), simulate_press(sensor, Ball(3), **ball)
    assert pinhole.contact.sum() > 1.02 * straight.contact.sum()
    y, x = np.nonzero(pinhole.contact)
    assert pinhole.center_px == pytest.approx((x.mean(), y.mean()), abs=0.6)
    assert pinhole.contact_radius_px == pytest.approx(np.sqrt(pinhole.contact.sum() / np.pi), rel=0.02)
    top = np.unravel_index(np.argmax(pinhole.depth_mm), (60, 80))
    away = np.array([1.5, 1.0]) / 0.1 / (1 - 0.9 / 10)
    assert (top[1] - 39.5, top[0] - 29.5) == pytest.approx(tuple(away), abs=1.2)


@pytest.mark.parametrize("k1", [-0.15, 0.1])
def test_distortion_moves_points_as_its_formula_says(k1):
    sensor = replace(PLAIN, optics=Optics(distortion=(k1, 0.02)))
    maps = maps_from_depth(sensor, np.zeros(PLAIN.shape))
    corner = px_seen(sensor, [(2.0, -1.5)])[0]
    j, i = np.round(corner).astype(int)
    looked_at = np.array([maps[0][i, j], maps[1][i, j]])
    straight = px_seen(PLAIN, [(2.0, -1.5)])[0]
    assert np.linalg.norm(corner - straight) > 0.5
    np.testing.assert_allclose(looked_at - straight, [j, i] - corner, atol=0.2)
