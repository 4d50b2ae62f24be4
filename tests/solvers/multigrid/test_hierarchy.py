"""The multigrid hierarchy: coarse operators are P^T A P, the V-cycle is symmetric, few iterations suffice."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.solvers import MultigridSolver
from gelform.solvers.multigrid.conjugate import solve
from gelform.solvers.multigrid.cycle import (
    ANCHOR,
    ANSWER,
    DEPTH,
    DOWN,
    EAST,
    FROM_NE,
    FROM_NW,
    FROM_SE,
    FROM_SW,
    LEFT,
    RIGHT,
    RIGHT_SIDE,
    SEARCH,
    SOUTH,
    SOUTHEAST,
    SOUTHWEST,
    UP,
)
from gelform.solvers.multigrid.solver import Hierarchy
from gelform.solvers.system import problem_from_gradients
from scenes import PEAKS, scene, with_noise

SHAPES = [(11, 13), (12, 9), (1, 90), (8, 200)]


def built(shape, anchored, seed=1):
    rng = np.random.default_rng(seed)
    hierarchy = Hierarchy(shape)
    weights = 10 ** rng.uniform(-2, 0, shape)
    anchor = rng.uniform(size=shape) * (rng.uniform(size=shape) > 0.5) * anchored
    hierarchy.load(
        problem_from_gradients(np.zeros((*shape, 2), np.float32), weights, None, anchor), (0.1, 0.13)
    )
    return hierarchy


def planes(hierarchy, level):
    top, height, width = hierarchy.levels[level]
    return hierarchy.data[:, top + 1 : top + 1 + height, 1 : 1 + width].astype(np.float64), (height, width)


def operator(hierarchy, level):
    """The operator of a level as a dense matrix."""
    plane, (height, width) = planes(hierarchy, level)
    matrix = np.diag(plane[ANCHOR].ravel())
    index = np.arange(height * width).reshape(height, width)
    for name, (down, right) in {EAST: (0, 1), SOUTH: (1, 0), SOUTHEAST: (1, 1), SOUTHWEST: (1, -1)}.items():
        if level == 0 and name in (SOUTHEAST, SOUTHWEST):
            continue
        for i, j in np.ndindex(height, width):
            if i + down < height and 0 <= j + right < width:
                a, b, c = index[i, j], index[i + down, j + right], plane[name, i, j]
                matrix[[a, b], [a, b]] += c
                matrix[[a, b], [b, a]] -= c
            else:
                assert plane[name, i, j] == 0
    return matrix


def interpolation(hierarchy, level):
    """P, from the next coarser level to this one, as a dense matrix."""
    _, fine = planes(hierarchy, level)
    plane, coarse = planes(hierarchy, level + 1)
    parts = {
        (0, 0): [(0, 0, None)],
        (0, 1): [(0, 0, LEFT), (0, 1, RIGHT)],
        (1, 0): [(0, 0, UP), (1, 0, DOWN)],
        (1, 1): [(0, 0, FROM_NW), (0, 1, FROM_NE), (1, 0, FROM_SW), (1, 1, FROM_SE)],
    }
    matrix = np.zeros((*fine, *coarse))
    for i, j in np.ndindex(fine):
        for down, right, name in parts[i % 2, j % 2]:
            weight = 1 if name is None else plane[name, i // 2, j // 2]
            if i // 2 + down < coarse[0] and j // 2 + right < coarse[1]:
                matrix[i, j, i // 2 + down, j // 2 + right] = weight
            else:
                assert weight == 0
    return matrix.reshape(fine[0] * fine[1], -1)


@pytest.mark.parametrize("anchored", [0.0, 1.0])
@pytest.mark.parametrize("shape", SHAPES)
def test_coarse_operators_are_galerkin(shape, anchored):
    hierarchy = built(shape, anchored)
    assert len(hierarchy.levels) > 1
    for level in range(len(hierarchy.levels) - 1):
        a, p = operator(hierarchy, level), interpolation(hierarchy, level)
        assert operator(hierarchy, level + 1) == pytest.approx(p.T @ a @ p, abs=2e-5 * np.abs(a).max())


@pytest.mark.parametrize("shape", SHAPES)
def test_without_an_anchor_constants_stay_constants_exactly(shape):
    hierarchy = built(shape, 0.0)
    for level in range(len(hierarchy.levels) - 1):
        assert np.array_equal(
            planes(hierarchy, level + 1)[0][ANCHOR], np.zeros(planes(hierarchy, level + 1)[1])
        )
        assert interpolation(hierarchy, level).sum(axis=1) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("anchored", [0.0, 0.2])
@pytest.mark.parametrize("shape", [(11, 13), (7, 16)])
def test_cycle_is_symmetric_and_nearly_the_inverse(shape, anchored):
    hierarchy = built(shape, anchored)
    count = shape[0] * shape[1]
    frame = np.s_[1 : shape[0] + 1, 1 : shape[1] + 1]
    columns = []
    for k in range(count):
        hierarchy.data[DEPTH : SEARCH + 1, : shape[0] + 3] = 0
        hierarchy.data[RIGHT_SIDE][frame] = np.eye(count)[k].reshape(shape)
        solve(hierarchy.data, hierarchy.levels, hierarchy.dense, *hierarchy.scratch, 0.0, 1e-4, 0)
        columns.append(hierarchy.data[ANSWER][frame].ravel().astype(np.float64))
    cycle = np.array(columns)
    assert cycle == pytest.approx(cycle.T, abs=1e-4 * np.abs(cycle).max())
    values = np.sort(np.linalg.eigvals(cycle @ operator(hierarchy, 0)).real)[0 if anchored else 1 :]
    assert values.min() > 0.15
    assert values.max() < 1.6


@pytest.mark.parametrize(("anchor", "most"), [(None, 7), (1e-2, 12)])
@pytest.mark.parametrize("shape", [(60, 80), (113, 150)])
def test_few_iterations_suffice_at_jumps_by_a_thousand(shape, anchor, most):
    _, gradients, pitch = scene(PEAKS, shape, 20 / shape[1])
    gradients = with_noise(gradients, 0.05, np.random.default_rng(2)).astype(np.float32)
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    weights = np.where(np.hypot(rows % 23 - 11, cols % 29 - 14) < 7, 1e-3, 1.0)
    anchors = None if anchor is None else np.full(shape, anchor, dtype=np.float32)
    assert MultigridSolver(shape, pitch)(gradients, weights, None, anchors).iterations <= most
