"""The standard deviation of depth, against Monte Carlo through the door itself."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gelform.depth.integrate import depth_from_gradients
from gelform.depth.sigma import sigma as sigma_module
from gelform.depth.sigma.sigma import (
    DepthDifference,
    DepthSigma,
    checked_rest,
    checked_share,
    checked_sigma,
    depth_sigma_from_gradients_sigma,
)
from gelform.errors import ConvergenceError
from kernel_agreement import assert_kernel_agrees
from scenes import gaussian, scene, with_outliers

SHAPE = (72, 96)
PITCH = 0.2


def correlated(shape, length, rng):
    """Errors of variance 1 with correlation exp(-d^2/(2 length^2)), from a margin of white noise."""
    blur = length / np.sqrt(2)
    margin = int(5 * blur) + 1
    noise = rng.standard_normal((shape[0] + 2 * margin, shape[1] + 2 * margin, 2))
    impulse = np.zeros(2 * margin + 1)
    impulse[margin] = 1
    gain = np.sum(gaussian_filter(impulse, blur) ** 2)
    return gaussian_filter(noise, (blur, blur, 0))[margin:-margin, margin:-margin] / gain


@lru_cache(maxsize=2)
def many_correlated(length, count):
    """As many correlated errors as are asked for; the tests of one length share them."""
    rng = np.random.default_rng(3)
    return np.stack([correlated(SHAPE, length, rng) for _ in range(count)])


def monte_carlo(sigma, length, share, count=400, **arguments):
    rng = np.random.default_rng(1)
    errors = np.sqrt(1 - share) * sigma * rng.standard_normal((count, *sigma.shape))
    if share:
        errors += np.sqrt(share) * sigma * many_correlated(length, count)
    depth = depth_from_gradients(errors, mm_per_px=PITCH, **arguments)
    return np.sqrt(np.mean(np.square(depth, dtype=np.float64), axis=0))


def uneven():
    """Confidence as a calibration gives it: clean; noisier on the left, hopeless specks; anchors."""
    rng = np.random.default_rng(2)
    truth, gradients, _ = scene(gaussian(1.0, 2.5), SHAPE, PITCH)
    sigma = np.full(SHAPE, 0.05)
    sigma[:, :30] = 0.08
    lying = ~with_outliers(gradients, 0.1, rng).valid
    sigma[lying] = np.where(rng.uniform(size=np.count_nonzero(lying)) < 0.5, 0.25, 3.0)
    weights = np.minimum(1, (0.05 / sigma) ** 2)
    return np.repeat(sigma[..., None], 2, axis=-1), weights, np.where(truth < 0.01, 1e-2, 0)


def deviation(sigma, expected):
    return np.abs(sigma / expected - 1)


@pytest.mark.parametrize("shape", [(24, 40), (31, 17), (1, 20)])
@pytest.mark.parametrize("pitch", [(0.1, 0.1), (0.05, 0.08)])
@pytest.mark.parametrize("sigmas", [(0.05, 0.05), (0.02, 0.07)])
def test_closed_form_of_white_errors_is_exact(shape, pitch, sigmas):
    """Against the sum over every single slope error, solved one by one; slopes in x and y may differ in sigma."""
    unit = np.eye(2 * shape[0] * shape[1]).reshape(-1, *shape, 2) * np.array(sigmas)
    depth = depth_from_gradients(unit, mm_per_px=pitch).astype(np.float64)
    found = depth_sigma_from_gradients_sigma(np.broadcast_to(sigmas, (*shape, 2)), mm_per_px=pitch)
    assert found == pytest.approx(np.sqrt(np.sum(depth**2, axis=0)), rel=1e-4)


@pytest.mark.parametrize(
    ("anchored", "length", "share"),
    [(False, 0, 0.0), (False, 3, 0.3), pytest.param(True, 10, 0.5, marks=pytest.mark.slow)],
)
def test_agrees_with_monte_carlo_weighted_anchored_and_correlated(anchored, length, share):
    sigma, weights, anchor = uneven()
    arguments = {"weights": weights, "anchor": anchor if anchored else None}
    expected = monte_carlo(sigma, length, share, **arguments)
    found = depth_sigma_from_gradients_sigma(
        sigma, mm_per_px=PITCH, correlation_px=length, correlated_share=share, probes=200, **arguments
    )
    off = deviation(found, expected)
    assert np.median(off) < 0.1
    assert np.mean(off < 0.25) > 0.93


LEFT_TOP = np.arange(SHAPE[0])[:, None] + np.arange(SHAPE[1]) < 40  # which pixels are untouched


@pytest.mark.parametrize(
    "arguments", [{"level": "slope"}, {"zero": LEFT_TOP}, {"zero": LEFT_TOP, "level": "plane"}]
)
def test_follows_the_zero_reference_and_the_level(arguments):
    sigma, weights, _ = uneven()
    expected = monte_carlo(sigma, 0, 0.0, weights=weights, **arguments)
    found = depth_sigma_from_gradients_sigma(sigma, mm_per_px=PITCH, weights=weights, probes=200, **arguments)
    assert np.median(deviation(found, expected)) < 0.15


def test_scales_with_the_slope_errors_and_repeats():
    sigma, weights, anchor = uneven()
    arguments = {"mm_per_px": PITCH, "weights": weights, "anchor": anchor, "correlation_px": 8}
    once = depth_sigma_from_gradients_sigma(sigma, **arguments)
    assert np.array_equal(once, depth_sigma_from_gradients_sigma(sigma, **arguments))
    assert depth_sigma_from_gradients_sigma(3 * sigma, **arguments) == pytest.approx(3 * once, rel=1e-3)


def test_patches_of_bad_slopes_that_an_anchor_holds():
    """There the anchor holds each pixel for itself, which blocks of 2 pixels and more cannot see."""
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    inner, sigma = np.zeros(SHAPE, dtype=bool), np.full((*SHAPE, 2), 0.05)
    for row, col, size in ((20, 25, 0.3), (50, 30, 0.5), (35, 70, 0.7)):
        away = np.hypot(rows - row, cols - col)
        sigma[away < 12] = size
        inner |= away < 9
    arguments = {"weights": (0.05 / sigma[..., 0]) ** 2, "anchor": np.full(SHAPE, 1e-2)}
    expected = monte_carlo(sigma, 0, 0.0, **arguments)
    got = depth_sigma_from_gradients_sigma(sigma, mm_per_px=PITCH, **arguments)
    assert np.median(got[inner] / expected[inner]) == pytest.approx(1, abs=0.1)
    assert np.quantile(deviation(got, expected), 0.95) < 0.25


def test_odd_sizes_and_masks():
    sigma = np.full((37, 51, 2), 0.05)
    mask = np.zeros((37, 51), dtype=bool)
    mask[3:30, 5:47] = True
    found = depth_sigma_from_gradients_sigma(sigma, mm_per_px=PITCH, mask=mask)
    assert found.shape == (37, 51)
    assert np.all(np.isfinite(found))
    assert found[mask].min() > 0


def test_prepared_once_gives_the_same_and_keeps_nothing():
    sigma, weights, anchor = uneven()
    prepared = DepthSigma(SHAPE, mm_per_px=PITCH, correlation_px=8)
    first = prepared(sigma, weights=weights, anchor=anchor)
    prepared(2 * sigma, weights=weights**2, level="plane")
    assert np.array_equal(prepared(sigma, weights=weights, anchor=anchor), first)
    arguments = {"mm_per_px": PITCH, "weights": weights, "anchor": anchor, "correlation_px": 8}
    assert np.array_equal(depth_sigma_from_gradients_sigma(sigma, **arguments), first)
    assert prepared(sigma[..., 0], weights=weights, anchor=anchor) == pytest.approx(first, rel=1e-4)


def test_threads_share_a_prepared_one():
    sigma, weights, anchor = uneven()
    prepared = DepthSigma(SHAPE, mm_per_px=PITCH, correlation_px=8)
    jobs = [k % 3 + 1 for k in range(12)]
    alone = {k: prepared(k * sigma, weights=weights**k, anchor=anchor) for k in (1, 2, 3)}
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda k: prepared(k * sigma, weights=weights**k, anchor=anchor), jobs))
    assert all(np.array_equal(f, alone[k]) for f, k in zip(found, jobs))


def test_default_probes_meet_monte_carlo():
    """What the frame of a Reconstructor gets: anchored off a contact, correlated errors, 32 probes."""
    sigma, weights, anchor = uneven()
    expected = monte_carlo(sigma, 10, 0.5, count=250, weights=weights, anchor=anchor)
    prepared = DepthSigma(SHAPE, mm_per_px=PITCH, correlation_px=10)
    off = deviation(prepared(sigma, weights=weights, anchor=anchor), expected)
    assert np.median(off) < 0.1
    assert np.mean(off < 0.25) > 0.9


def test_a_hole_without_any_slope_follows_its_fill():
    """Monte Carlo through the door, which fills slopes of weight 0 from their neighbors."""
    sigma = np.full((*SHAPE, 2), 0.05)
    weights = np.ones(SHAPE)
    weights[20:50, 30:70] = 0
    expected = monte_carlo(sigma, 10, 0.5, weights=weights)
    off = deviation(DepthSigma(SHAPE, mm_per_px=PITCH, correlation_px=10)(sigma, weights=weights), expected)
    assert np.median(off) < 0.16
    assert np.median(off[20:50, 30:70]) < 0.22


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"gradients_sigma": np.ones((4, 5))}, r"gradients_sigma of shape \(H, W, 2\), got \(4, 5\)"),
        ({"gradients_sigma": np.zeros((4, 5, 2))}, "Expected gradients_sigma > 0, got 0"),
        ({"probes": 1}, "Expected probes between 2 and 10000"),
        ({"gradients_sigma": np.ones((0, 5, 2))}, "Expected gradients_sigma of some pixels"),
        ({"correlation_px": -1.0}, "Expected correlation_px between 0 and"),
        ({"correlation_px": 3.0, "correlated_share": 1.5}, "Expected correlated_share between 0 and 1"),
        ({"correlated_share": 1.5}, "Expected correlated_share between 0 and 1"),
        ({"probes": "a"}, "Expected probes as a number"),
        ({"rng": 3}, "Expected rng as Generator, got int"),
        ({"level": "foo"}, "Expected level as None, 'slope', 'plane' or 'quadratic', got 'foo'"),
        ({"weights": np.ones((2, 4, 5))}, r"weights of shape \(4, 5\), got \(2, 4, 5\)"),
        ({"weights": np.zeros((4, 5))}, "Expected weights with at least one value > 0"),
    ],
)
@pytest.mark.parametrize("zero", ["border", "mean"])
def test_bad_input_is_refused(change, text, zero):
    """Whether the answer has a closed form, which needs no probes, or not."""
    arguments = {"gradients_sigma": np.ones((4, 5, 2)), "mm_per_px": 0.1, "zero": zero} | change
    with pytest.raises((ValueError, TypeError), match=text):
        depth_sigma_from_gradients_sigma(arguments.pop("gradients_sigma"), **arguments)


@pytest.mark.parametrize("shape", [(96, 128), (120, 160), (150, 200), (180, 240)])
def test_about_as_many_blocks_at_every_size(shape):
    """Between the largest and the smallest blocks, their count is what costs, and what the draws' error hangs on."""
    assert 1600 < shape[0] * shape[1] / DepthSigma(shape, mm_per_px=0.1).block ** 2 < 3100


