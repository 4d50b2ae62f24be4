"""What solvers are given: shapes and ranges are refused at the door, in words that say what to do."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth.solvers.inputs import check_anchor, check_weights, checked_solver, takes_weights


def test_weights_come_per_pixel_per_edge_or_as_a_stack():
    assert check_weights(np.ones((4, 5)), (4, 5)).dtype == np.float32
    assert check_weights(np.ones((3, 4, 5)), (3, 4, 5)).shape == (3, 4, 5)
    wx, wy = check_weights([np.ones((4, 4)), np.ones((3, 5))], (4, 5))
    assert (wx.shape, wy.shape) == ((4, 4), (3, 5))
    wx, wy = check_weights((np.ones((4, 0)), np.ones((3, 1))), (4, 1))
    assert wx.size == 0


def test_an_anchor_may_be_a_number():
    assert np.array_equal(check_anchor(0.25, (2, 3)), np.full((2, 3), 0.25, np.float32))
    with pytest.raises(ValueError, match="anchor >= 0"):
        check_anchor(-1.0, (2, 3))


def test_solvers_are_known_by_name():
    assert checked_solver("auto") == "auto"
    assert takes_weights("auto")
    assert not takes_weights("dct")
    with pytest.raises(ValueError, match=r"a solver among auto, dct, .*, got 'dst'"):
        checked_solver("dst")
