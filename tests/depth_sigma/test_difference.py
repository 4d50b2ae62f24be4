"""Differences of one frame's depth: what is shared is left out, what is in proportion is of the difference alone."""

import numpy as np
import pytest

from gelform.depth_sigma.difference import DepthDifference
from gelform.depth_sigma.sigma import DepthSigma

SHAPE = (40, 56)


@pytest.fixture(scope="module")
def parts():
    prepared = DepthSigma(SHAPE, mm_per_px=0.1)
    return prepared, np.full((*SHAPE, 2), 0.05, dtype=np.float32), {"zero": "mean"}


def test_a_common_gain_moves_only_what_is_apart(parts):
    """Depth of 2 mm on the left and 3 mm on the right: 10 % of all slopes together are 0.05 mm about the mean of 2.5."""
    depth = np.full(SHAPE, 2.0, dtype=np.float32)
    depth[:, 28:] = 3.0
    region = np.ones(SHAPE, dtype=bool)
    without, with_gain = (DepthDifference(*parts, depth, gain)(region) for gain in (0.0, 0.1))
    np.testing.assert_allclose(with_gain, np.hypot(without, 0.05), rtol=1e-5)


def test_it_is_that_of_the_prepared_sigma_against_the_region(parts):
    region = np.zeros(SHAPE, dtype=bool)
    region[10:20, 10:30] = True
    depth = np.zeros(SHAPE, dtype=np.float32)
    found = DepthDifference(*parts, depth, 0.3)(region)
    np.testing.assert_array_equal(found, parts[0](parts[1], zero="mean", against=region))
    assert found[region].mean() < 0.8 * found[30:, 45:].mean()  # known best where it is measured against
