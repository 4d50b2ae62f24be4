"""The grid in C: coarse operators are P^T A P, the V-cycle is symmetric, few iterations suffice, no state is left."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform._native import Kernel
from gelform.depth import depth_from_gradients, integrate
from gelform.errors import ConvergenceError
from gelform.solvers import SOLVERS, MultigridSolver, SparseSolver
from gelform.solvers import multigrid as native
from gelform.solvers.multigrid import Grid
from gelform.solvers.system import differences, edge_system, edges_from_gradients, problem_from_gradients
from kernel_agreement import usable_isas
from scenes import PEAKS, confidence_from_valid, polynomial, scene, with_noise, with_outliers, with_patches

GRID_SHAPES = [(11, 13), (12, 9), (10, 16), (1, 90), (8, 200)]
PITCH = (0.1, 0.13)
# Planes of a level, in the order of struct level; then the weights of interpolation.
EAST, SOUTH, SOUTHEAST, SOUTHWEST, ANCHOR, INVERSE, RIGHT_SIDE, ANSWER = range(8)
LEFT, RIGHT, UP, DOWN, FROM_NW, FROM_NE, FROM_SW, FROM_SE = range(8, 16)
_plane = Kernel("multigrid_plane", "multigrid* grid, i32 level, i32 plane, out f32[h,w] values")


def sizes(shape):
    """Sizes of the levels: the finest has an odd height and width, the coarsest 40 pixels at most."""
    levels = [tuple(n + 1 - n % 2 for n in shape)]
    while levels[-1][0] * levels[-1][1] > 40:
        levels.append(tuple((n + 1) // 2 for n in levels[-1]))
    return levels


def plane(grid, level, name):
    values = np.empty(sizes(grid.shape)[level], dtype=np.float32)
    _plane(grid.handle, level, name, values)
    return values.astype(np.float64)


def some_problem(shape, anchored, seed=1):
    rng = np.random.default_rng(seed)
    anchor = rng.uniform(size=shape) * (rng.uniform(size=shape) > 0.5) * anchored
    return problem_from_gradients(
        rng.standard_normal((*shape, 2)), 10 ** rng.uniform(-2, 0, shape), None, anchor
    )


def built(shape, anchored):
    grid = Grid(shape)
    grid.load(some_problem(shape, anchored), PITCH)
    return grid


def matrix_of(east, south, anchor, southeast=None, southwest=None):
    """An operator of couplings and anchor as a dense matrix."""
    height, width = anchor.shape
    matrix = np.diag(anchor.ravel())
    index = np.arange(height * width).reshape(height, width)
    diagonals = [] if southeast is None else [(southeast, 1, 1), (southwest, 1, -1)]
    for couplings, down, right in [(east, 0, 1), (south, 1, 0), *diagonals]:
        for i, j in np.ndindex(height, width):
            if i + down < height and 0 <= j + right < width:
                a, b, c = index[i, j], index[i + down, j + right], couplings[i, j]
                matrix[[a, b], [a, b]] += c
                matrix[[a, b], [b, a]] -= c
            else:
                assert couplings[i, j] == 0
    return matrix


def operator(grid, level):
    names = (EAST, SOUTH, ANCHOR) if level == 0 else (EAST, SOUTH, ANCHOR, SOUTHEAST, SOUTHWEST)
    return matrix_of(*(plane(grid, level, name) for name in names))


def interpolation(grid, level):
    """P, from the next coarser level to this one, as a dense matrix."""
    fine, coarse = sizes(grid.shape)[level : level + 2]
    parts = {
        (0, 0): [(0, 0, None)],
        (0, 1): [(0, 0, LEFT), (0, 1, RIGHT)],
        (1, 0): [(0, 0, UP), (1, 0, DOWN)],
        (1, 1): [(0, 0, FROM_NW), (0, 1, FROM_NE), (1, 0, FROM_SW), (1, 1, FROM_SE)],
    }
    weights = {name: plane(grid, level + 1, name) for name in range(LEFT, FROM_SE + 1)}
    matrix = np.zeros((*fine, *coarse))
    for i, j in np.ndindex(fine):
        for down, right, name in parts[i % 2, j % 2]:
            weight = 1 if name is None else weights[name][i // 2, j // 2]
            if i // 2 + down < coarse[0] and j // 2 + right < coarse[1]:
                matrix[i, j, i // 2 + down, j // 2 + right] = weight
            else:
                assert weight == 0
    return matrix.reshape(fine[0] * fine[1], -1)


def frame_operator(problem):
    """The frame's operator, by numpy alone."""
    east, south, _ = edge_system(problem, PITCH)
    return matrix_of(
        np.pad(east, ((0, 0), (0, 1))), np.pad(south, ((0, 1), (0, 0))), problem.anchor.astype(float)
    )


