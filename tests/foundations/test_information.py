"""Covariances of information matrices, and what nothing determines; the same on every processor."""

import numpy as np
import pytest

from gelform.foundations.information import determined_by

pytestmark = pytest.mark.linear_algebra

UNITS = np.array([1.0, 1e3, 1e-4, 1.0, 10.0])


def information(rank, seed=0):
    """A matrix (5, 5) of a known rank, in units that differ by ten million."""
    design = np.random.default_rng(seed).normal(size=(40, rank)) @ np.random.default_rng(seed + 1).normal(
        size=(rank, 5)
    )
    return (design.T @ design) * np.outer(UNITS, UNITS)


def test_a_definite_matrix_is_inverted():
    of = information(5)
    found = determined_by(of)
    assert not found.undetermined.any()
    np.testing.assert_allclose(found.covariance @ of, np.eye(5), atol=1e-6)


@pytest.mark.parametrize("rank", range(5))
def test_as_many_directions_as_the_rank_lacks_are_undetermined(rank):
    of = information(rank)
    found = determined_by(of)
    assert np.count_nonzero(found.undetermined) == 5 - rank
    scale = np.diag(found.directions[:, found.undetermined].T @ of @ found.directions[:, found.undetermined])
    assert np.abs(scale).max(initial=0) < 1e-9
    np.testing.assert_allclose(of @ found.covariance @ of, of, atol=1e-6 * np.abs(of).max(initial=1))


def test_given_units_decide_what_is_little():
    of = np.diag([1.0, 1e-12])
    assert determined_by(of, np.ones(2)).undetermined.tolist() == [True, False]
    assert not determined_by(of).undetermined.any()


def test_nothing_and_no_direction():
    assert determined_by(np.zeros((3, 3))).undetermined.all()
    assert determined_by(np.zeros((0, 0))).covariance.shape == (0, 0)
