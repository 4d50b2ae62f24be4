"""What the causes share: what is unexplained, what says nothing, how far a clipped pixel reaches."""

import numpy as np
import pytest

from gelform.confidence.causes.seen import no_steeper, with_margin
from made.seen_frames import limits, patch, seen


def test_where_nothing_is_seen_the_weight_is_below_every_solver_s_floor():
    of = limits()
    assert (of.clean / of.unseen) ** 2 < 1e-5


def test_the_limit_grows_with_the_response_s_noise():
    assert limits(noise=0.05).unexplained == pytest.approx(0.185)
    assert limits(noise=0.001).unexplained == limits(noise=None).unexplained == pytest.approx(0.02)


def test_what_is_sure_is_further_away():
    assert limits(noise=0.05).sure == pytest.approx(0.325)
    assert limits(noise=0.001).sure == limits(noise=None).sure == pytest.approx(0.06)


def test_what_is_unexplained_is_the_rms_of_the_channels():
    residual = np.random.default_rng(0).normal(0, 1, (40, 72, 3)).astype(np.float32)
    found = seen(residual=residual).unexplained()
    np.testing.assert_allclose(found, np.sqrt((residual**2).mean(axis=-1)), rtol=1e-5)
    assert not seen(residual=None).unexplained().any()


def test_what_is_nowhere_is_nothing():
    assert not seen().where(None).any()


def test_what_is_beyond_the_response_s_noise_counts_where_it_is_asked_for():
    """3.7 times the noise of 0.03; from 6.5 times on nothing would be left of a slope."""
    residual = np.zeros((40, 72, 3), np.float32)
    residual[...] = np.linspace(0, 0.19, 72, dtype=np.float32)[:, None]
    frame, mask = seen(residual=residual), patch(np.s_[10:20, :])
    expected = np.where(mask, 3 * 1.5 * np.maximum(residual[..., 0] - 3.7 * 0.03, 0), 0)
    np.testing.assert_allclose(frame.beyond(mask), expected, atol=1e-5)
    assert 0 < np.count_nonzero(expected) < np.count_nonzero(mask)


def test_the_common_part_is_the_mean_over_the_rms_of_the_channels():
    residual = np.random.default_rng(0).normal(0, 1, (40, 72, 3)).astype(np.float32)
    wanted = residual.mean(axis=-1) / np.sqrt((residual**2).mean(axis=-1))
    np.testing.assert_allclose(seen(residual=residual).common(), wanted, atol=1e-5)
    np.testing.assert_allclose(seen(residual=-residual, gentle=residual).common(), wanted, atol=1e-5)
    assert not seen(residual=None).common().any()


def test_slopes_are_cut_to_those_of_which_the_response_says_something():
    slopes = np.array([[[0.3, -0.4], [3.0, 4.0], [0.0, 0.0]]], np.float32)
    np.testing.assert_allclose(no_steeper(slopes), [[[0.3, -0.4], [0.6, 0.8], [0, 0]]], rtol=1e-6)


def test_a_margin_of_none_leaves_the_mask():
    mask = np.random.default_rng(0).uniform(size=(20, 30)) > 0.9
    assert np.array_equal(with_margin(mask, 0), mask)
    assert with_margin(mask, 2).sum() > 2 * mask.sum()