@pytest.mark.parametrize("anchored", [0.0, 1.0])
@pytest.mark.parametrize("shape", GRID_SHAPES)
def test_the_finest_level_is_the_frame(shape, anchored):
    """Pixels that were put in between are eliminated exactly: what is left is the frame's own operator."""
    grid, problem = built(shape, anchored), some_problem(shape, anchored)
    whole, own = operator(grid, 0), np.zeros(sizes(shape)[0], dtype=bool)
    rows, cols = (np.r_[0 : n - 1, n - n % 2] for n in shape)
    own[np.ix_(rows, cols)] = True
    own = own.ravel()
    inner = np.linalg.pinv(whole[~own][:, ~own])
    left = whole[own][:, own] - whole[own][:, ~own] @ inner @ whole[~own][:, own]
    # Not pytest.approx, which takes half a minute for a million elements.
    np.testing.assert_allclose(left, frame_operator(problem), rtol=0, atol=1e-5 * np.abs(whole).max())
    diagonal = np.diag(whole).reshape(sizes(shape)[0])
    assert plane(grid, 0, INVERSE) * diagonal == pytest.approx((diagonal > 0) * 1.0, abs=1e-5)
    right = plane(grid, 0, RIGHT_SIDE).ravel()
    assert right[own] == pytest.approx(edge_system(problem, PITCH)[2].ravel(), abs=1e-5)
    assert not right[~own].any()


@pytest.mark.parametrize("anchored", [0.0, 1.0])
@pytest.mark.parametrize("shape", GRID_SHAPES)
def test_coarse_operators_are_galerkin(shape, anchored):
    grid = built(shape, anchored)
    assert len(sizes(shape)) > 1
    for level in range(len(sizes(shape)) - 1):
        a, p = operator(grid, level), interpolation(grid, level)
        np.testing.assert_allclose(
            operator(grid, level + 1), p.T @ a @ p, rtol=0, atol=2e-5 * np.abs(a).max()
        )


@pytest.mark.parametrize("shape", GRID_SHAPES)
def test_without_an_anchor_constants_stay_constants_exactly(shape):
    grid = built(shape, 0.0)
    for level in range(len(sizes(shape)) - 1):
        assert not plane(grid, level + 1, ANCHOR).any()
        tied = np.diag(operator(grid, level)) > 0
        assert interpolation(grid, level).sum(axis=1)[tied] == pytest.approx(1, abs=1e-6)


def test_an_anchor_does_not_hold_pixels_that_others_hold_firmly():
    """A pixel of a narrow column, tied firmly to those above and below it: its anchor is a small share of that."""
    east, south, anchor = np.full((9, 8), 2e-3), np.ones((8, 9)), np.full((9, 9), 1e-2)
    grid = Grid((9, 9))
    grid.load_edges(*(a.astype(np.float32) for a in (east, south, np.zeros((9, 9)), anchor)))
    assert interpolation(grid, 0).sum(axis=1).min() > 0.98


def cycle_matrix(shape, problem, isa):
    """What one V-cycle answers to each unit right side, in the frame's pixels."""
    east, south, _ = edge_system(problem, PITCH)
    grid, solve = Grid(shape), native._solve.on(isa)
    columns = []
    for k in range(shape[0] * shape[1]):
        right = np.eye(shape[0] * shape[1])[k].reshape(shape)
        grid.load_edges(*(np.ascontiguousarray(a, np.float32) for a in (east, south, right, problem.anchor)))
        depth = np.empty(shape, dtype=np.float32)
        solve(grid.handle, None, depth, 0.0, 1e-4, 0, np.empty(2))
        columns.append(depth.ravel().astype(np.float64))
    return np.array(columns)


def assert_symmetric_and_nearly_the_inverse(cycle, matrix, anchored, least):
    assert cycle == pytest.approx(cycle.T, abs=1e-4 * np.abs(cycle).max())
    values = np.sort(np.linalg.eigvals(cycle @ matrix).real)[0 if anchored else 1 :]
    assert values.min() > least
    assert values.max() < 1.6


