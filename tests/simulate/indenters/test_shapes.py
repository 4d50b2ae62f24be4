"""Faces against their geometry."""

import re

import numpy as np
import pytest

from gelform.simulate import Ball, BoxEdge, Coin, Cone, Cylinder, Punch, Pyramid, Screw, Torus, text_relief
from made.faces import X, Y

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


REFUSED = [
    (lambda: Cone(4, 180), "angle_deg in 0-180"),
    (lambda: Cylinder(6000, 1), "another unit"),
    (lambda: text_relief("  ", height_mm=2), "printable ASCII"),
    (lambda: text_relief("gél", height_mm=2), "printable ASCII"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
