"""One frame's slopes to depth: what the solver is given."""

import numpy as np
import pytest

from gelform.depth.anchor import RestAnchor
from gelform.depth.frame import FrameDepth
from gelform.depth.integrate import integrate
from gelform.slopes.confidence import ReadSlopes

SHAPE, PITCH, SIGMA = (40, 50), 0.05, 0.04


@pytest.fixture
def slopes():
    """Of a bump with noise; some are outliers, and some are not seen."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([20, 25])[:, None, None]
    depth = 0.3 * np.exp(-(x**2 + y**2) / 60)
    read = np.stack(np.gradient(depth, PITCH)[::-1], axis=-1) + rng.normal(0, 0.02, (*SHAPE, 2))
    residual = rng.exponential(3, SHAPE).astype(np.float32)
    return ReadSlopes(
        read.astype(np.float32), x**2 + y**2 > 200, unseen=rng.uniform(size=SHAPE) > 0.95, residual=residual
    )


def test_a_solver_with_weights_gets_them_and_the_anchor(slopes):
    weights, anchor = slopes.weights(SIGMA), RestAnchor(SHAPE, PITCH, SIGMA)(slopes.gradients, slopes.at_rest)
    assert 0 < np.count_nonzero(weights < 0.5) < weights.size / 2
    wanted = integrate(slopes.gradients, mm_per_px=PITCH, solver="multigrid", weights=weights, anchor=anchor)
    found = FrameDepth(SHAPE, PITCH, "multigrid", SIGMA)(slopes)
    np.testing.assert_array_equal(found.depth_mm, wanted.depth_mm)


def test_a_solver_of_equal_slopes_gets_the_zero_alone(slopes):
    wanted = integrate(slopes.gradients, mm_per_px=PITCH, solver="dct", zero=slopes.at_rest)
    np.testing.assert_array_equal(FrameDepth(SHAPE, PITCH, "dct", SIGMA)(slopes).depth_mm, wanted.depth_mm)
