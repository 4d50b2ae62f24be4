"""Medians without sorting are those of numpy, to the last bit.

Unknown pixels are filled from the known ones, which stay.

Modified Bessel functions against scipy.

Covariances of information matrices, and what nothing determines; the same on every processor.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import special

from gelform.foundations import filters
from gelform.foundations.filters import MEDIAN_SAMPLES, bessel_k, fill_unknown, lattice_step, medians_where
from gelform.foundations.information import determined_by
from kernel_agreement import assert_kernel_agrees


def by_numpy(values, chosen, step):
    where = np.ones(values.shape[:2], bool) if chosen is None else chosen
    picked = values[::step, ::step][where[::step, ::step]]
    return np.median(picked, axis=0) if len(picked) else np.zeros(values.shape[2], np.float32)


@pytest.mark.parametrize("step", [1, 3])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 2, 1), (7, 5, 2), (40, 61, 3)])
@pytest.mark.parametrize("kind", ["noise", "ties", "all alike", "huge and tiny", "negative"])
def test_medians_are_those_of_numpy(shape, step, kind):
    rng = np.random.default_rng(0)
    values = {
        "noise": lambda: rng.normal(0, 1, shape),
        "ties": lambda: rng.integers(-2, 3, shape),
        "all alike": lambda: np.full(shape, -0.25),
        "huge and tiny": lambda: rng.normal(0, 1, shape) * 10.0 ** rng.integers(-40, 38, shape),
        "negative": lambda: -rng.random(shape) - 1,
    }[kind]().astype(np.float32)
    for chosen in (None, rng.random(shape[:2]) < 0.6, np.zeros(shape[:2], bool)):
        found, count = medians_where(values, chosen, step)
        np.testing.assert_array_equal(found, by_numpy(values, chosen, step))
        assert count == np.count_nonzero(
            np.ones(shape[:2], bool)[::step, ::step] if chosen is None else chosen[::step, ::step]
        )


def test_the_kernel_agrees_with_numpy():
    assert_kernel_agrees(filters._medians_where, lambda v, c, s, *_: by_numpy(v, c, s))


@pytest.mark.parametrize("shape", [(240, 320), (720, 960), (2000, 3000)])
def test_a_lattice_has_about_as_many_pixels_as_medians_need(shape):
    step = lattice_step(shape[0] * shape[1])
    assert 0.7 * MEDIAN_SAMPLES < np.zeros(shape)[::step, ::step].size < 1.5 * MEDIAN_SAMPLES
    assert lattice_step(12) == 1


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

    @pytest.mark.parametrize("shape", [(40, 56), (41, 57), (30, 13), (1, 9)])
    @pytest.mark.parametrize("axis", [0, 1, (0, 1)])
    def test_a_flipped_map_has_the_flipped_fill(self, shape, axis):
        rng = np.random.default_rng(0)
        values, known = rng.normal(size=(*shape, 2)), rng.uniform(size=shape) > 0.4
        known[8:20, 3:12] = False
        flipped = fill_unknown(np.flip(values, axis).copy(), np.flip(known, axis).copy())
        np.testing.assert_allclose(np.flip(flipped, axis), fill_unknown(values, known), atol=2e-6)

    @pytest.mark.parametrize("shape", [(60, 80), (61, 81), (50, 75)])
    @pytest.mark.parametrize("hole", ["disk", "ring", "speckles"])
    def test_a_hole_in_a_membrane_is_closed_by_it(self, hole, shape):
        """Of a cubic that is the mean of its neighbors everywhere, whose height is about 1."""
        y, x = ((n - n.mean()) / shape[0] for n in np.mgrid[: shape[0], : shape[1]].astype(float))
        membrane, away = 4 * (x**3 - 3 * x * y**2), np.hypot(x - 0.05, y + 0.02)
        speckles = np.random.default_rng(0).uniform(size=shape) < 0.3
        unknown = {"disk": away < 0.2, "ring": (away > 0.2) & (away < 0.28), "speckles": speckles}[hole]
        unknown[[0, -1]] = unknown[:, [0, -1]] = False  # beyond the border, the fill is flat
        error = fill_unknown(membrane[..., None], ~unknown)[..., 0] - membrane
        assert np.sqrt(np.mean(error[unknown] ** 2)) < 0.0025

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


def shares(count):
    """Of the pixels of a line (columns) in those of the coarser line (rows)."""
    table = np.zeros(((count + 1) // 2, count + 2))
    for k in range(len(table)):  # one pixel is added at either end
        table[k, 2 * k + 1 : 2 * k + 3] = 1
        if count % 2:
            table[k, 2 * k : 2 * k + 3] = 1, 4, 1
    return table[:, 1:-1]


def mean_of_known(values, known, *_):
    down, across = map(shares, known.shape)
    whole = np.einsum("ai,bj,ij->ab", down, across, known)[..., None]
    total = np.einsum("ai,bj,ijc->abc", down, across, values * known[..., None])
    return total / np.maximum(whole, 1), whole[..., 0] > 0


def test_the_kernel_of_coarser_levels_agrees_with_numpy():
    assert_kernel_agrees(filters._coarser_known, mean_of_known)


def test_the_kernel_of_filling_agrees_with_numpy():
    def weights(pixels, count):
        """Of each coarse pixel for each pixel: 3/4 of the nearest and 1/4 of the next, or halves where the line is odd."""
        table = np.zeros((pixels, count))
        for pixel in range(pixels):
            near = 0.5 if pixels % 2 else 0.75
            next_one = (pixel + 1) // 2 if pixels % 2 else pixel // 2 + 2 * (pixel % 2) - 1
            table[pixel, pixel // 2] += near
            table[pixel, min(max(next_one, 0), count - 1)] += 1 - near
        return table

    def numpy_fill(coarse, values, work, runs, known, pairs):
        rows, columns = (weights(known.shape[k], coarse.shape[k]) for k in (0, 1))
        filled = np.where(known[..., None], values, np.einsum("ia,jb,abc->ijc", rows, columns, coarse))
        for _ in range(2 * pairs):
            wide = np.pad(filled, ((1, 1), (1, 1), (0, 0)), "edge")
            mean = (wide[:-2, 1:-1] + wide[2:, 1:-1] + wide[1:-1, :-2] + wide[1:-1, 2:]) / 4
            filled = np.where(known[..., None], values, mean)
        ends = np.diff(np.pad(~known, ((0, 0), (1, 1))).astype(int))
        table = np.c_[np.argwhere(ends == 1), np.argwhere(ends == -1)[:, 1] - 1].ravel()  # row, first, last
        return filled, np.r_[table, runs.ravel()[len(table) :]].reshape(runs.shape)

    assert_kernel_agrees(filters._fill_from_coarser, numpy_fill)


@pytest.mark.parametrize("order", [0, 1])
def test_it_is_that_of_scipy(order):
    x = np.geomspace(1e-4, 15, 500)
    np.testing.assert_allclose(bessel_k(order, x), special.kv(order, x), rtol=1e-9)


UNITS = np.array([1.0, 1e3, 1e-4, 1.0, 10.0])


def information(rank, seed=0):
    """A matrix (5, 5) of a known rank, in units that differ by ten million."""
    design = np.random.default_rng(seed).normal(size=(40, rank)) @ np.random.default_rng(seed + 1).normal(
        size=(rank, 5)
    )
    return (design.T @ design) * np.outer(UNITS, UNITS)


@pytest.mark.linear_algebra
def test_a_definite_matrix_is_inverted():
    of = information(5)
    found = determined_by(of)
    assert not found.undetermined.any()
    np.testing.assert_allclose(found.covariance @ of, np.eye(5), atol=1e-6)


@pytest.mark.linear_algebra
@pytest.mark.parametrize("rank", range(5))
def test_as_many_directions_as_the_rank_lacks_are_undetermined(rank):
    of = information(rank)
    found = determined_by(of)
    assert np.count_nonzero(found.undetermined) == 5 - rank
    scale = np.diag(found.directions[:, found.undetermined].T @ of @ found.directions[:, found.undetermined])
    assert np.abs(scale).max(initial=0) < 1e-9
    np.testing.assert_allclose(of @ found.covariance @ of, of, atol=1e-6 * np.abs(of).max(initial=1))


@pytest.mark.linear_algebra
def test_given_units_decide_what_is_little():
    of = np.diag([1.0, 1e-12])
    assert determined_by(of, np.ones(2)).undetermined.tolist() == [True, False]
    assert not determined_by(of).undetermined.any()


@pytest.mark.linear_algebra
def test_nothing_and_no_direction():
    assert determined_by(np.zeros((3, 3))).undetermined.all()
    assert determined_by(np.zeros((0, 0))).covariance.shape == (0, 0)
