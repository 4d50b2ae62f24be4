"""Meshes as indenters."""

import re

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Mesh, Punch, simulate_press
from made.faces import X, Y, box

OPEN = box(1, 1, 1)[0], box(1, 1, 1)[1][:-1]


def test_a_mesh_of_a_box_is_a_punch():
    mesh = Mesh(*box(3.0, 1.0, 5.0))
    there = np.isfinite(mesh.face_mm(X, Y))
    np.testing.assert_array_equal(there, np.isfinite(Punch(3.0, 1.0).face_mm(X, Y)))
    assert np.abs(mesh.face_mm(X, Y)[there]).max() < 1e-12


def test_a_mesh_can_be_pressed():
    press = simulate_press(LAYOUTS["ring-120"], Mesh(*box(4, 2, 3)), depth_mm=0.4, rng=None, oversample=1)
    assert press.depth_mm.max() == pytest.approx(0.4)
    assert press.contact.sum() * 0.0634**2 == pytest.approx(8, rel=0.05)


REFUSED = [
    (lambda: Mesh(*OPEN), "3 edges that border only one triangle"),
    (lambda: Mesh(np.zeros((4, 3)), np.zeros((0, 3), dtype=int)), "an empty one"),
    (lambda: Mesh(box(1, 1, 1)[0] * 100000.0, box(1, 1, 1)[1]), "another unit"),
    (lambda: Mesh(box(1, 1, 1)[0] * 0.001, box(1, 1, 1)[1]), "metres x 1000"),
    (lambda: Mesh(box(1, 1, 1)[0], box(1, 1, 1)[1] + 5), "indices in 0-7"),
    (lambda: Mesh(box(1, 1, 1)[0] * np.nan, box(1, 1, 1)[1]), "finite vertices_mm"),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
