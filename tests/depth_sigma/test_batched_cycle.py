"""Many right sides at once: each as the V-cycle for one solves it."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth_sigma.batched_cycle import solve_lanes
from gelform.depth_sigma.probes import Hierarchy
from gelform.solvers import SparseSolver
from gelform.solvers.multigrid.cycle import RIGHT_SIDE
from gelform.solvers.system import load_right_side, problem_from_gradients


def loaded(shape, anchored, lanes=3, seed=1):
    """A hierarchy, gradients (lanes, H, W, 2) and their right sides, (rows, columns, lanes)."""
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.3, 1, shape)
    anchor = (rng.uniform(size=shape) > 0.5) * 0.1 if anchored else None
    gradients = rng.standard_normal((lanes, *shape, 2)).astype(np.float32)
    hierarchy = Hierarchy(shape)
    problem = problem_from_gradients(gradients[0], weights, None, anchor)
    hierarchy.load(problem, (0.1, 0.13))
    right = np.zeros((*hierarchy.data.shape[1:], lanes), dtype=np.float32)
    for lane, slopes in enumerate(gradients):
        load_right_side(hierarchy.data, slopes, (0.1, 0.13))
        right[1 : shape[0] + 1, 1 : shape[1] + 1, lane] = hierarchy.data[RIGHT_SIDE][
            1 : shape[0] + 1, 1 : shape[1] + 1
        ]
    return hierarchy, gradients, right, weights, anchor


@pytest.mark.parametrize("anchored", [False, True])
@pytest.mark.parametrize("shape", [(3, 4), (1, 90), (23, 31), (40, 54)])
def test_depths_are_those_of_elimination_to_some_percent(shape, anchored):
    hierarchy, gradients, right, weights, anchor = loaded(shape, anchored)
    depths = np.empty((*shape, 3), dtype=np.float32)
    work = np.zeros_like(right), np.zeros_like(right)
    solve_lanes(hierarchy.data, hierarchy.levels, hierarchy.dense, right, *work, depths)
    for lane in range(3):
        exact = SparseSolver(shape, (0.1, 0.13))(gradients[lane], weights, None, anchor).depth_mm
        off = depths[..., lane] - exact
        off -= 0 if anchored else off.mean()
        assert np.sqrt(np.mean(off**2)) < 0.08 * np.std(exact)


def test_a_lane_does_not_see_the_others():
    hierarchy, _, right, _, _ = loaded((23, 31), True)
    together, alone = np.empty((23, 31, 3), dtype=np.float32), np.empty((23, 31, 1), dtype=np.float32)
    one = np.ascontiguousarray(right[..., 1:2])
    for r, depths in ((right.copy(), together), (one, alone)):
        work = np.zeros_like(r), np.zeros_like(r)
        solve_lanes(hierarchy.data, hierarchy.levels, hierarchy.dense, r, *work, depths)
    assert together[..., 1] == pytest.approx(alone[..., 0], abs=1e-5 * float(np.abs(alone).max()))