@pytest.mark.parametrize("anchored", [0.0, 0.2])
@pytest.mark.parametrize("shape", [(11, 13), (8, 16)])
def test_cycle_is_symmetric_and_nearly_the_inverse(shape, anchored, usable_isa):
    problem = some_problem(shape, anchored)
    cycle = cycle_matrix(shape, problem, usable_isa)
    assert_symmetric_and_nearly_the_inverse(cycle, frame_operator(problem), anchored, 0.15)


# Trusted pixels among others, in a shape that no regular coarse grid can move without bending it.
ISLAND = """
.........
.######..
.#oooo#..
.#o##o##.
.##o##oo#
..##.###.
.........
"""


@pytest.mark.parametrize("anchored", [0.0, 1e-4])
def test_cycle_with_an_island_is_symmetric_too(anchored, usable_isa):
    weights = np.array([[1e-3 if c == "#" else 1.0 for c in line] for line in ISLAND.split()])
    problem = problem_from_gradients(np.zeros((7, 9, 2)), weights, None, np.full((7, 9), anchored))
    cycle = cycle_matrix((7, 9), problem, usable_isa)
    assert_symmetric_and_nearly_the_inverse(cycle, frame_operator(problem), anchored, 0.15)


@pytest.mark.parametrize("anchor", [None, 1e-2])
@pytest.mark.parametrize("shape", [(60, 80), (113, 150)])
def test_few_iterations_suffice_at_jumps_by_a_thousand(shape, anchor):
    _, gradients, pitch = scene(PEAKS, shape, 20 / shape[1])
    gradients = with_noise(gradients, 0.05, np.random.default_rng(2)).astype(np.float32)
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    weights = np.where(np.hypot(rows % 23 - 11, cols % 29 - 14) < 7, 1e-3, 1.0)
    anchors = None if anchor is None else np.full(shape, anchor, dtype=np.float32)
    assert MultigridSolver(shape, pitch)(gradients, weights, None, anchors).iterations <= 5


def outliers(shape, corrupt):
    """A frame of the benchmark: 10 % of the slopes are wrong, and weights know it."""
    sample, rng = scene(PEAKS, shape, 15.2 / shape[0]), np.random.default_rng(0)
    wrong = corrupt(with_noise(sample.gradients, 0.05, rng), 0.1, rng)
    weights = confidence_from_valid(wrong.valid, low=1.001e-3)
    return wrong.gradients, weights, sample.mm_per_px, np.where(sample.depth_mm < 0.05, 1e-2, 0)


@pytest.mark.slow
@pytest.mark.parametrize("corrupt", [with_outliers, with_patches])
@pytest.mark.parametrize("anchored", [False, True])
def test_no_local_mode_is_left_at_480x640(corrupt, anchored):
    """Borders without coarse pixels, islands and anchored narrows took 9 and 11 iterations here."""
    gradients, weights, pitch, anchor = outliers((480, 640), corrupt)
    solve = MultigridSolver((480, 640), pitch)
    assert solve(gradients, weights, None, anchor if anchored else None).iterations <= 4


@pytest.mark.parametrize("anchored", [False, True])
def test_past_convergence_rounding_is_not_chased(anchored):
    shape = (60, 80)
    gradients, weights, pitch, anchor = outliers(shape, with_outliers)
    problem = problem_from_gradients(gradients, weights, None, anchor if anchored else None)
    grid, solve = Grid(shape), native._solve
    depths = []
    for limit in (12, 40, 100):
        grid.load(problem, pitch)
        depths.append(np.empty(shape, dtype=np.float32))
        solve(grid.handle, None, depths[-1], 0.0, 1e-30, limit, np.empty(2))
        depths[-1] -= 0 if anchored else depths[-1].mean()
    for depth in depths[1:]:
        assert np.abs(depth - depths[0]).max() < 5e-6 * np.ptp(depths[0])


def test_a_tolerance_beyond_float32_is_refused():
    gradients, weights, pitch, _ = outliers((60, 80), with_outliers)
    with pytest.raises(ConvergenceError, match="below 1e-6, where float32 ends"):
        MultigridSolver((60, 80), pitch, tolerance=1e-12, max_iterations=50)(gradients, weights)


