"""Balls and height maps."""

import re

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Ball, HeightMap, simulate_press
from made.sensors import grid


def test_a_height_map_of_a_ball_is_a_ball():
    pitch = 0.02
    x, y = grid(1.2, pitch)
    heights = np.sqrt(4 - x**2 - y**2)
    sensor = LAYOUTS["ring-120"]
    by_map = simulate_press(
        sensor, HeightMap(heights, pitch), depth_mm=0.3, center_mm=(1, 2), rng=None, oversample=1
    )
    by_ball = simulate_press(sensor, Ball(2), depth_mm=0.3, center_mm=(1, 2), rng=None, oversample=1)
    both = by_map.contact & by_ball.contact
    assert both.sum() > 0.9 * by_ball.contact.sum()
    np.testing.assert_allclose(by_map.depth_mm[both], by_ball.depth_mm[both], atol=1e-6)
    np.testing.assert_allclose(by_map.depth_mm, by_ball.depth_mm, atol=5e-3)
    inside = by_ball.depth_mm > 0.2
    np.testing.assert_allclose(by_map.gradients[inside], by_ball.gradients[inside], atol=5e-3)


REFUSED = [
    (lambda: Ball(6000), "another unit"),
    (lambda: Ball(0), "radius_mm > 0"),
    (lambda: HeightMap(np.full((4, 4), np.nan), 0.1), "finite height_mm"),
    (lambda: HeightMap(np.zeros(4), 0.1), "height_mm"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
