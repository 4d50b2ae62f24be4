"""Faces against their geometry."""

import numpy as np
import pytest

from gelform.simulate import (
    LAYOUTS,
    Ball,
    BoxEdge,
    Coin,
    Cone,
    Cylinder,
    HeightMap,
    Punch,
    Pyramid,
    Screw,
    Torus,
    simulate_press,
    text_relief,
)
from made.sensors import X, Y, grid


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


SHAPES = [
    Ball(3),
    BoxEdge(5),
    Coin(6),
    Cone(4),
    Cylinder(2, 5),
    Punch(4),
    Punch(4, 2),
    Pyramid(3),
    Screw(5),
    Torus(2, 0.6),
    text_relief("Gel 7", height_mm=1.5),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: type(shape).__name__)
def test_every_face_is_highest_at_its_foremost_point(shape):
    face = shape.face_mm(X, Y)
    assert face.shape == (161, 161)
    assert face.max() <= 0
    assert face.max() > -0.02
    assert np.isneginf(face[0, 0])


@pytest.mark.parametrize(
    ("shape", "at", "height"),
    [
        (Cylinder(2, 5), (2.0, 1.2), 1.6 - 2),
        (BoxEdge(6, 90), (1.0, -0.7), -0.7),
        (BoxEdge(6, 120), (1.0, 0.7), -0.7 / np.tan(np.pi / 3)),
        (Pyramid(4, 90), (0.3, -1.1), -1.1),
        (Cone(4, 90), (0.6, 0.8), -1.0),
        (Torus(2, 0.5), (1.2, 1.2), np.sqrt(0.25 - (1.2 * np.sqrt(2) - 2) ** 2) - 0.5),
        (Punch(3, 1), (1.4, 0.4), 0.0),
        (Punch(3, 1), (0.4, 1.4), -np.inf),
    ],
)
def test_faces_are_what_their_geometry_says(shape, at, height):
    assert shape.face_mm(np.array([[at[0]]]), np.array([[at[1]]]))[0, 0] == pytest.approx(height)
