"""One frame's slopes to depth: what the solver is given, and where its standard deviation is computed."""

import numpy as np
import pytest

from gelform.depth.anchor import RestAnchor
from gelform.depth.frame import FrameDepth
from gelform.depth.integrate import integrate

SHAPE, PITCH, SIGMA = (40, 50), 0.05, 0.04
CORRELATION = {
    "correlation_px": 8.0,
    "correlated_share": 0.5,
    "rest_correlation_px": 2.0,
    "rest_correlated_share": 0.3,
}


@pytest.fixture
def frame():
    """Slopes of a bump with noise, their sigma and confidence, and the pixels at rest."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([20, 25])[:, None, None]
    depth = 0.3 * np.exp(-(x**2 + y**2) / 60)
    slopes = np.stack(np.gradient(depth, PITCH)[::-1], axis=-1) + rng.normal(0, 0.02, (*SHAPE, 2))
    confidence = rng.uniform(0.2, 1, SHAPE).astype(np.float32)
    sigma = np.broadcast_to((SIGMA / np.sqrt(confidence))[..., None], (*SHAPE, 2))
    return slopes.astype(np.float32), sigma, confidence, x**2 + y**2 > 200


def test_a_solver_with_weights_gets_confidence_and_anchor(frame):
    slopes, sigma, confidence, at_rest = frame
    depth = FrameDepth(SHAPE, PITCH, "multigrid", SIGMA, correlation=None, gain_sigma=0.0)
    solution, none, difference = depth(slopes, sigma, confidence, at_rest, lambda work: work)
    anchor = RestAnchor(SHAPE, PITCH, SIGMA)(slopes, at_rest)
    wanted = integrate(slopes, mm_per_px=PITCH, solver="multigrid", weights=confidence, anchor=anchor)
    np.testing.assert_array_equal(solution.depth_mm, wanted.depth_mm)
    assert none is None
    assert difference is None


def test_a_solver_of_equal_slopes_gets_the_zero_alone(frame):
    slopes, _, confidence, at_rest = frame
    depth = FrameDepth(SHAPE, PITCH, "dct", SIGMA, correlation=None, gain_sigma=0.0)
    solution, _, _ = depth(slopes, None, confidence, at_rest, lambda work: work)
    wanted = integrate(slopes, mm_per_px=PITCH, solver="dct", zero=at_rest)
    np.testing.assert_array_equal(solution.depth_mm, wanted.depth_mm)


def test_the_deviation_is_the_helpers_work(frame):
    begun = []

    def start(work):
        begun.append(work)
        return work

    depth = FrameDepth(SHAPE, PITCH, "multigrid", SIGMA, correlation=CORRELATION, gain_sigma=0.02)
    slopes, sigma, confidence, at_rest = frame
    solution, deviation, difference = depth(slopes, sigma, confidence, at_rest, start)
    assert len(begun) == 1
    np.testing.assert_array_equal(deviation, begun[0]())
    assert (deviation > 0).all()
    assert (difference(at_rest) >= 0).all()
    twice = FrameDepth(SHAPE, PITCH, "multigrid", SIGMA, correlation=CORRELATION, gain_sigma=0.02)
    _, doubled, _ = twice(slopes, 2 * sigma, confidence, at_rest, start)
    np.testing.assert_allclose(doubled, 2 * deviation, rtol=1e-5)
    assert solution.depth_mm[20, 25] > 0.2
