"""Neighbours predict a linear motion exactly, and tell a dot that moves otherwise."""

import numpy as np
import pytest

from gelform.markers.neighbours import Neighbours
from made.dots import grid

REST = grid()
LINEAR = REST @ np.array([[0.02, -0.01], [0.03, 0.01]]) + [4.0, -3.0]
ALL = np.ones(len(REST), dtype=bool)


def test_spacing():
    assert Neighbours(REST).spacing_px == 16


def test_linear_motion_is_predicted():
    sure = ALL.copy()
    sure[[10, 11, 25]] = False
    predicted = Neighbours(REST).predicted_px(LINEAR * sure[:, None], sure, ~sure)
    assert np.abs(predicted - LINEAR[~sure]).max() < 0.15


def test_one_sure_dot_predicts_its_own_motion():
    sure = ~ALL
    sure[12] = True
    predicted = Neighbours(REST).predicted_px(LINEAR, sure, ~sure)
    np.testing.assert_allclose(predicted, np.broadcast_to(LINEAR[12], predicted.shape), atol=1e-9)


def test_a_dot_that_moves_otherwise_is_astray():
    moved = LINEAR.copy()
    moved[18] += [16, 0]
    astray = Neighbours(REST).astray_px(moved, ALL)
    assert astray[18] == pytest.approx(16, abs=0.5)
    assert np.delete(astray, 18).max() < 1.5


def test_no_sure_neighbour_no_opinion():
    sure = ~ALL
    sure[0] = True
    assert Neighbours(REST).astray_px(LINEAR, sure)[0] == 0
