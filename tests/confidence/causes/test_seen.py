"""What the causes share: what is unexplained, what says nothing, how far a clipped pixel reaches."""

import numpy as np
import pytest

from gelform.confidence.causes.seen import with_margin
from made.seen_frames import limits, seen


def test_where_nothing_is_seen_the_weight_is_below_every_solver_s_floor():
    of = limits()
    assert (of.clean / of.unseen) ** 2 < 1e-5


def test_the_limit_grows_with_the_response_s_noise():
    assert limits(noise=0.05).unexplained == pytest.approx(0.185)
    assert limits(noise=0.001).unexplained == limits(noise=None).unexplained == pytest.approx(0.02)


def test_the_common_part_is_the_mean_over_the_channels():
    residual = np.random.default_rng(0).normal(0, 1, (40, 72, 3)).astype(np.float32)
    np.testing.assert_allclose(seen(residual=residual).common(), residual.mean(axis=-1))
    assert not seen(residual=None).common().any()


def test_a_margin_of_none_leaves_the_mask():
    mask = np.random.default_rng(0).uniform(size=(20, 30)) > 0.9
    assert np.array_equal(with_margin(mask, 0), mask)
    assert with_margin(mask, 2).sum() > 2 * mask.sum()
