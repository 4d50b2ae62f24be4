"""Compression: noise of single pixels beyond the usual, and the blocks of a JPEG at whatever place they are cut."""

import cv2
import numpy as np
import pytest

from gelform.confidence import compression
from kernel_agreement import assert_kernel_agrees


def noisy(levels, seed=0):
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:120, :170]
    scene = 110 + 40 * np.sin(x / 30)[..., None] + 30 * np.cos(y / 25)[..., None] * np.array([1, 0.5, -1])
    rest = np.clip(scene, 0, 255).astype(np.uint8)
    image = np.clip(scene + rng.normal(0, levels, scene.shape), 0, 255).astype(np.uint8)
    return image, rest


@pytest.mark.parametrize("levels", [3.0, 6.0])
def test_the_noise_of_single_pixels_beyond_the_usual(levels):
    found = compression.added_levels(*noisy(levels), usual_levels=1.0)
    assert found == pytest.approx(np.sqrt(levels**2 - 1.5**2), rel=0.1)


def test_the_usual_noise_adds_nothing():
    assert compression.added_levels(*noisy(1.5), usual_levels=1.5) == 0
    assert compression.added_levels(*noisy(9.0), usual_levels=np.inf) == 0


@pytest.mark.parametrize("cut", [0, 3, 6])
def test_blocks_of_a_jpeg_wherever_it_is_cut(cut):
    image, rest = noisy(3.0)
    _, bad = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 10])
    _, good = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 95])
    levels = [
        compression.added_levels(
            np.ascontiguousarray(cv2.imdecode(one, cv2.IMREAD_COLOR)[:, cut:]),
            np.ascontiguousarray(rest[:, cut:]),
            3.0,
        )
        for one in (bad, good)
    ]
    assert levels[0] > 1
    assert levels[1] == 0


def test_blocks_that_are_rounded_apart_add_their_deviation():
    """Each block of 8 pixels is off by 2 levels RMS; the noise in it is the usual 1.5."""
    _, rest = noisy(0.0)
    rng = np.random.default_rng(3)
    off = np.kron(rng.normal(0, 2, (15, 22, 3)), np.ones((8, 8, 1)))[:120, :170]
    image = np.clip(np.rint(rest + off + rng.normal(0, 1.5, rest.shape)), 0, 255).astype(np.uint8)
    assert compression.added_levels(image, rest, 1.5) == pytest.approx(2.0, rel=0.25)


def test_images_too_narrow_for_blocks():
    image, rest = noisy(9.0)
    assert compression.added_levels(image[:, :20].copy(), rest[:, :20].copy(), 1.0) == 0


@pytest.mark.parametrize("width", [9, 21, 50])
def test_jumps_agree_with_numpy(width):
    rng = np.random.default_rng(1)
    image, rest = rng.integers(0, 256, (2, 9, width, 3), dtype=np.uint8)

    def by_numpy(image, rest, work, medians, step):
        apart = image[::step].astype(int) - rest[::step]
        jumps = np.abs(np.diff(apart, axis=1)).mean(axis=(0, 2))
        return np.median(jumps[: (width - 1) // 8 * 8].reshape(-1, 8), axis=0)

    work, medians = np.empty(4 * width, np.int32), np.empty(8, np.float32)
    assert_kernel_agrees(compression._column_jumps, by_numpy, image, rest, work, medians, 4)
