"""What every solver that takes weights must do: the same minimiser, holes, islands, channels, scaling."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.depth import depth_from_gradients, integrate
from gelform.errors import ConvergenceError
from gelform.solvers import SOLVERS, MultigridSolver, SparseSolver
from gelform.solvers.edges import differences, edges_from_gradients
from scenes import PEAKS, polynomial, scene, with_noise, with_outliers

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


@pytest.mark.parametrize("solver", ["multigrid", "sparse"])
def test_uniform_weights_give_the_uniform_answer(solver):
    _, gradients, pitch = scene(PEAKS, (45, 60), 0.3)
    gradients = with_noise(gradients, 0.05, np.random.default_rng(5))
    uniform = depth_from_gradients(gradients, mm_per_px=pitch)
    depth = depth_from_gradients(gradients, mm_per_px=pitch, weights=np.full((45, 60), 0.3), solver=solver)
    assert np.max(np.abs(depth - uniform)) < 5e-4 * np.ptp(uniform)


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
