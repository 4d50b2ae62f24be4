"""Training: the weights count, and nothing to train on is refused."""

import numpy as np
import pytest

from gelform.slopes.color_models import MlpModel
from made.images import SHAPE, ball_samples, shading_change

pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")


def test_weights_count_in_training():
    samples = ball_samples(shading_change, count=2000)
    turned = samples.gradients * np.where(np.arange(2000) % 2, -1, 1)[:, None]
    weight = (np.arange(2000) % 2 == 0).astype(float)
    spoilt = type(samples)(samples.color_change, samples.x_px, samples.y_px, turned, weight, SHAPE)
    found = MlpModel.fit(spoilt, steps=300).gradients_at(samples.color_change, samples.x_px, samples.y_px)
    assert np.sqrt(np.mean((found - samples.gradients) ** 2)) < 0.05


def test_nothing_to_train_on_is_refused():
    with pytest.raises(ValueError, match="Expected hidden layers, steps and samples"):
        MlpModel.fit(ball_samples(shading_change, count=100), steps=0)