@pytest.mark.parametrize("size", [1e-30, 1e-12, 1e12, 1e25])
def test_depth_is_proportional_to_slopes_of_any_size(size):
    gradients, weights, pitch, anchor = outliers((60, 80), with_outliers)
    solve = MultigridSolver((60, 80), pitch)
    usual = solve(gradients, weights, None, anchor).depth_mm
    scaled = solve((gradients * size).astype(np.float32), weights, None, anchor).depth_mm / size
    assert np.abs(scaled - usual).max() < 1e-5 * np.ptp(usual)


@pytest.mark.parametrize("shape", [(60, 80), (37, 101), (480, 640)])
def test_instruction_sets_give_the_same_bits(shape):
    gradients, weights, pitch, anchor = outliers(shape, with_patches)
    problem = problem_from_gradients(gradients, weights, None, anchor)
    depths = []
    for isa in usable_isas():
        grid, depth = Grid(shape), np.empty(shape, dtype=np.float32)
        native._load.on(isa)(grid.handle, problem.gradients, problem.confidence, problem.anchor, *pitch)
        native._build.on(isa)(grid.handle)
        native._solve.on(isa)(grid.handle, None, depth, 0.0, 4e-4, 100, np.empty(2))
        depths.append(depth)
    assert all(depth.tobytes() == depths[0].tobytes() for depth in depths)


@pytest.mark.slow
def test_agrees_with_elimination_at_full_size():
    gradients, weights, pitch, anchor = outliers((240, 320), with_outliers)
    fast = MultigridSolver((240, 320), pitch)(gradients, weights, None, anchor).depth_mm
    slow = SparseSolver((240, 320), pitch)(gradients, weights, None, anchor).depth_mm
    assert np.abs(fast - slow).max() < 4e-4 * np.ptp(slow)


