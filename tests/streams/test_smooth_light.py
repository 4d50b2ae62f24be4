"""Smooth light over the image: found to a part of its noise, not bent by what touches."""

import numpy as np

from gelform.streams.smooth_light import SmoothLight, block_means

BLOCKS = (17, 22)


def rest_levels():
    y, x = np.mgrid[: BLOCKS[0], : BLOCKS[1]] / BLOCKS[1]
    return np.stack([60 + 90 * x, 120 - 40 * y, 80 + 60 * x * y], axis=-1).astype(np.float32)


def drifted(rest, noise=0.0, seed=0):
    """The light of a cubic, different in each channel; its truth."""
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in BLOCKS)
    x, y = np.meshgrid(x, y)
    light = 1 + np.stack([0.04 + 0.02 * x, 0.03 * y - 0.01 * x**2, -0.02 * x * y**2 + 0.01 * x**3], axis=-1)
    return (rest * light + np.random.default_rng(seed).normal(0, noise, rest.shape)).astype(np.float32), light


def fitted(seen, rest, free, rounds=8):
    light = SmoothLight(BLOCKS)
    for _ in range(rounds):
        light.fit(seen, rest, free)
    return light


def test_a_cubic_is_found_exactly():
    rest = rest_levels()
    seen, truth = drifted(rest)
    light = fitted(seen, rest, np.ones(BLOCKS, bool))
    np.testing.assert_allclose(light.at(BLOCKS), truth, atol=1e-4)


def test_pixels_and_blocks_are_of_one_light():
    """A block's light is the mean of its pixels': places are counted alike."""
    rest = rest_levels()
    light = fitted(drifted(rest)[0], rest, np.ones(BLOCKS, bool))
    pixels = light.at((BLOCKS[0] * 8, BLOCKS[1] * 8))
    np.testing.assert_allclose(block_means(pixels, 8), light.at(BLOCKS), atol=2e-4)


def test_what_touches_does_not_bend_the_light():
    """A touched part that nobody named is an outlier; one that was named does not count at all."""
    rest = rest_levels()
    seen, truth = drifted(rest, noise=0.1)
    seen[5:9, 4:9] *= [1.3, 0.8, 1.1]
    unnamed = fitted(seen, rest, np.ones(BLOCKS, bool))
    np.testing.assert_allclose(unnamed.at(BLOCKS), truth, atol=2e-3)
    free = np.ones(BLOCKS, bool)
    free[:, 8:] = False
    named = fitted(seen, rest, free, rounds=1)
    assert np.abs(named.at(BLOCKS) - 1).max() < 0.2  # where nothing is free it is not thrown about
