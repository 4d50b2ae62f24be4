"""What every solver owes: agreement where all are right, one call shape, a place in the guide."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from gelform.depth import depth_from_gradients
from gelform.solvers import SOLVERS, Solution
from gelform.solvers.inputs import takes_weights
from scenes import gaussian, scene


@pytest.mark.parametrize("solver", SOLVERS)
def test_all_agree_on_a_bump_that_fades_before_the_border(solver):
    truth, gradients, pitch = scene(gaussian(1.0, 1.0), (160, 200), (0.06, 0.05))
    depth = depth_from_gradients(gradients, mm_per_px=pitch, solver=solver)
    depth = depth - depth.mean()
    assert np.max(np.abs(depth - (truth - truth.mean()))) < 1e-3 * np.ptp(truth)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_frame_gives_a_solution(solver):
    gradients = scene(gaussian(0.1, 0.2), (9, 12), (0.05, 0.08)).gradients.astype(np.float32)
    solution = SOLVERS[solver]((9, 12), (0.05, 0.08))(gradients)
    assert isinstance(solution, Solution)
    assert solution.depth_mm.shape == solution.known.shape == (9, 12)
    assert solution.depth_mm.dtype == np.float32
    assert solution.known.all()


@pytest.mark.parametrize("solver", SOLVERS)
def test_says_whether_it_takes_weights(solver):
    gradients = np.random.default_rng(0).normal(0, 0.1, (9, 12, 2))
    weights = np.linspace(0.1, 1, 108).reshape(9, 12)
    if takes_weights(solver):
        weighted = depth_from_gradients(gradients, mm_per_px=0.1, weights=weights, solver=solver)
        assert not np.allclose(weighted, depth_from_gradients(gradients, mm_per_px=0.1, solver=solver))
    else:
        with pytest.raises(ValueError, match="Expected no weights"):
            depth_from_gradients(gradients, mm_per_px=0.1, weights=weights, solver=solver)


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_guide_says_when_to_take_it(solver):
    guide = Path(__file__).parents[2] / "docs" / "choosing-a-solver.md"
    assert f"`{solver}`" in guide.read_text()
