"""What `DepthSigma` refuses at its door is tested there; here, what passes."""

import numpy as np
import pytest

from gelform.depth_sigma.inputs import checked_rest, checked_share, checked_sigma

SHAPE = (4, 6)


def test_rest_is_a_mask_of_the_frame():
    assert checked_rest(None, SHAPE) is None
    with pytest.raises(ValueError, match=r"Expected rest as bool of shape \(4, 6\), got float64"):
        checked_rest(np.ones(SHAPE), SHAPE)
    with pytest.raises(ValueError, match=r"of \(4, 5\)"):
        checked_rest(np.ones((4, 5), bool), SHAPE)


def test_one_map_for_both_slopes_stays_one():
    one = np.random.default_rng(0).uniform(0.1, 1, SHAPE).astype(np.float32)
    assert checked_sigma(one, SHAPE).shape == (*SHAPE, 1)
    assert np.array_equal(checked_sigma(np.broadcast_to(one[..., None], (*SHAPE, 2)))[..., 0], one)
    assert checked_sigma(np.stack([one, one], axis=-1)).shape == (*SHAPE, 2)


def test_without_a_length_nothing_is_correlated():
    assert checked_share(0.0, 0.5) == 0
    assert checked_share(3.0, 0.5) == 0.5
