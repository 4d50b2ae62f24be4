"""From pixels to blocks and back: the kernels against plain numpy, and what an anchor does."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, map_coordinates

from gelform.depth.integrate import depth_from_gradients
from gelform.depth.sigma import blocks
from gelform.depth.sigma.blocks import LINES, ErrorParts, sigma_of_pixels
from gelform.depth.sigma.sigma import DepthSigma
from kernel_agreement import assert_kernel_agrees

FLOOR = 1e-3


@pytest.fixture
def maps():
    """Sigma, weights (some under the floor), mask, anchor, zero pixels and rest of a frame that no block divides."""
    rng = np.random.default_rng(4)
    shape = (11, 22)
    return (
        rng.uniform(0.02, 0.2, (*shape, 2)).astype(np.float32),
        np.where(rng.uniform(size=shape) < 0.2, 1e-4, rng.uniform(0.1, 1, shape)).astype(np.float32),
        rng.uniform(size=shape) < 0.9,
        rng.uniform(0, 0.1, shape).astype(np.float32),
        rng.uniform(size=shape) < 0.5,
        rng.uniform(size=shape) < 0.6,
    )


def sums_by_numpy(sigma, weights, mask, anchor, region, rest, floor, block, work, sums):
    mask = np.ones(weights.shape, bool) if mask is None else mask
    region = 0 * mask if region is None else region
    weight = np.where(weights >= floor, mask * weights, 0)
    planes = [mask, weight, weight**2, mask * anchor, mask & region, 0 * mask if rest is None else rest]
    for slope in range(sigma.shape[2]):
        planes += [weight * sigma[..., slope], (weight * sigma[..., slope]) ** 2]
    for plane, out in zip(planes, sums):
        for row, column in np.ndindex(out.shape):
            rows, columns = (slice(k * block, (k + 1) * block) for k in (row, column))
            out[row, column] = np.sum(plane[rows, columns], dtype=np.float64)
    return sums


@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("block", [4, 6])
@pytest.mark.parametrize("slopes", [1, 2])
def test_sums_of_blocks(maps, slopes, block, whole):
    """Whole frames have neither mask nor zero pixels nor rest."""
    sigma, weights, mask, anchor, region, rest = maps
    sigma = np.ascontiguousarray(sigma[..., :slopes])
    chosen = (None, anchor, None, None) if whole else (mask, anchor, region, rest)
    planes = 6 + 2 * slopes
    work, sums = np.empty((planes, 22), dtype=np.float32), np.empty((planes, 3, 6), dtype=np.float32)
    assert_kernel_agrees(blocks._sum_blocks, sums_by_numpy, sigma, weights, *chosen, FLOOR, block, work, sums)


def errors_by_numpy(sums, weight, white, common, usual, block, share, rest_share, power, h, w):
    inside, total, square, _, _, rest = sums[:6].astype(np.float64)
    rows, columns = (np.clip(n - block * np.arange(m), 0, block) for n, m in zip((h, w), inside.shape))
    pixels = rows[:, None] * columns
    rest = rest / np.maximum(pixels, 1)
    moved, squares = sums[6::2].astype(np.float64), sums[7::2].astype(np.float64)
    most = np.maximum(total, 1e-30)
    uneven = np.sqrt(inside * square) / most
    uneven[uneven == 0] = 1
    whites = (
        np.sqrt(squares) * uneven / most * np.sqrt((1 - rest) * (1 - share) + rest * (1 - rest_share) * power)
    )
    usual = moved / most
    commons = usual * np.sqrt((1 - rest) * share + rest * rest_share)
    both = [np.stack([v[0], v[-1]], axis=-1) for v in (whites, commons, usual)]
    return total / np.maximum(inside, 1), *both


@pytest.mark.parametrize("slopes", [1, 2])
def test_errors_of_blocks(maps, slopes):
    sums = np.empty((6 + 2 * slopes, 3, 7), dtype=np.float32)
    work = np.empty((len(sums), 22), dtype=np.float32)
    sigma = np.ascontiguousarray(maps[0][..., :slopes])
    blocks._sum_blocks(sigma, *maps[1:], FLOOR, 4, work, sums)
    outputs = np.empty((3, 7), np.float32), *(np.empty((3, 7, 2), np.float32) for _ in range(3))
    assert_kernel_agrees(blocks._errors_of_blocks, errors_by_numpy, sums, *outputs, 4, 0.7, 0.1, 2.5, 11, 22)


@pytest.mark.parametrize("hole", [False, True])
def test_the_variance_of_depths_is_averaged_inside_the_mask(hole):
    rng = np.random.default_rng(6)
    depths, mask = rng.normal(size=(9, 12, 20)).astype(np.float32), np.ones((9, 12), bool)
    mask[3:6, 4:9] = not hole
    squares = np.where(mask, np.mean(depths.astype(float) ** 2, axis=-1), 0)
    smooth, inside = (gaussian_filter(v, 0.6, mode="mirror", radius=3) for v in (squares, mask.astype(float)))
    expected = np.where(inside > 1e-5, smooth / np.maximum(inside, 1e-6), 0)
    arguments = depths, mask, blocks.blur_taps(0.6), np.empty(400, np.float32), np.empty((9, 12), np.float32)
    assert_kernel_agrees(blocks._variance_of_depths, lambda *_: expected, *arguments)


def sigma_by_numpy(variance, sigma, rest, white, within, fading, weights, floor, anchor, block, work, out):
    trusted = (weights >= floor).astype(np.float64)
    still = np.zeros(out.shape, bool) if rest is None else rest
    sigma = sigma * np.where(still, white[1], white[0])[..., None].astype(np.float64)
    places = [
        np.clip((np.arange(n) + 0.5) / block - 0.5, 0, m - 1) for n, m in zip(out.shape, variance.shape)
    ]
    variance = map_coordinates(variance.astype(float), np.meshgrid(*places, indexing="ij"), order=1)
    anchor = np.zeros(out.shape) if anchor is None else anchor
    w = np.pad(np.maximum(weights, floor).astype(np.float64), 1, mode="edge")
    x = 9 * anchor / around_of_padded(w)
    e = w[1:-1, 1:-1]
    ties = 2 * e * sum(a / (e + a) for a in (w[:-2, 1:-1], w[2:, 1:-1], w[1:-1, :-2], w[1:-1, 2:]))
    followed = 4 / (4 + x) * ties / (ties + anchor)
    total = followed**2 * variance
    faded = (1 + fading[0] * x) / np.polyval([*fading[:0:-1], 1], x)
    for slope, share in enumerate(within if sigma.shape[2] == 2 else [within.sum()]):
        usual = around(trusted) / (around(trusted / sigma[..., slope]) + 1e-30)
        total += faded * share * usual**2
    return np.sqrt(total)


def around(values):
    """Sum over 3x3 pixels, beyond the border 0."""
    return around_of_padded(np.pad(values, 1))


def around_of_padded(padded):
    height, width = padded.shape[0] - 2, padded.shape[1] - 2
    return sum(padded[i : i + height, j : j + width] for i in range(3) for j in range(3))


@pytest.mark.parametrize("anchored", [False, True])
@pytest.mark.parametrize("slopes", [1, 2])
def test_sigma_of_pixels_is_what_numpy_says(maps, slopes, anchored):
    sigma = np.ascontiguousarray(maps[0][..., :slopes])
    variance = np.random.default_rng(5).uniform(0, 1e-3, (3, 7)).astype(np.float32)
    within, white = np.array([[0.3, 0.2], [0.5, 0.8]], dtype=np.float32)
    work, out = np.empty((LINES, 24), dtype=np.float32), np.empty((11, 22), dtype=np.float32)
    anchor, rest = (maps[3], maps[5]) if anchored else (None, None)
    fading = np.array([5.7, 11.9, 14.0, 1.6], dtype=np.float32)
    arguments = variance, sigma, rest, white, within, fading, maps[1], FLOOR, anchor, 4, work, out
    assert_kernel_agrees(blocks._sigma_of_pixels, sigma_by_numpy, *arguments)


@pytest.mark.parametrize("anchor", [0.0, 0.05])
def test_an_anchored_pixel_follows_its_neighbors_by_its_ties(anchor):
    weights, hold = np.ones((3, 3), dtype=np.float32), np.zeros((3, 3), dtype=np.float32)
    weights[1, 1], hold[1, 1] = 0.01, anchor
    sigma = np.full((3, 3, 2), 0.1, dtype=np.float32)
    within = np.array([0.3, 0.2], dtype=np.float32)
    variance = np.full((1, 1), 0.04, dtype=np.float32)
    settings = None, np.ones(2, np.float32), within, np.zeros(4, np.float32)
    out = sigma_of_pixels(variance, sigma, *settings, weights, np.float32(FLOOR), hold, 3)
    assert out[0, 0] == pytest.approx(np.sqrt(0.04 + 0.5 * 0.1**2), rel=1e-5)
    ties, x = 4 * 2 * 0.01 / 1.01, 9 * anchor / 8.01
    assert out[1, 1] ** 2 == pytest.approx(
        0.04 * (ties / (ties + anchor) * 4 / (4 + x)) ** 2 + 0.5 * 0.1**2, rel=1e-5
    )


def blocks_of(sigma, mask, rest=None, block=4, share=0.5, rest_share=0.0):
    """Blocks of a frame of equal weights without an anchor."""
    ones = np.ones(mask.shape, np.float32)
    parts = ErrorParts(block, share, rest_share, 0.0)
    return blocks.Blocks(sigma, ones, mask, None, np.ones_like(mask), rest, np.float32(FLOOR), parts)


def test_blocks_take_part_in_rest_by_their_pixels():
    rest = np.zeros((6, 9), bool)
    rest[:, :4] = True
    one = blocks_of(np.ones((6, 9, 1), np.float32), np.ones_like(rest), rest, block=3, share=0.75)
    assert 3 * one.white[0, :3, 0] == pytest.approx(np.sqrt([1, 0.5, 0.25]), rel=1e-6)
    assert one.common[0, :3, 0] == pytest.approx(np.sqrt([0, 0.5, 0.75]), rel=1e-6)


def test_blocks_of_equal_pixels():
    """Independent errors are averaged away by the pixels inside, common ones are not; the counts are odd."""
    mask = np.zeros((11, 22), dtype=bool)
    mask[1:10, 3:19] = True
    sigma = np.full((11, 22, 1), 0.05, dtype=np.float32)
    one = blocks_of(sigma, mask, share=0.5)
    padded = np.zeros((12, 28), dtype=bool)
    padded[:11, :22] = mask
    count = padded.reshape(3, 4, 7, 4).sum(axis=(1, 3))
    np.testing.assert_array_equal(one.mask, count > 0)
    np.testing.assert_array_equal(one.region, count)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(one.common[count > 0], 0.05 * half, rtol=1e-6)
    np.testing.assert_allclose(
        one.white[..., 1][count > 0], 0.05 * half / np.sqrt(count[count > 0]), rtol=1e-6
    )
    assert blocks.block_rows_and_columns((20, 17), 3) == (7, 7)
    assert blocks.block_rows_and_columns((24, 25), 3) == (9, 9)


SHAPE, PITCH, SIGMA = (72, 96), 0.2, 0.05
REST = np.hypot(*(np.mgrid[: SHAPE[0], : SHAPE[1]] - np.array([36, 48])[:, None, None])) > 20
ANCHOR = np.where(REST, 1e-2, 0)
SETTINGS = {"correlation_px": 10.0, "correlated_share": 0.7}


def errors(length_px, rng):
    """Slopes (H, W, 2) of variance 1: noise blurred over a short length at rest, over a long one in the contact."""
    noise = rng.standard_normal((*SHAPE, 2))
    if length_px == 0:
        return noise
    blur = length_px / np.sqrt(2)
    return gaussian_filter(noise, (blur, blur, 0), mode="wrap") * (2 * np.sqrt(np.pi) * blur)


@pytest.mark.slow
@pytest.mark.parametrize("length_px", [0.0, 1.0, 1.8])
def test_short_correlations_at_rest_meet_monte_carlo(length_px):
    rng = np.random.default_rng(1)
    slopes = SIGMA * np.stack(
        [np.where(REST[..., None], errors(length_px, rng), errors(10.0, rng)) for _ in range(250)]
    )
    depth = depth_from_gradients(slopes, mm_per_px=PITCH, anchor=ANCHOR)
    expected = np.sqrt(np.mean(np.square(depth, dtype=np.float64), axis=0))
    prepared = DepthSigma(
        SHAPE, mm_per_px=PITCH, correlation_px=10.0, correlated_share=1.0, rest_correlated_share=0.0,
        rest_correlation_px=length_px,
    )  # fmt: skip
    found = prepared(np.full(SHAPE, SIGMA), anchor=ANCHOR, at_rest=REST)
    off = np.abs(found / expected - 1)
    assert np.median(off[REST]) < 0.15
    assert np.median(off[~REST]) < 0.15


def test_without_rest_errors_are_as_in_contact_everywhere():
    sigma = np.full(SHAPE, SIGMA)
    plain = DepthSigma(SHAPE, mm_per_px=PITCH, **SETTINGS)
    told = DepthSigma(SHAPE, mm_per_px=PITCH, rest_correlated_share=0.1, rest_correlation_px=1.5, **SETTINGS)
    assert np.array_equal(told(sigma, anchor=ANCHOR), plain(sigma, anchor=ANCHOR))
    nowhere = told(sigma, anchor=ANCHOR, at_rest=np.zeros(SHAPE, bool))
    assert nowhere == pytest.approx(plain(sigma, anchor=ANCHOR), rel=1e-5)
    by_default = plain(sigma, anchor=ANCHOR, at_rest=REST)
    assert by_default == pytest.approx(plain(sigma, anchor=ANCHOR), rel=1e-5)


def test_shares_of_the_errors():
    parts = ErrorParts(3, 0.75, 0.0, 0.0)
    assert parts.of_blocks == (0.75, 0.0, 1.0)
    assert parts.within_blocks == pytest.approx([0.5, 1.0])
    assert (ErrorParts(3, 1.0, 1.0, 0.0).within_blocks > 0).all()
    blurred = ErrorParts(3, 0.75, 0.0, 1.5)
    assert blurred.of_blocks[2] > 1 > blurred.within_blocks[1]
