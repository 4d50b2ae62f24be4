"""The door to the solvers: scenes with known depth, offsets, levels, what is reported, what is refused. Where depth is
0, and what is leveled off. What solvers are given: weights per pixel, per edge, or as a stack; test_integrate has the
wrong ones. One frame's slopes to depth: what the solver is given.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np
import pytest

from gelform.depth.coarse import RestAnchor
from gelform.depth.integrate import (
    FrameDepth,
    IntegrationProblem,
    check_weights,
    depth_from_gradients,
    fitted_surface,
    integrate,
    median_over,
)
from gelform.depth.solvers import SOLVERS
from gelform.errors import ConvergenceError
from gelform.slopes.budget import ReadSlopes
from scenes import BALL, BUMP, CUT_BALL, MM_PER_PX, PLANE, SHAPE, SMALL_BALL, gaussian, polynomial, scene


def peak_above_untouched(depth, truth):
    return depth.max() - np.median(depth[truth == 0])


@pytest.mark.parametrize(
    ("surface", "height", "tolerance"),
    [
        (BUMP, lambda z, _: np.ptp(z), 0.005),
        (BALL, peak_above_untouched, 0.005),
        (SMALL_BALL, peak_above_untouched, 0.02),
        (CUT_BALL, peak_above_untouched, 0.005),
        (PLANE, lambda z, _: np.ptp(z), 0.005),
    ],
    ids=["bump", "ball R 4", "ball R 2", "cut ball", "plane"],
)
def test_recovers_the_height_of_scenes(surface, height, tolerance):
    truth, gradients, pitch = scene(surface)
    depth = depth_from_gradients(gradients, mm_per_px=pitch)
    assert depth.shape == SHAPE
    assert height(depth, truth) == pytest.approx(height(truth, truth), rel=tolerance)


class TestZero:
    truth, gradients, pitch = scene(BALL, (60, 80), 0.25)

    def test_mean_border_or_a_region(self):
        border, region = np.ones((60, 80), dtype=bool), np.zeros((60, 80), dtype=bool)
        border[1:-1, 1:-1], region[5:9, 60:70] = False, True
        for zero, where in (("border", border), (region, region)):
            depth = depth_from_gradients(self.gradients, mm_per_px=0.25, zero=zero)
            assert abs(np.median(depth[where])) < 1e-6
            assert depth.max() == pytest.approx(self.truth.max(), rel=0.02)
        assert abs(depth_from_gradients(self.gradients, mm_per_px=0.25).mean()) < 1e-6

    def test_the_border_is_one_pixel_wide(self):
        bow = scene(polynomial(BOW), (60, 80), 0.25).gradients
        depth = depth_from_gradients(bow, mm_per_px=0.25, zero="border")
        border = np.concatenate([depth[0], depth[-1], depth[1:-1, 0], depth[1:-1, -1]])
        assert abs(np.median(border)) < 1e-6

    def test_frame_that_is_all_border(self):
        depth = depth_from_gradients(np.ones((1, 9, 2)), mm_per_px=0.5, zero="border")
        assert depth == pytest.approx(0.5 * (np.arange(9) - 4)[None])


TILT = {(1, 0): 0.01, (0, 1): -0.006}
BOW = {**TILT, (2, 0): 0.002, (1, 1): 0.001, (0, 2): -0.001}


class TestLevel:
    truth, gradients, pitch = scene(gaussian(1.0, 1.2), (60, 80), 0.25)
    untouched = truth < 1e-7

    def depth(self, gradients, level, zero=untouched):
        return depth_from_gradients(gradients, mm_per_px=0.25, zero=zero, level=level)

    @pytest.mark.parametrize(("level", "drift"), [("slope", TILT), ("plane", TILT), ("quadratic", BOW)])
    def test_removes_the_drift_that_it_is_for(self, level, drift):
        drifted = self.gradients + scene(polynomial(drift), (60, 80), 0.25).gradients
        assert np.max(np.abs(self.depth(drifted, None) - self.truth)) > 0.05
        assert np.max(np.abs(self.depth(drifted, level) - self.truth)) < 0.01
        if level != "slope":
            flat = self.depth(self.gradients, level)
            assert self.depth(drifted, level) == pytest.approx(flat, abs=1e-5)

    def test_a_plane_takes_no_bow(self):
        bowed = self.gradients + scene(polynomial(BOW), (60, 80), 0.25).gradients
        assert np.max(np.abs(self.depth(bowed, "plane") - self.truth)) > 0.02


@pytest.mark.parametrize("pitch", [(0.0634, 0.0634), (0.05, 0.08)])
def test_pitch_is_x_then_y(pitch):
    truth, gradients, _ = scene(polynomial({(1, 0): 0.1, (0, 2): 0.01}), (30, 20), pitch)
    depth = depth_from_gradients(gradients, mm_per_px=pitch)
    assert depth == pytest.approx(truth - truth.mean(), abs=1e-6)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"gradients": np.zeros((2, 240, 320))}, r"Expected gradients of shape \(240, 320, 2\)"),
        ({"gradients": np.full((4, 5, 2), np.nan)}, "Expected finite gradients, got 40 values"),
        ({"mm_per_px": 0.0}, "Expected mm_per_px > 0"),
        ({"mm_per_px": -0.1}, "Expected mm_per_px > 0"),
        ({"solver": "poisson"}, "Expected a solver among auto, .*dct.*got 'poisson'"),
        ({"zero": "corner"}, "Expected zero as 'mean', 'border' or a boolean"),
        ({"weights": np.ones((5, 4))}, r"Expected weights of shape \(4, 5\), got \(5, 4\)"),
        ({"weights": -np.ones((4, 5))}, "Expected weights >= 0, got -1"),
        ({"weights": np.full((4, 5), np.nan)}, "Expected finite weights, got 20 values"),
        ({"weights": np.ones((3, 4, 5))}, r"Expected weights of shape \(4, 5\) or \(4, 5\), got \(3, 4, 5\)"),
        ({"weights": (np.ones((4, 5)),) * 2}, r"weights per edge of shapes \(4, 4\) and \(3, 5\)"),
        ({"weights": (np.ones((4, 4)), -np.ones((3, 5)))}, "Expected weights >= 0"),
        ({"mask": np.zeros((4, 5), dtype=bool)}, "Expected mask with at least one True pixel"),
        ({"mask": np.ones((4, 4), dtype=bool)}, r"Expected mask of shape \(4, 5\)"),
        ({"anchor": -1.0}, "Expected anchor >= 0"),
        ({"anchor": np.ones((5, 4))}, r"Expected anchor of shape \(4, 5\)"),
        ({"level": "tilt"}, "Expected level as None, 'slope', 'plane' or 'quadratic'"),
    ],
)
def test_bad_input_is_refused(change, text):
    arguments = {"gradients": np.zeros((4, 5, 2)), "mm_per_px": 0.1} | change
    with pytest.raises(ValueError, match=text):
        depth_from_gradients(arguments.pop("gradients"), **arguments)


@pytest.mark.parametrize(
    "arguments", [{"weights": np.ones((6, 7))}, {"mask": np.ones((6, 7), bool)}, {"anchor": 0.1}]
)
def test_auto_takes_multigrid_for_weights_mask_or_anchor_and_says_so(arguments):
    solution = integrate(np.full((6, 7, 2), 0.1), mm_per_px=0.1, **arguments)
    assert solution.solver == "multigrid"
    assert solution.iterations > 0
    assert 0 <= solution.tolerance <= 4e-4


def test_slopes_at_rest_are_flat_for_every_argument():
    for arguments in ({}, {"weights": np.ones((6, 7))}, {"anchor": 0.1}, {"mask": np.eye(6, 7, dtype=bool)}):
        depth = depth_from_gradients(np.zeros((6, 7, 2)), mm_per_px=0.1, **arguments)
        assert np.array_equal(depth, np.zeros((6, 7)))


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("shape", [(60, 80), (61, 83)])
def test_flipped_slopes_give_the_flipped_depth(shape, axis):
    """Also where nothing is known, whose slopes are filled."""
    _, gradients, pitch = scene(BALL, shape, 0.25)
    rng = np.random.default_rng(0)
    noisy = gradients + rng.normal(0, 0.05, gradients.shape).astype(np.float32)
    weights = np.where(rng.uniform(size=shape) < 0.2, 1e-9, 1.0)
    weights[20:40, 33:58] = 1e-9
    depth = depth_from_gradients(noisy, mm_per_px=pitch, weights=weights)
    signs = np.array([-1, 1] if axis else [1, -1], dtype=np.float32)
    flipped = depth_from_gradients(
        np.flip(noisy, axis) * signs, mm_per_px=pitch, weights=np.flip(weights, axis)
    )
    np.testing.assert_allclose(np.flip(flipped, axis), depth, atol=2e-4)  # mm


def test_float64_and_float32_slopes_give_the_same():
    _, gradients, pitch = scene(BUMP, (30, 40), 0.3)
    single = depth_from_gradients(gradients.astype(np.float32), mm_per_px=pitch)
    assert np.array_equal(single, depth_from_gradients(gradients, mm_per_px=pitch))


EXTREMES = {
    "weights 1e-42": {"weights": np.float32(1e-42)},
    "weights 3e38": {"weights": np.float32(3e38)},
    "weights 1e-42 and an anchor": {"weights": np.float32(1e-42), "anchor": np.float32(1e-2)},
    "anchor 3e38": {"anchor": np.float32(3e38)},
    "anchor 1e-42": {"anchor": np.float32(1e-42)},
    "weights 1 and 1e-42": {"weights": np.float32(1e-42), "one": True},
    "slopes 3e38": {"slope": 3e38},
    "slopes 1e30, weighted": {"slope": 1e30, "weights": np.float32(1)},
    "slopes 1e-42, weighted": {"slope": 1e-42, "weights": np.float32(1)},
}


def extreme_frame(shape, slope=1.0, weights=None, anchor=None, one=False):
    gradients = (slope * np.random.default_rng(0).uniform(-1, 1, (*shape, 2))).astype(np.float32)
    maps = {"weights": weights, "anchor": anchor}
    maps = {name: np.full(shape, value) for name, value in maps.items() if value is not None}
    if one:
        maps["weights"][shape[0] // 2, shape[1] // 2] = 1
    return gradients, maps


@pytest.mark.parametrize("title", EXTREMES)
@pytest.mark.parametrize("solver", SOLVERS)
def test_extremes_end_in_finite_depth_or_a_named_error_and_poison_nothing(solver, title):
    shape = (32, 24)
    usual, weights = extreme_frame(shape)[0], np.random.default_rng(1).uniform(0.1, 1, shape)
    how = {"mm_per_px": 0.1, "solver": solver}
    weighted = how | ({"weights": weights} if SOLVERS[solver].takes_weights else {})
    before = depth_from_gradients(usual, **weighted)
    gradients, maps = extreme_frame(shape, **EXTREMES[title])
    with suppress(ValueError, ConvergenceError):
        assert np.isfinite(depth_from_gradients(gradients, **how, **maps)).all()
    assert np.array_equal(before, depth_from_gradients(usual, **weighted))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({"slope": 3e38}, "Expected finite gradients"),
        ({"slope": 3e38, "weights": 1}, "Expected finite gradients"),
        ({"slope": 3e16}, r"Expected slopes up to 1e\+15 mm/mm, got 3\.0e\+16"),
        ({"slope": 3e16, "weights": 1}, r"Expected slopes up to 1e\+15 mm/mm, got 3\.0e\+16"),
        (EXTREMES["weights 1e-42 and an anchor"], r"Expected an anchor up to 1e\+30 of the largest weight"),
    ],
)
def test_what_float32_cannot_hold_is_named(given, text):
    gradients, maps = extreme_frame((32, 24), **given)
    with pytest.raises(ValueError, match=text):
        depth_from_gradients(gradients, mm_per_px=0.1, **maps)


def test_tiny_weights_count_as_any_others():
    """Only ratios count: weights of 1e-42 poisoned every later call of that size."""
    gradients, maps = extreme_frame((32, 24), weights=np.float32(1e-42))
    tiny = depth_from_gradients(gradients, mm_per_px=0.1, **maps)
    usual = depth_from_gradients(gradients, mm_per_px=0.1, weights=np.ones((32, 24)))
    assert np.array_equal(tiny, usual)


def test_a_problem_of_ones_own_is_solved_alike():
    _, gradients, pitch = scene(BALL)
    rng = np.random.default_rng(3)
    g = gradients.astype(np.float32)
    weights, anchor = (rng.uniform(0.1, 1, g.shape[:2]).astype(np.float32) for _ in range(2))
    rest = rng.random(g.shape[:2]) < 0.5
    for how in ({"weights": weights, "anchor": anchor}, {"zero": rest}):
        quick, checked = IntegrationProblem(g, pitch, **how).solved(), integrate(g, mm_per_px=pitch, **how)
        assert np.array_equal(quick.depth_mm, checked.depth_mm)
        assert (quick.solver, quick.curl_rms) == (checked.solver, checked.curl_rms)


def test_report_of_a_true_surface():
    _, gradients, pitch = scene(BUMP)
    solution = integrate(gradients, mm_per_px=pitch)
    assert (solution.solver, solution.iterations, solution.islands) == ("dct", 0, 1)
    assert solution.known.all()
    assert max(solution.residual, solution.curl_rms) < 1e-3


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


def test_where_the_iteration_stalls_the_frame_is_factorised():
    """A mesh of channels 3 px wide between blocks that say nothing: no coarse grid follows them."""
    y, x = np.mgrid[:120, :160]
    weights = np.where((x // 5 + y // 3) % 2, 1.0, 1e-3).astype(np.float32)
    slopes = np.random.default_rng(3).normal(size=(120, 160, 2)).astype(np.float32)
    with pytest.raises(ConvergenceError):
        integrate(slopes, mm_per_px=0.1, weights=weights, solver="multigrid")
    found, exact = (integrate(slopes, mm_per_px=0.1, weights=weights, solver=s) for s in ("auto", "sparse"))
    assert found.solver == "sparse"
    np.testing.assert_array_equal(found.depth_mm, exact.depth_mm)


@pytest.mark.linear_algebra
def test_the_median_of_a_large_region_is_nearly_that_of_all():
    rng = np.random.default_rng(0)
    maps = rng.normal(3, 1, (2, 300, 400)).astype(np.float32)
    region = rng.random((300, 400)) < 0.7
    np.testing.assert_allclose(median_over(maps, region), [np.median(one[region]) for one in maps], atol=0.05)
    small = np.zeros_like(region)
    small[5, 3:8] = True
    np.testing.assert_array_equal(median_over(maps, small), np.median(maps[:, small], axis=-1))


@pytest.mark.linear_algebra
@pytest.mark.parametrize("degree", [1, 2])
def test_a_polynomial_surface_is_found_exactly(degree):
    y, x = np.mgrid[:20, :30] / 10.0
    surface = 1 + 0.3 * x - 0.2 * y + (degree == 2) * (0.1 * x * y - 0.05 * y**2)
    region = np.zeros((20, 30), dtype=bool)
    region[::3, ::4] = True
    spoiled = np.where(region, surface, 99.0)
    np.testing.assert_allclose(fitted_surface(spoiled, region, degree), surface, atol=1e-5)
    with pytest.raises(ValueError, match="zero pixels to fit a surface, got 1"):
        fitted_surface(spoiled, np.arange(600).reshape(20, 30) == 7, degree)


def test_weights_come_per_pixel_per_edge_or_as_a_stack():
    assert check_weights(np.ones((4, 5)), (4, 5)).dtype == np.float32
    assert check_weights(np.ones((3, 4, 5)), (3, 4, 5)).shape == (3, 4, 5)
    wx, wy = check_weights([np.ones((4, 4)), np.ones((3, 5))], (4, 5))
    assert (wx.shape, wy.shape) == ((4, 4), (3, 5))
    wx, wy = check_weights((np.ones((4, 0)), np.ones((3, 1))), (4, 1))
    assert wx.size == 0


SHAPE_FRAME, PITCH, SIGMA = (40, 50), 0.05, 0.04


@pytest.fixture
def slopes():
    """Of a bump with noise; some are outliers, and some are not seen."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[: SHAPE_FRAME[0], : SHAPE_FRAME[1]] - np.array([20, 25])[:, None, None]
    depth = 0.3 * np.exp(-(x**2 + y**2) / 60)
    read = np.stack(np.gradient(depth, PITCH)[::-1], axis=-1) + rng.normal(0, 0.02, (*SHAPE_FRAME, 2))
    residual = rng.exponential(3, SHAPE_FRAME).astype(np.float32)
    return ReadSlopes(
        read.astype(np.float32),
        x**2 + y**2 > 200,
        unseen=rng.uniform(size=SHAPE_FRAME) > 0.95,
        residual=residual,
    )


def test_a_frame_has_weights_and_an_anchor(slopes):
    weights, anchor = (
        slopes.weights(SIGMA),
        RestAnchor(SHAPE_FRAME, PITCH, SIGMA)(slopes.gradients, slopes.at_rest),
    )
    assert 0 < np.count_nonzero(weights < 0.5) < weights.size / 2
    wanted = integrate(slopes.gradients, mm_per_px=PITCH, solver="multigrid", weights=weights, anchor=anchor)
    found = FrameDepth(SHAPE_FRAME, PITCH, SIGMA)(slopes)
    np.testing.assert_array_equal(found.depth_mm, wanted.depth_mm)
