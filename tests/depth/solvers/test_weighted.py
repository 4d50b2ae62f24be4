"""The grid in C: coarse operators are P^T A P, the V-cycle is symmetric, few iterations suffice, no state is left.
Walls that are read too flat: at least as steep as they are read, and nothing else changes.
"""

from __future__ import annotations

import os
import subprocess
import sys
from functools import partial

import numpy as np
import pytest

from gelform._native import Kernel
from gelform.depth.integrate import integrate
from gelform.depth.solvers import AtLeastSolver, MultigridSolver, SparseSolver
from gelform.depth.solvers import weighted as native
from gelform.depth.solvers.seam import edge_system, problem_from_gradients
from gelform.depth.solvers.weighted import Grid
from gelform.errors import ConvergenceError
from gelform.slopes.gradients import gradients_from_depth
from kernel_agreement import usable_isas
from scenes import PEAKS, confidence_from_valid, scene, with_noise, with_outliers, with_patches

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
    slopes, weights = rng.standard_normal((*shape, 2)), 10 ** rng.uniform(-2, 0, shape)
    return problem_from_gradients(slopes, weights, None, anchor)


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
    east, south = np.pad(east, ((0, 0), (0, 1))), np.pad(south, ((0, 1), (0, 0)))
    return matrix_of(east, south, problem.anchor.astype(float))


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
        coarser = operator(grid, level + 1)
        np.testing.assert_allclose(coarser, p.T @ a @ p, rtol=0, atol=2e-5 * np.abs(a).max())


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


def an_island(anchored):
    weights = np.array([[1e-3 if c == "#" else 1.0 for c in line] for line in ISLAND.split()])
    anchor = np.full(weights.shape, anchored)
    return problem_from_gradients(np.zeros((*weights.shape, 2)), weights, None, anchor)


@pytest.mark.parametrize(
    ("problem", "anchored"),
    [
        *((partial(some_problem, shape), anchored) for shape in [(11, 13), (8, 16)] for anchored in (0, 0.2)),
        *((an_island, anchored) for anchored in (0.0, 1e-4)),
    ],
)
def test_cycle_is_symmetric_and_nearly_the_inverse(problem, anchored, usable_isa):
    made = problem(anchored)
    cycle = cycle_matrix(made.anchor.shape, made, usable_isa)
    assert cycle == pytest.approx(cycle.T, abs=1e-4 * np.abs(cycle).max())
    values = np.sort(np.linalg.eigvals(cycle @ frame_operator(made)).real)[0 if anchored else 1 :]
    assert values.min() > 0.15
    assert values.max() < 1.6


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
        native._solve.on(isa)(grid.handle, None, depth, 0.0, 4e-4, 100, np.empty(2))
        depths.append(depth)
    assert all(depth.tobytes() == depths[0].tobytes() for depth in depths)


SMALL_MEMORY = """
import resource
from gelform.depth.solvers.weighted import Grid

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


DOUBTED = {  # which pixels have a thousandth of the others' weight
    "blobs": lambda rows, cols: np.hypot(rows % 23 - 11, cols % 29 - 14) < 7,
    "stripes": lambda rows, cols: cols % 7 < 3,
    "checkerboard": lambda rows, cols: (rows // 3 + cols // 5) % 2 == 1,
}
KINDS = [(shape, kind) for shape in [(60, 80), (37, 101)] for kind in [*DOUBTED, "random"]]


@pytest.mark.parametrize("anchored", [False, True])
@pytest.mark.parametrize(
    ("shape", "kind"), [*KINDS, pytest.param((240, 320), "blobs", marks=pytest.mark.slow)]
)
def test_multigrid_agrees_with_elimination_to_its_tolerance(shape, kind, anchored):
    rng = np.random.default_rng(4)
    truth, gradients, pitch = scene(PEAKS, shape, 0.25)
    gradients = with_outliers(with_noise(gradients, 0.05, rng), 0.1, rng).gradients.astype(np.float32)
    random = 10 ** rng.uniform(-3, 0, shape)
    weights = random if kind == "random" else np.where(DOUBTED[kind](*np.indices(shape)), 1e-3, 1.0)
    anchor = np.where(truth < 0.05, 1e-2, 0) if anchored else None
    fast = MultigridSolver(shape, pitch)(gradients, weights, None, anchor)
    slow = SparseSolver(shape, pitch)(gradients, weights, None, anchor)
    difference = (fast.depth_mm - slow.depth_mm).astype(np.float64)
    difference -= 0 if anchored else difference.mean()
    assert np.max(np.abs(difference)) < 1.2e-3 * np.ptp(slow.depth_mm)
    assert 0 < fast.iterations < 60
    assert fast.tolerance <= 4e-4


def test_multigrid_remembers_neither_earlier_frames_nor_a_failure():
    rng = np.random.default_rng(7)
    solve = MultigridSolver((40, 50), (0.1, 0.1))
    frames = [(rng.standard_normal((40, 50, 2)), rng.uniform(0, 1, (40, 50)) ** 3) for _ in range(3)]
    fresh = [MultigridSolver((40, 50), (0.1, 0.1))(*frame).depth_mm for frame in frames]
    solve.max_iterations = 1
    with pytest.raises(ConvergenceError, match=r"after 1 iterations.*solver='sparse'"):
        solve(*frames[0])
    solve.max_iterations = 100
    for index in (0, 1, 1, 0, 2, 0):
        assert np.array_equal(solve(*frames[index]).depth_mm, fresh[index])


SHAPE, PITCH_AT_LEAST = (48, 64), 0.1


def frustum(top_px=8.0, width_px=6.0, height_mm=0.5):
    """A flat top with walls all around, and rest beside it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    return height_mm * np.clip(1 - (np.hypot(x - 32, y - 24) - top_px) / width_px, 0, 1)


def heights(solver, gradients, rest, **how):
    depth = integrate(gradients, mm_per_px=PITCH_AT_LEAST, solver=solver, anchor=0.1 * rest, **how).depth_mm
    return depth[22:27, 30:35].mean()


@pytest.mark.parametrize("edges", [False, True])
def test_walls_that_are_read_too_flat_here_and_there_come_out_steeper(edges):
    depth = frustum()
    gradients = gradients_from_depth(depth, mm_per_px=PITCH_AT_LEAST)
    rest = (depth == 0).astype(np.float32)
    exact, same = (heights(name, gradients, rest) for name in ("multigrid", "at_least"))
    assert same == pytest.approx(exact, abs=0.01), "exact slopes stay"
    weak = np.random.default_rng(0).uniform(size=SHAPE) < 0.5
    gradients[weak] *= 0.5  # of a half of all pixels
    weights = np.full(SHAPE, 0.7, np.float32)
    how = {"weights": (weights[:, 1:], weights[1:]) if edges else weights}
    plain, least = (heights(name, gradients, rest, **how) for name in ("multigrid", "at_least"))
    assert plain < 0.85 * 0.5
    assert plain + 0.03 < least < 0.5


def test_without_walls_it_is_multigrid():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 40
    gradients = np.stack([0.2 * np.sin(x), 0.2 * np.cos(y)], axis=-1).astype(np.float32)
    weights = np.random.default_rng(0).uniform(0.5, 1, SHAPE).astype(np.float32)
    solvers = (solver(SHAPE, (0.1, 0.1)) for solver in (MultigridSolver, AtLeastSolver))
    plain, least = (solver(gradients, weights).depth_mm for solver in solvers)
    np.testing.assert_array_equal(least, plain)
