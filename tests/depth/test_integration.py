"""What is reported of a solution."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth import integrate
from scenes import BUMP, MM_PER_PX, scene


def test_report_of_a_true_surface():
    _, gradients, pitch = scene(BUMP)
    solution = integrate(gradients, mm_per_px=pitch)
    assert solution.solver == "dct"
    assert solution.iterations == 0
    assert solution.islands == 1
    assert solution.known.all()
    assert solution.residual < 1e-3
    assert solution.curl_rms < 1e-3


def test_residual_and_curl_show_slopes_that_no_surface_has():
    rotation = np.zeros((40, 50, 2))
    rotation[..., 0], rotation[..., 1] = np.mgrid[:40, :50] * 0.01 * np.array([1, -1])[:, None, None]
    solution = integrate(rotation, mm_per_px=MM_PER_PX)
    assert solution.curl_rms == pytest.approx(0.02, rel=1e-4)
    assert solution.residual > 0.05


def test_islands_are_counted_by_what_is_known():
    weights = np.ones((12, 15))
    weights[:, 7] = 0
    weights[6, :] = 0
    solution = integrate(np.full((12, 15, 2), 0.1), mm_per_px=0.1, weights=weights)
    assert solution.islands == 4
    assert not solution.known[6].any()
