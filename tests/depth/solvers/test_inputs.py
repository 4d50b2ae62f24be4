"""What solvers are given: weights per pixel, per edge, or as a stack; test_integrate has the wrong ones."""

from __future__ import annotations

import numpy as np

from gelform.depth.solvers.inputs import check_weights


def test_weights_come_per_pixel_per_edge_or_as_a_stack():
    assert check_weights(np.ones((4, 5)), (4, 5)).dtype == np.float32
    assert check_weights(np.ones((3, 4, 5)), (3, 4, 5)).shape == (3, 4, 5)
    wx, wy = check_weights([np.ones((4, 4)), np.ones((3, 5))], (4, 5))
    assert (wx.shape, wy.shape) == ((4, 4), (3, 5))
    wx, wy = check_weights((np.ones((4, 0)), np.ones((3, 1))), (4, 1))
    assert wx.size == 0
