"""What every solver owes: agreement where all are right, one call shape, a place in the guide. The problem that all
weighted solvers share: scaled weights, what is trusted, couplings.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.depth.integrate import depth_from_gradients, integrate
from gelform.depth.solvers import SOLVERS, seam
from gelform.depth.solvers.seam import (
    differences,
    edge_system,
    edges_from_gradients,
    problem_from_gradients,
    residual_rms,
)
from kernel_agreement import assert_kernel_agrees
from scenes import PEAKS, QUADRATIC, gaussian, scene

SHAPES = [(1, 1), (1, 2), (2, 1), (1, 41), (43, 1), (2, 2), (2, 3), (3, 2), (7, 6), (13, 17), (31, 53)]
SHAPES += [(48, 65), (64, 256), (101, 37)]
PITCHES = [(0.0634, 0.0634), (0.05, 0.08)]
EXACT = ["multigrid", "sparse"]
SHARE = {"dct": 3e-6, "dct4": 3e-6, **dict.fromkeys(EXACT, 2e-3)}  # of the range: what tolerances allow


def centered(depth):
    return depth - depth.mean(dtype=np.float64)


@pytest.mark.parametrize("solver", SOLVERS)
def test_all_agree_on_a_bump_that_fades_before_the_border(solver):
    truth, gradients, pitch = scene(gaussian(1.0, 1.0), (160, 200), (0.06, 0.05))
    depth = depth_from_gradients(gradients, mm_per_px=pitch, solver=solver)
    assert depth.dtype == np.float32
    depth = depth - depth.mean()
    assert np.max(np.abs(depth - (truth - truth.mean()))) < 1e-3 * np.ptp(truth)


@pytest.mark.parametrize("solver", SOLVERS)
def test_says_whether_it_takes_weights(solver):
    gradients = np.random.default_rng(0).normal(0, 0.1, (9, 12, 2))
    weights = np.linspace(0.1, 1, 108).reshape(9, 12)
    if SOLVERS[solver].takes_weights:
        weighted = depth_from_gradients(gradients, mm_per_px=0.1, weights=weights, solver=solver)
        assert not np.allclose(weighted, depth_from_gradients(gradients, mm_per_px=0.1, solver=solver))
        with pytest.raises(ValueError, match="at least one value > 0 inside the mask, got 0 everywhere"):
            depth_from_gradients(gradients, mm_per_px=0.1, weights=0 * weights, solver=solver)
        return
    for name, value in {"weights": weights, "mask": weights > 0, "anchor": 0.1}.items():
        with pytest.raises(ValueError, match=r"Expected no weights, mask or anchor for a .*multigrid"):
            depth_from_gradients(gradients, mm_per_px=0.1, solver=solver, **{name: value})


@pytest.mark.parametrize("shape", [(12, 17), (5, 256), (1, 4)])
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_stack_gives_the_bytes_of_its_frames(solver, shape):
    rng = np.random.default_rng(10)
    stack, weights = 0.1 * rng.standard_normal((2, 3, *shape, 2)), rng.uniform(0.01, 1, (2, 3, *shape))
    for given_weights in (weights[0, 0], weights) if SOLVERS[solver].takes_weights else (None,):
        arguments = {"mm_per_px": (0.05, 0.08), "solver": solver}
        depth = depth_from_gradients(stack, weights=given_weights, **arguments)
        assert depth.shape == (2, 3, *shape)
        for k in np.ndindex(2, 3):
            own = weights[k] if given_weights is weights else given_weights
            assert np.array_equal(depth[k], depth_from_gradients(stack[k], weights=own, **arguments))


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_guide_says_when_to_take_it(solver):
    guide = Path(__file__).parents[3] / "docs" / "choosing-a-solver.md"
    assert f"`{solver}`" in guide.read_text()


def dense_answer(gradients, wx, wy, anchor, pitch):
    """Minimizer by a dense least-squares solve of the stated energy: one row per edge and per anchor."""
    height, width = gradients.shape[:2]
    unit = np.eye(height * width).reshape(-1, height, width)
    dx, dy = differences(unit, pitch)
    ex, ey = edges_from_gradients(gradients)
    area = np.sqrt(pitch[0] * pitch[1])
    rows = [(d * np.sqrt(w)).reshape(height * width, -1).T for d, w in ((dx, wx), (dy, wy))]
    rows.append(np.diag(np.sqrt(anchor).ravel()) / area)
    right = [(ex * np.sqrt(wx)).ravel(), (ey * np.sqrt(wy)).ravel(), np.zeros(height * width)]
    return np.linalg.lstsq(np.concatenate(rows), np.concatenate(right), rcond=None)[0].reshape(height, width)


@pytest.mark.parametrize("solver", EXACT)
@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize(("anchored", "per_edge"), [(False, False), (True, False), (False, True)])
def test_minimises_the_stated_energy(solver, pitch, anchored, per_edge):
    rng = np.random.default_rng(1)
    gradients, weights = rng.standard_normal((9, 11, 2)), 10 ** rng.uniform(-2.5, 0, (9, 11))
    weights /= weights.max()
    anchor = 0.3 * rng.uniform(size=(9, 11)) * (rng.uniform(size=(9, 11)) > 0.6) * anchored
    pairs = (weights[:, 1:], weights[:, :-1]), (weights[1:], weights[:-1])
    edges = tuple(2 * a * b / (a + b) for a, b in pairs)  # harmonic means
    if per_edge:
        edges = weights = rng.uniform(0.01, 1, (9, 10)), rng.uniform(0.01, 1, (8, 11))
    expected = dense_answer(gradients, *edges, anchor, pitch)
    depth = SOLVERS[solver]((9, 11), pitch)(gradients, weights, None, anchor).depth_mm
    depth, expected = (depth, expected) if anchored else (centered(depth), centered(expected))
    assert np.max(np.abs(depth - expected)) < 5e-4 * np.ptp(expected)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("pitch", [*PITCHES, (0.2, 0.03)])
@pytest.mark.parametrize("shape", SHAPES)
def test_is_exact_on_quadratics_whatever_the_weights(shape, pitch, solver):
    truth, gradients, _ = scene(QUADRATIC, shape, pitch)
    weights = np.random.default_rng(3).uniform(0.01, 1, shape) if SOLVERS[solver].takes_weights else None
    depth = depth_from_gradients(gradients, mm_per_px=pitch, weights=weights, solver=solver)
    assert np.max(np.abs(depth - centered(truth))) <= SHARE.get(solver, 4e-3) * max(np.ptp(truth), 1e-3)


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


ISLANDS = {  # boxes of a mask's islands
    "three": [[np.s_[3:14, 2:18]], [np.s_[17:29, 20:39]], [np.s_[5:6, 30:31]]],
    "a narrow channel": [[np.s_[1:8, 1:9], np.s_[24:29, 33:39], np.s_[5:6, 8:36], np.s_[5:26, 35:36]]],
    "one pixel": [[np.s_[4:5, 5:6]]],
}


@pytest.mark.parametrize("solver", EXACT)
class TestMask:
    @pytest.mark.parametrize("name", ISLANDS)
    def test_islands_are_exact_each_to_its_own_zero(self, solver, name):
        truth, gradients, pitch = scene(QUADRATIC, (30, 40), 0.2)
        islands = np.zeros((len(ISLANDS[name]), 30, 40), dtype=bool)
        for island, boxes in zip(islands, ISLANDS[name]):
            for box in boxes:
                island[box] = True
        mask = islands.any(axis=0)
        gradients[~mask] = 7
        solution = integrate(gradients, mm_per_px=pitch, mask=mask, solver=solver)
        assert solution.islands == len(islands)
        assert np.array_equal(solution.known, mask)
        for island in islands:
            assert np.max(np.abs(solution.depth_mm[island] - centered(truth[island]))) < 1e-3
        assert np.all(np.isfinite(solution.depth_mm))
        assert np.abs(solution.depth_mm).max() <= np.abs(solution.depth_mm[mask]).max() + 1e-6

    def test_zero_pixels_set_the_zero_of_their_island(self, solver):
        _, gradients, pitch = scene(QUADRATIC, (20, 30), 0.2)
        mask, zero = np.ones((20, 30), dtype=bool), np.zeros((20, 30), dtype=bool)
        mask[:, 14], zero[2:4, 3:6] = False, True
        depth = depth_from_gradients(gradients, mm_per_px=pitch, mask=mask, zero=zero, solver=solver)
        assert np.median(depth[zero]) == pytest.approx(0, abs=1e-6)
        assert depth[:, 15:].mean() == pytest.approx(0, abs=1e-6)

    def test_scattered_pixels(self, solver):
        mask = np.random.default_rng(6).uniform(size=(40, 40)) < 0.45
        _, gradients, pitch = scene(QUADRATIC, (40, 40), 0.2)
        solution = integrate(gradients, mm_per_px=pitch, mask=mask, solver=solver)
        assert solution.islands > 20
        assert solution.residual < 1e-3


@pytest.mark.parametrize("solver", EXACT)
class TestAnchor:
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
        how = {"mm_per_px": pitch, "anchor": anchor, "zero": untouched, "solver": solver}
        both, alone = (depth_from_gradients(biased, level=level, **how) for level in ("slope", None))
        touched = ~untouched
        assert np.abs(both - truth)[touched].max() < 0.25 * np.abs(alone - truth)[touched].max()


def scaled(weights, mask, anchor, floor, confidence, trusted, known, found):
    """In numpy: what `scale_weights` writes."""
    inside = np.ones(weights.shape, bool) if mask is None else mask
    largest = weights[inside].max(initial=0)
    if largest == 0:
        return confidence * 0, trusted & False, known & False, np.array([0.0, 0.0])
    share = np.where(inside, weights, 0) / largest
    enough = share >= np.float32(floor)
    count = np.count_nonzero(inside & (share < np.float32(floor)))
    known = enough if anchor is None else enough | (anchor > 0)
    return np.maximum(share, np.float32(floor)) * inside, enough, known, np.array([largest, count])


def test_weights_are_scaled_as_in_numpy():
    """Of all sizes that float32 holds; those of zero leave nothing trusted."""
    assert_kernel_agrees(seam._scale_weights, scaled)
    blank = np.zeros((3, 4), np.float32)
    outputs = blank, *np.zeros((2, 3, 4), bool), np.ones(2)
    assert_kernel_agrees(seam._scale_weights, scaled, blank, None, None, 1e-6, *outputs)


def test_edges_of_pixels_are_those_of_their_harmonic_means():
    rng = np.random.default_rng(2)
    gradients, confidence = rng.standard_normal((5, 6, 2)), rng.uniform(0.1, 1, (5, 6))
    confidence[2, 3] = 1
    pairs = (confidence[:, 1:], confidence[:, :-1]), (confidence[1:], confidence[:-1])
    edges = tuple(2 * a * b / (a + b) for a, b in pairs)
    by_pixel = edge_system(problem_from_gradients(gradients, confidence, None, None), (0.1, 0.13))
    by_edge = edge_system(problem_from_gradients(gradients, edges, None, None), (0.1, 0.13))
    largest = max(e.max() for e in edges)  # weights per edge are scaled by the largest of them
    for one, other in zip(by_pixel, by_edge):
        assert one == pytest.approx(other * largest, abs=1e-6)


PITCH = (0.05, 0.08)


def squares(depth, gradients, known, per_x, per_y, _):
    """In numpy, float64: over edges whose pixels are both known."""
    recovered = differences(depth.astype(float), (1 / per_x, 1 / per_y))
    given = edges_from_gradients(gradients.astype(float))
    both = known[..., 1:] & known[..., :-1], known[..., 1:, :] & known[..., :-1, :]
    parts = [(r - g)[b] for r, g, b in zip(recovered, given, both)]
    return np.array([sum(np.sum(part**2) for part in parts), sum(part.size for part in parts)])


def test_residuals_are_those_of_numpy():
    assert_kernel_agrees(seam._residual_squares, squares)


def test_a_surface_leaves_nothing_and_a_wrong_edge_what_it_is_wrong_by():
    depth = np.zeros((1, 4, 5), dtype=np.float32)
    gradients, known = np.zeros((1, 4, 5, 2), dtype=np.float32), np.ones((1, 4, 5), dtype=bool)
    assert residual_rms(depth, gradients, known, *PITCH) == 0
    depth[0, 0, 0] = 0.1
    expected = np.sqrt(((0.1 / PITCH[0]) ** 2 + (0.1 / PITCH[1]) ** 2) / (4 * 4 + 3 * 5))
    assert residual_rms(depth, gradients, known, *PITCH) == pytest.approx(expected, rel=1e-5)
