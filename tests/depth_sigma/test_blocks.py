"""From pixels to blocks and back: the kernels against plain numpy, and what an anchor does."""

from __future__ import annotations

import numpy as np
import pytest

from gelform.depth_sigma import blocks
from gelform.depth_sigma.blocks import LINES, sigma_of_pixels
from kernel_agreement import assert_kernel_agrees

FLOOR = 1e-3


@pytest.fixture
def maps():
    """Sigma, weights (some under the floor), mask, anchor and zero pixels of a frame that no block divides."""
    rng = np.random.default_rng(4)
    shape = (11, 22)
    return (
        rng.uniform(0.02, 0.2, (*shape, 2)).astype(np.float32),
        np.where(rng.uniform(size=shape) < 0.2, 1e-4, rng.uniform(0.1, 1, shape)).astype(np.float32),
        rng.uniform(size=shape) < 0.9,
        rng.uniform(0, 0.1, shape).astype(np.float32),
        rng.uniform(size=shape) < 0.5,
    )


def sums_by_numpy(sigma, weights, mask, anchor, region, floor, block, work, sums):
    weight = np.where(weights >= floor, mask * weights, 0)
    planes = [mask, weight, weight**2, mask * anchor, mask & region]
    for slope in range(sigma.shape[2]):
        planes += [weight * sigma[..., slope], (weight * sigma[..., slope]) ** 2]
    for plane, out in zip(planes, sums):
        for row, column in np.ndindex(out.shape):
            rows, columns = (slice(k * block, (k + 1) * block) for k in (row, column))
            out[row, column] = np.sum(plane[rows, columns], dtype=np.float64)
    return sums


@pytest.mark.parametrize("slopes", [1, 2])
def test_sums_of_blocks(maps, slopes):
    sigma = np.ascontiguousarray(maps[0][..., :slopes])
    planes = 5 + 2 * slopes
    work, sums = np.empty((planes, 22), dtype=np.float32), np.empty((planes, 3, 6), dtype=np.float32)
    assert_kernel_agrees(blocks._sum_blocks, sums_by_numpy, sigma, *maps[1:], FLOOR, 4, work, sums)


def sigma_by_numpy(variance, sigma, within, fading, weights, floor, anchor, work, out):
    trusted = (weights >= floor).astype(np.float64)
    anchor = np.zeros(out.shape) if anchor is None else anchor
    w = np.pad(np.maximum(weights, floor).astype(np.float64), 1, mode="edge")
    x = 9 * anchor / around_of_padded(w)
    e = w[1:-1, 1:-1]
    ties = 2 * e * sum(a / (e + a) for a in (w[:-2, 1:-1], w[2:, 1:-1], w[1:-1, :-2], w[1:-1, 2:]))
    followed = 4 / (4 + x) * ties / (ties + anchor)
    total = followed**2 * variance[: out.shape[0], : out.shape[1]].astype(np.float64)
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
    variance = np.random.default_rng(5).uniform(0, 1e-3, (12, 24)).astype(np.float32)
    within = np.array([0.3, 0.2], dtype=np.float32)
    work, out = np.empty((LINES, 24), dtype=np.float32), np.empty((11, 22), dtype=np.float32)
    anchor = maps[3] if anchored else None
    fading = np.array([5.7, 11.9, 14.0, 1.6], dtype=np.float32)
    arguments = variance, sigma, within, fading, maps[1], FLOOR, anchor, work, out
    assert_kernel_agrees(blocks._sigma_of_pixels, sigma_by_numpy, *arguments)


@pytest.mark.parametrize("anchor", [0.0, 0.05])
def test_an_anchored_pixel_follows_its_neighbours_by_its_ties(anchor):
    weights, hold = np.ones((3, 3), dtype=np.float32), np.zeros((3, 3), dtype=np.float32)
    weights[1, 1], hold[1, 1] = 0.01, anchor
    sigma = np.full((3, 3, 2), 0.1, dtype=np.float32)
    within = np.array([0.3, 0.2], dtype=np.float32)
    variance = np.full((3, 3), 0.04, dtype=np.float32)
    out = sigma_of_pixels(variance, sigma, within, np.zeros(4, np.float32), weights, np.float32(FLOOR), hold)
    assert out[0, 0] == pytest.approx(np.sqrt(0.04 + 0.5 * 0.1**2), rel=1e-5)
    ties, x = 4 * 2 * 0.01 / 1.01, 9 * anchor / 8.01
    assert out[1, 1] ** 2 == pytest.approx(
        0.04 * (ties / (ties + anchor) * 4 / (4 + x)) ** 2 + 0.5 * 0.1**2, rel=1e-5
    )


def test_blocks_of_equal_pixels():
    """Independent errors are averaged away by the pixels inside, common ones are not; the counts are odd."""
    mask = np.zeros((11, 22), dtype=bool)
    mask[1:10, 3:19] = True
    sigma = np.full((11, 22, 1), 0.05, dtype=np.float32)
    one = blocks.Blocks(
        sigma, np.ones((11, 22), np.float32), mask, None, np.ones_like(mask), np.float32(FLOOR), 4,
        (np.ones((1, 1, 1), np.float32),) * 2,
    )  # fmt: skip
    padded = np.zeros((12, 28), dtype=bool)
    padded[:11, :22] = mask
    count = padded.reshape(3, 4, 7, 4).sum(axis=(1, 3))
    np.testing.assert_array_equal(one.mask, count > 0)
    np.testing.assert_array_equal(one.region, count)
    np.testing.assert_allclose(one.common[count > 0], 0.05, rtol=1e-6)
    np.testing.assert_allclose(one.white[..., 1][count > 0], 0.05 / np.sqrt(count[count > 0]), rtol=1e-6)
    assert blocks.block_rows_and_columns((20, 17), 3) == (7, 7)
    assert blocks.block_rows_and_columns((24, 25), 3) == (9, 9)