def test_a_column_of_pixels():
    sigma = DepthSigma((40, 1), mm_per_px=0.1, probes=400)(np.full((40, 1), 0.05))
    exact = depth_sigma_from_gradients_sigma(np.full((40, 1, 2), 0.05), mm_per_px=0.1)
    assert np.median(deviation(sigma, exact)) < 0.15


@pytest.mark.slow
@pytest.mark.parametrize("anchored", [False, True])
def test_deviation_against_a_regions_mean_is_that_of_monte_carlo(anchored):
    """What all pixels of a region share is not in it: much smaller there than against zero."""
    sigma = np.full((*SHAPE, 2), 0.05, dtype=np.float32)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    region = np.hypot(x - 40, y - 30) < 14
    arguments = {"anchor": np.where(np.hypot(x - 40, y - 30) > 24, 1e-2, 0)} if anchored else {}
    rng = np.random.default_rng(1)
    errors = 0.05 * np.stack([correlated(SHAPE, 6, rng) for _ in range(300)])
    depth = depth_from_gradients(errors, mm_per_px=PITCH, **arguments)
    apart = depth - depth[:, region].mean(axis=1)[:, None, None]
    expected = np.sqrt(np.mean(np.square(apart, dtype=np.float64), axis=0))
    prepared = DepthSigma(SHAPE, mm_per_px=PITCH, correlation_px=6, correlated_share=1.0, probes=200)
    found = prepared(sigma, against=region, **arguments)
    # Without an anchor the far gel swings with every probe: 200 of them leave more.
    assert np.median(deviation(found, expected)) < (0.08 if anchored else 0.2)
    assert np.median(deviation(found, expected)[region]) < 0.12
    absolute = prepared(sigma, **arguments)
    assert found[region].mean() < (0.8 * absolute[region].mean() if anchored else absolute[region].mean())


