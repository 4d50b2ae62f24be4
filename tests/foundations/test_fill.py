"""Unknown pixels are filled from the known ones, which stay."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.foundations import fill
from gelform.foundations.fill import fill_unknown
from kernel_agreement import assert_kernel_agrees
from scenes import polynomial, scene


class TestFill:
    @settings(max_examples=30, deadline=None)
    @given(seed=st.integers(0, 10**6))
    def test_unknown_values_have_no_influence_and_known_ones_stay(self, seed):
        rng = np.random.default_rng(seed)
        values = rng.standard_normal((11, 14, 2)).astype(np.float32)
        known, given_values = rng.uniform(size=(11, 14)) > 0.6, values.copy()
        known[5, 5] = True
        other = np.where(known[..., None], values, 1e3 * rng.standard_normal(values.shape)).astype(np.float32)
        filled = fill_unknown(values, known)
        assert np.array_equal(values, given_values)
        assert np.array_equal(filled, fill_unknown(other, known))
        assert np.array_equal(filled[known], values[known])
        assert filled.min() >= values[known].min() - 1e-5
        assert filled.max() <= values[known].max() + 1e-5

    def test_scattered_holes_in_a_plane_are_filled_closely(self):
        plane, _, _ = scene(polynomial({(1, 0): 1.0, (0, 1): -0.5}), (60, 80), 0.1)
        known = np.random.default_rng(1).uniform(size=plane.shape) > 0.3
        error = np.abs(fill_unknown(plane[..., None], known)[..., 0] - plane)[2:-2, 2:-2]
        assert error.max() < 0.12
        assert np.sqrt(np.mean(error[~known[2:-2, 2:-2]] ** 2)) < 0.02

    def test_a_hole_is_filled_between_its_sides(self):
        x = np.linspace(0, 1, 64)[None, :, None] * np.ones((64, 1, 1))
        known = np.ones((64, 64), dtype=bool)
        known[20:44, 20:44] = False
        filled = fill_unknown(x, known)[..., 0]
        assert np.max(np.abs(filled - x[..., 0])) < 0.1
        assert np.all(np.diff(filled[32]) > -1e-3)

    def test_one_known_pixel_fills_all(self):
        known = np.zeros((9, 13), dtype=bool)
        known[3, 7] = True
        values = np.zeros((9, 13, 2))
        values[3, 7] = (2.0, -1.0)
        assert fill_unknown(values, known) == pytest.approx(np.broadcast_to([2.0, -1.0], (9, 13, 2)))

    def test_nothing_known_and_wrong_shapes_are_refused(self):
        with pytest.raises(ValueError, match="Expected known with at least one True pixel"):
            fill_unknown(np.zeros((3, 4, 2)), np.zeros((3, 4), dtype=bool))
        with pytest.raises(ValueError, match=r"Expected values of shape \(H, W, C\), got \(3, 4\)"):
            fill_unknown(np.zeros((3, 4)), np.ones((3, 4), dtype=bool))


def mean_of_known_2x2(values, known, coarse, coarse_known):
    rows, columns, channels = coarse.shape
    padding = ((0, 2 * rows - known.shape[0]), (0, 2 * columns - known.shape[1]))
    here = np.pad(known, padding)
    kept = np.where(here[..., None], np.pad(values, (*padding, (0, 0))), 0)
    count = here.reshape(rows, 2, columns, 2).sum(axis=(1, 3))
    total = kept.reshape(rows, 2, columns, 2, channels).sum(axis=(1, 3))
    return total / np.maximum(count, 1)[..., None], count > 0


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 12)])
def test_the_kernel_of_coarser_levels_agrees_with_numpy(shape):
    rng = np.random.default_rng(0)
    values = rng.normal(size=(*shape, 3)).astype(np.float32)
    coarse = (shape[0] + 1) // 2, (shape[1] + 1) // 2
    assert_kernel_agrees(
        fill._coarser_known, mean_of_known_2x2, values, rng.uniform(size=shape) > 0.5,
        np.empty((*coarse, 3), np.float32), np.empty(coarse, bool),
    )  # fmt: skip


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (9, 12)])
def test_the_kernel_of_filling_agrees_with_numpy(shape):
    rng = np.random.default_rng(0)
    coarse = rng.normal(size=((shape[0] + 1) // 2, (shape[1] + 1) // 2, 2)).astype(np.float32)
    known = rng.uniform(size=shape) > 0.5

    def weights(pixels, count):
        """Of each coarse pixel for each pixel: 3/4 of the nearest, 1/4 of the next."""
        table = np.zeros((pixels, count))
        for pixel in range(pixels):
            table[pixel, pixel // 2] += 0.75
            table[pixel, min(max(pixel // 2 + 2 * (pixel % 2) - 1, 0), count - 1)] += 0.25
        return table

    def numpy_fill(coarse, values, known, sweeps):
        rows, columns = weights(shape[0], coarse.shape[0]), weights(shape[1], coarse.shape[1])
        fine = np.einsum("ia,jb,abc->ijc", rows, columns, coarse)
        filled = np.where(known[..., None], values, fine)
        holes = [tuple(hole) for hole in np.argwhere(~known)]
        for sweep in range(sweeps):
            for i, j in holes if sweep % 2 == 0 else holes[::-1]:
                around = [(i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)]
                near = [filled[a] for a in around if 0 <= a[0] < shape[0] and 0 <= a[1] < shape[1]]
                filled[i, j] = np.mean(near, axis=0) if near else filled[i, j]
        return filled

    values = rng.normal(size=(*shape, 2)).astype(np.float32)
    assert_kernel_agrees(fill._fill_from_coarser, numpy_fill, coarse, values, known, 2)
