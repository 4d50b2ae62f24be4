"""The integrators that gelform does not use: exact where their assumption holds, wrong as documented where not."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth.integrate import depth_from_gradients
from naive_integrators import depth_along_lines, depth_periodic, depth_zero_border
from scenes import BALLS, PLANE, QUADRATIC, polynomial, rmse_um, scene, waves

PITCHES = [(0.0634, 0.0634), (0.05, 0.08)]


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (8, 1), (2, 3), (31, 24)])
def test_lines_are_exact_on_quadratics(shape, pitch):
    truth, gradients, _ = scene(QUADRATIC, shape, pitch)
    assert depth_along_lines(gradients, pitch) == pytest.approx(truth - truth.mean(), abs=1e-6)


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(3, 3), (3, 9), (24, 31)])
def test_zero_border_is_exact_on_a_parabolic_cap_over_the_frame(shape, pitch):
    """z = (a^2 - x^2)(b^2 - y^2) is 0 on the border and quadratic along rows and columns."""
    a, b = (shape[1] - 1) / 2 * pitch[0], (shape[0] - 1) / 2 * pitch[1]
    cap = polynomial({(0, 0): a**2 * b**2, (2, 0): -(b**2), (0, 2): -(a**2), (2, 2): 1.0})
    truth, gradients, _ = scene(cap, shape, pitch)
    assert depth_zero_border(gradients, pitch) == pytest.approx(truth, abs=2e-6 * np.ptp(truth))


@pytest.mark.parametrize("shape", [(1, 5), (2, 7), (5, 1)])
def test_zero_border_of_a_frame_that_is_all_border_is_zero(shape):
    assert np.array_equal(depth_zero_border(np.ones((*shape, 2)), (0.1, 0.1)), np.zeros(shape))


@pytest.mark.parametrize("shape", [(24, 48), (25, 45), (1, 24)])
def test_periodic_is_exact_on_periodic_waves(shape):
    pitch = 2.4 / shape[1], 1.2 / shape[0]
    truth, gradients, _ = scene(waves(0.02, 0.6), shape, pitch)
    assert depth_periodic(gradients, pitch) == pytest.approx(truth - truth.mean(), abs=1e-6)


def test_assumptions_fail_where_the_border_cuts_a_contact():
    truth, gradients, pitch = scene(BALLS)
    assert rmse_um(depth_from_gradients(gradients, mm_per_px=pitch), truth) < 1.25
    assert rmse_um(depth_periodic(gradients, pitch), truth) > 40
    assert rmse_um(depth_zero_border(gradients, pitch), truth) > 40


def test_periodic_and_zero_border_lose_a_tilt():
    truth, gradients, pitch = scene(PLANE)
    for integrate in (depth_periodic, depth_zero_border):
        assert np.ptp(integrate(gradients, pitch)) < 0.3 * np.ptp(truth)
    depth = depth_from_gradients(gradients, mm_per_px=pitch)
    assert np.ptp(depth) == pytest.approx(np.ptp(truth), rel=1e-4)