SMALL_MEMORY = """
import resource
from gelform.solvers.multigrid import Grid

Grid((4, 4))
held = 4096 * int(open("/proc/self/statm").read().split()[0])
resource.setrlimit(resource.RLIMIT_AS, (held + 2**28, held + 2**28))
try:
    Grid((6000, 8000))
except MemoryError as error:
    print(error)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="limits its memory as Linux does")
@pytest.mark.skipif("asan" in os.environ.get("LD_PRELOAD", ""), reason="AddressSanitizer takes what it likes")
def test_an_image_too_large_for_the_memory_is_refused_with_the_figure():
    done = subprocess.run([sys.executable, "-c", SMALL_MEMORY], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("Expected 2.8 GB of free memory for a weighted solution of 6000x8000 px")


WEIGHTED = [name for name, solver in SOLVERS.items() if solver.takes_weights]
SHAPES = [(1, 1), (1, 2), (1, 41), (43, 1), (2, 2), (2, 3), (7, 6), (13, 17), (48, 65), (101, 37)]
PITCHES = [(0.0634, 0.0634), (0.05, 0.08)]
QUADRATIC = polynomial({(1, 0): 0.05, (0, 1): -0.03, (2, 0): 0.02, (1, 1): -0.015, (0, 2): 0.01})
EXACT = ["multigrid", "sparse"]


def centred(depth):
    return depth - depth.mean(dtype=np.float64)


def dense_answer(gradients, wx, wy, anchor, pitch):
    """Minimiser by a dense least-squares solve of the stated energy: one row per edge and per anchor."""
    height, width = gradients.shape[:2]
    unit = np.eye(height * width).reshape(-1, height, width)
    dx, dy = differences(unit, pitch)
    ex, ey = edges_from_gradients(gradients)
    area = np.sqrt(pitch[0] * pitch[1])
    rows = [
        (dx * np.sqrt(wx)).reshape(height * width, -1).T,
        (dy * np.sqrt(wy)).reshape(height * width, -1).T,
        np.diag(np.sqrt(anchor).ravel()) / area,
    ]
    right = [(ex * np.sqrt(wx)).ravel(), (ey * np.sqrt(wy)).ravel(), np.zeros(height * width)]
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0].reshape(height, width)


def harmonic(c):
    pairs = (c[:, 1:], c[:, :-1]), (c[1:], c[:-1])
    return tuple(2 * a * b / (a + b) for a, b in pairs)


@pytest.mark.parametrize("solver", EXACT)
@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("anchored", [False, True])
def test_minimises_the_stated_energy(solver, pitch, anchored):
    rng = np.random.default_rng(1)
    gradients, confidence = rng.standard_normal((9, 11, 2)), 10 ** rng.uniform(-2.5, 0, (9, 11))
    confidence /= confidence.max()
    anchor = 0.3 * rng.uniform(size=(9, 11)) * (rng.uniform(size=(9, 11)) > 0.6) * anchored
    expected = dense_answer(gradients, *harmonic(confidence), anchor, pitch)
    depth = SOLVERS[solver]((9, 11), pitch)(gradients, confidence, None, anchor).depth_mm
    depth, expected = (depth, expected) if anchored else (centred(depth), centred(expected))
    assert np.max(np.abs(depth - expected)) < 5e-4 * np.ptp(expected)


@pytest.mark.parametrize("solver", EXACT)
def test_weights_per_edge_are_taken_as_given(solver):
    rng = np.random.default_rng(2)
    gradients = rng.standard_normal((8, 10, 2))
    wx, wy = rng.uniform(0.01, 1, (8, 9)), rng.uniform(0.01, 1, (7, 10))
    expected = dense_answer(gradients, wx, wy, np.zeros((8, 10)), (0.05, 0.08))
    depth = depth_from_gradients(gradients, mm_per_px=(0.05, 0.08), weights=(wx, wy), solver=solver)
    assert np.max(np.abs(depth - centred(expected))) < 5e-4 * np.ptp(expected)


@pytest.mark.parametrize("solver", WEIGHTED)
@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", SHAPES)
def test_is_exact_on_quadratics_whatever_the_weights(shape, pitch, solver):
    truth, gradients, _ = scene(QUADRATIC, shape, pitch)
    weights = np.random.default_rng(3).uniform(0.01, 1, shape)
    depth = depth_from_gradients(gradients, mm_per_px=pitch, weights=weights, solver=solver)
    share = 4e-3 if solver.startswith("robust") else 2e-3  # of the range: what its tolerance allows
    assert np.max(np.abs(depth - centred(truth))) < share * max(np.ptp(truth), 1e-3)


CONTRASTS = ["blobs", "random", "stripes", "checkerboard"]


def contrast(kind, shape, rng):
    rows, cols = np.mgrid[: shape[0], : shape[1]]
    if kind == "blobs":
        return np.where((np.hypot(rows % 23 - 11, cols % 29 - 14) < 7), 1e-3, 1.0)
    if kind == "random":
        return 10 ** rng.uniform(-3, 0, shape)
    if kind == "stripes":
        return np.where(cols % 7 < 3, 1e-3, 1.0)
    return np.where((rows // 3 + cols // 5) % 2, 1e-3, 1.0)


@pytest.mark.parametrize("anchored", [False, True])
@pytest.mark.parametrize("kind", CONTRASTS)
@pytest.mark.parametrize("shape", [(60, 80), (37, 101)])
def test_multigrid_agrees_with_elimination_to_its_tolerance(shape, kind, anchored):
    rng = np.random.default_rng(4)
    truth, gradients, pitch = scene(PEAKS, shape, 0.25)
    gradients = with_outliers(with_noise(gradients, 0.05, rng), 0.1, rng).gradients.astype(np.float32)
    weights = contrast(kind, shape, rng)
    anchor = np.where(truth < 0.05, 1e-2, 0) if anchored else None
    fast = MultigridSolver(shape, pitch)(gradients, weights, None, anchor)
    slow = SparseSolver(shape, pitch)(gradients, weights, None, anchor)
    difference = (fast.depth_mm - slow.depth_mm).astype(np.float64)
    assert np.max(np.abs(difference if anchored else centred(difference))) < 1.2e-3 * np.ptp(slow.depth_mm)
    assert 0 < fast.iterations < 60
    assert fast.tolerance <= 4e-4


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), solver=st.sampled_from(EXACT))
def test_weight_zero_means_no_influence(seed, solver):
    rng = np.random.default_rng(seed)
    gradients = rng.standard_normal((12, 15, 2)).astype(np.float32)
    weights = rng.uniform(0.1, 1, (12, 15)) * (rng.uniform(size=(12, 15)) > 0.4)
    weights[0, 0] = 1
    changed = gradients.copy()
    changed[weights == 0] = 100 * rng.standard_normal((np.count_nonzero(weights == 0), 2))
    before = integrate(gradients, mm_per_px=0.1, weights=weights, solver=solver)
    after = integrate(changed, mm_per_px=0.1, weights=weights, solver=solver)
    assert np.array_equal(before.depth_mm, after.depth_mm)
    assert np.array_equal(before.known, weights > 0)


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), factor=st.sampled_from([1e-4, 0.25, 8.0, 1e5]))
def test_only_ratios_of_weights_and_anchor_count(seed, factor):
    rng = np.random.default_rng(seed)
    gradients = rng.standard_normal((14, 11, 2))
    weights, anchor = rng.uniform(0.01, 1, (14, 11)), 0.1 * rng.uniform(size=(14, 11))
    before = depth_from_gradients(gradients, mm_per_px=0.1, weights=weights, anchor=anchor)
    after = depth_from_gradients(gradients, mm_per_px=0.1, weights=factor * weights, anchor=factor * anchor)
    assert np.max(np.abs(before - after)) < 1e-5 * np.ptp(before)


@pytest.mark.parametrize("solver", EXACT)
def test_hole_of_lies_stays_smooth(solver):
    truth, gradients, pitch = scene(QUADRATIC, (40, 50), 0.2)
    hole = np.zeros((40, 50), dtype=bool)
    hole[12:25, 18:33] = True
    gradients[hole] = 5
    depth = depth_from_gradients(gradients, mm_per_px=pitch, weights=~hole * 1.0, solver=solver)
    error = np.abs(depth - truth - np.mean((depth - truth)[~hole]))
    assert error[~hole].max() < 5e-3 * np.ptp(truth)
    assert error[hole].max() < 2e-2 * np.ptp(truth)


@pytest.mark.parametrize("solver", EXACT)
class TestMask:
    def test_islands_are_exact_each_to_its_own_zero(self, solver):
        truth, gradients, pitch = scene(QUADRATIC, (30, 40), 0.2)
        mask = np.zeros((30, 40), dtype=bool)
        mask[3:14, 2:18] = mask[17:29, 20:39] = mask[5, 30] = True
        gradients[~mask] = 7
        solution = integrate(gradients, mm_per_px=pitch, mask=mask, solver=solver)
        assert solution.islands == 3
        assert np.array_equal(solution.known, mask)
        for island in (np.s_[3:14, 2:18], np.s_[17:29, 20:39], np.s_[5, 30]):
            assert np.max(np.abs(solution.depth_mm[island] - centred(truth[island]))) < 1e-3
        assert np.all(np.isfinite(solution.depth_mm))
        assert np.abs(solution.depth_mm).max() <= np.abs(solution.depth_mm[mask]).max() + 1e-6

    def test_zero_pixels_set_the_zero_of_their_island(self, solver):
        _, gradients, pitch = scene(QUADRATIC, (20, 30), 0.2)
        mask = np.ones((20, 30), dtype=bool)
        mask[:, 14] = False
        zero = np.zeros((20, 30), dtype=bool)
        zero[2:4, 3:6] = True
        depth = depth_from_gradients(gradients, mm_per_px=pitch, mask=mask, zero=zero, solver=solver)
        assert np.median(depth[zero]) == pytest.approx(0, abs=1e-6)
        assert depth[:, 15:].mean() == pytest.approx(0, abs=1e-6)

    def test_channel_one_pixel_wide(self, solver):
        shape, pitch = (33, 47), (0.1, 0.1)
        mask = np.zeros(shape, dtype=bool)
        mask[1:8, 1:9] = mask[25:31, 38:46] = True
        mask[5, 8:43] = mask[5:26, 43] = True
        truth, gradients, _ = scene(QUADRATIC, shape, pitch)
        gradients[~mask] = -3
        depth = depth_from_gradients(gradients, mm_per_px=pitch, mask=mask, solver=solver)
        assert np.max(np.abs(depth[mask] - centred(truth[mask]))) < 2e-3 * np.ptp(truth)

    def test_scattered_pixels(self, solver):
        mask = np.random.default_rng(6).uniform(size=(40, 40)) < 0.45
        _, gradients, pitch = scene(QUADRATIC, (40, 40), 0.2)
        solution = integrate(gradients, mm_per_px=pitch, mask=mask, solver=solver)
        assert solution.islands > 20
        assert solution.residual < 1e-3

    def test_single_pixel(self, solver):
        mask = np.zeros((9, 9), dtype=bool)
        mask[4, 5] = True
        depth = depth_from_gradients(np.ones((9, 9, 2)), mm_per_px=0.1, mask=mask, solver=solver)
        assert np.array_equal(depth, np.zeros((9, 9), dtype=np.float32))


@pytest.mark.parametrize("solver", EXACT)
class TestAnchor:
    def test_pulls_to_zero_as_firmly_as_it_says(self, solver):
        """Two pixels: minimise (d/h - p)^2 + a (z1^2 + z2^2)/h^2 by hand: z = -+ p h/(2 + a)."""
        depth = depth_from_gradients(np.full((1, 2, 2), 0.4), mm_per_px=0.1, anchor=0.5, solver=solver)
        assert depth == pytest.approx(np.array([[-0.016, 0.016]]), rel=1e-4)

    def test_gives_the_offset(self, solver):
        truth, gradients, pitch = scene(PEAKS, (40, 50), 0.3)
        anchor = np.where(np.abs(truth) < 1e-3, 1e-2, 0)
        depth = depth_from_gradients(gradients, mm_per_px=pitch, anchor=anchor, solver=solver)
        assert np.max(np.abs(depth - truth)) < 0.02

    def test_bias_removed_first_then_anchor(self, solver):
        truth, gradients, pitch = scene(PEAKS, (60, 80), 0.2)
        untouched = np.abs(truth) < 1e-3
        anchor = np.where(untouched, 1e-2, 0)
        biased = gradients + np.array([0.01, -0.006])
        both, alone = (
            depth_from_gradients(
                biased, mm_per_px=pitch, anchor=anchor, zero=untouched, level=level, solver=solver
            )
            for level in ("slope", None)
        )
        touched = ~untouched
        assert np.abs(both - truth)[touched].max() < 0.25 * np.abs(alone - truth)[touched].max()


def test_multigrid_does_not_remember_earlier_frames():
    rng = np.random.default_rng(7)
    solve = MultigridSolver((40, 50), (0.1, 0.1))
    frames = [(rng.standard_normal((40, 50, 2)), rng.uniform(0, 1, (40, 50)) ** 3) for _ in range(3)]
    fresh = [MultigridSolver((40, 50), (0.1, 0.1))(*frame).depth_mm for frame in frames]
    for index in (0, 1, 1, 0, 2, 0):
        assert np.array_equal(solve(*frames[index]).depth_mm, fresh[index])


def test_multigrid_is_itself_again_after_a_failure():
    rng = np.random.default_rng(8)
    gradients, weights = rng.standard_normal((40, 50, 2)), rng.uniform(0.001, 1, (40, 50))
    solve = MultigridSolver((40, 50), (0.1, 0.1), max_iterations=1)
    with pytest.raises(ConvergenceError, match=r"after 1 iterations.*use solver='sparse'"):
        solve(gradients, weights)
    solve.max_iterations = 100
    expected = MultigridSolver((40, 50), (0.1, 0.1))(gradients, weights).depth_mm
    assert np.array_equal(solve(gradients, weights).depth_mm, expected)


def test_threads_do_not_share_state():
    rng = np.random.default_rng(9)
    jobs = [(rng.standard_normal((50, 60, 2)), rng.uniform(0.01, 1, (50, 60))) for _ in range(6)]

    def depth(job):
        return depth_from_gradients(job[0], mm_per_px=0.1, weights=job[1])

    expected = [depth(job) for job in jobs]
    with ThreadPoolExecutor(4) as threads:
        for _ in range(5):
            for one, other in zip(threads.map(depth, jobs), expected):
                assert np.array_equal(one, other)


@pytest.mark.parametrize("solver", WEIGHTED)
def test_a_stack_gives_the_bytes_of_its_frames(solver):
    rng = np.random.default_rng(10)
    stack = 0.1 * rng.standard_normal((3, 12, 15, 2))
    weights = rng.uniform(0.01, 1, (3, 12, 15))
    shared = depth_from_gradients(stack, mm_per_px=0.1, weights=weights[0], solver=solver)
    own = depth_from_gradients(stack, mm_per_px=0.1, weights=weights, solver=solver)
    for k in range(3):
        for depth, w in ((shared, weights[0]), (own, weights[k])):
            alone = depth_from_gradients(stack[k], mm_per_px=0.1, weights=w, solver=solver)
            assert np.array_equal(depth[k], alone)


@pytest.mark.parametrize("solver", WEIGHTED)
def test_weights_of_zero_everywhere_are_refused(solver):
    with pytest.raises(ValueError, match="at least one value > 0 inside the mask, got 0 everywhere"):
        depth_from_gradients(np.zeros((4, 5, 2)), mm_per_px=0.1, weights=np.zeros((4, 5)), solver=solver)