def test_a_region_of_no_pixel_or_another_shape_is_refused():
    prepared = DepthSigma(SHAPE, mm_per_px=PITCH)
    with pytest.raises(ValueError, match="at least one True pixel"):
        prepared(np.full(SHAPE, 0.05), against=np.zeros(SHAPE, dtype=bool))
    with pytest.raises(ValueError, match="of shape"):
        prepared(np.full(SHAPE, 0.05), against=np.ones((3, 4), dtype=bool))


SMALL = (4, 6)


def test_rest_is_a_mask_of_the_frame():
    assert checked_rest(None, SMALL) is None
    with pytest.raises(ValueError, match=r"Expected rest as bool of shape \(4, 6\), got float64"):
        checked_rest(np.ones(SMALL), SMALL)
    with pytest.raises(ValueError, match=r"of \(4, 5\)"):
        checked_rest(np.ones((4, 5), bool), SMALL)


def test_one_map_for_both_slopes_stays_one():
    one = np.random.default_rng(0).uniform(0.1, 1, SMALL).astype(np.float32)
    assert checked_sigma(one, SMALL).shape == (*SMALL, 1)
    assert np.array_equal(checked_sigma(np.broadcast_to(one[..., None], (*SMALL, 2)))[..., 0], one)
    assert checked_sigma(np.stack([one, one], axis=-1)).shape == (*SMALL, 2)


def test_without_a_length_nothing_is_correlated():
    assert checked_share(0.0, 0.5) == 0
    assert checked_share(3.0, 0.5) == 0.5


@pytest.mark.parametrize("size", [1, 255, 700])
def test_squares_add_up_within_the_most(size):
    rng = np.random.default_rng(0)
    sigma, depth = rng.random(size).astype(np.float32), rng.normal(0, 2, size).astype(np.float32)
    expected = np.minimum(np.hypot(sigma, 0.3 * depth), 0.8)
    assert_kernel_agrees(sigma_module._add_in_proportion, lambda *_: expected, sigma, depth, 0.3, 0.8)
    assert sigma_module.add_in_proportion(sigma, depth, 0.3, 0.8) is sigma


@pytest.mark.parametrize(("bad", "share"), [(np.nan, 0.1), (np.inf, 0.1), (3e38, 0.1), (0.1, 1e30)])
def test_what_float32_does_not_hold_is_named(bad, share):
    sigma = np.full((2, 300), 0.1, np.float32)
    sigma[1, 120] = bad
    with pytest.raises(ConvergenceError, match="Expected a finite standard deviation of depth"):
        sigma_module.add_in_proportion(sigma, np.ones_like(sigma), share, 1.0)


MIDDLE = (40, 56)


@pytest.fixture(scope="module")
def parts():
    prepared = DepthSigma(MIDDLE, mm_per_px=0.1)
    return prepared, np.full((*MIDDLE, 2), 0.05, dtype=np.float32), {"zero": "mean"}


def test_a_common_gain_moves_only_what_is_apart(parts):
    """Depth of 2 mm on the left and 3 mm on the right: 10 % of all slopes together are 0.05 mm about the mean of 2.5."""
    depth = np.full(MIDDLE, 2.0, dtype=np.float32)
    depth[:, 28:] = 3.0
    region = np.ones(MIDDLE, dtype=bool)
    without, with_gain = (DepthDifference(*parts, depth, gain)(region) for gain in (0.0, 0.1))
    np.testing.assert_allclose(with_gain, np.hypot(without, 0.05), rtol=1e-5)


def test_it_is_that_of_the_prepared_sigma_against_the_region(parts):
    region = np.zeros(MIDDLE, dtype=bool)
    region[10:20, 10:30] = True
    depth = np.zeros(MIDDLE, dtype=np.float32)
    found = DepthDifference(*parts, depth, 0.3)(region)
    np.testing.assert_array_equal(found, parts[0](parts[1], zero="mean", against=region))
    assert found[region].mean() < 0.8 * found[30:, 45:].mean()  # known best where it is measured against
