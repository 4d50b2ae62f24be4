"""Noise at rest by place, against the noise that images of an untouched gel leave in the slopes."""

import numpy as np
import pytest

from gelform.background.change import ChangeSettings, PreparedBackground
from gelform.contact import noise_by_place
from gelform.contact.noise import LEAST, MOST


class Linear:
    """Slopes from a color change by a fixed matrix (3, 2)."""

    def __init__(self, matrix):
        self.matrix = np.array(matrix, np.float32)

    def gradients_from_color(self, change):
        return change @ self.matrix, None


def untouched(background):
    return PreparedBackground(background.astype(np.float32), ChangeSettings(method="divide", offset=10.0))


def test_it_is_that_of_many_noisy_images():
    x = np.linspace(60, 200, 96)
    background = np.stack([np.tile(x, (64, 1)), np.tile(x[::-1], (64, 1)), np.full((64, 96), 90.0)], axis=-1)
    model, levels, rng = Linear([[1, 0], [0.3, 2], [0, 0.5]]), (1.0, 3.0, 2.0), np.random.default_rng(0)
    prepared = untouched(background)
    slopes = [
        model.gradients_from_color(prepared.change(background + rng.normal(0, levels, background.shape)))[0]
        for _ in range(60)
    ]
    columns = np.sqrt(np.mean(np.square(slopes), axis=(0, 1, 3)))
    found = noise_by_place(model, prepared, levels)
    inner = slice(16, -16)  # the map is smooth over 8 px
    expected = (columns / np.median(columns))[inner]
    np.testing.assert_allclose(found[32, inner], expected, rtol=0.12)
    assert np.median(found) == pytest.approx(1)


def test_noise_of_the_levels_is_taken_to_be_alike_where_it_is_unknown():
    background = np.random.default_rng(0).uniform(60, 200, (40, 50, 3))
    model = Linear([[1, 0], [0.3, 2], [0, 0.5]])
    alike = noise_by_place(model, untouched(background), (5.0, 5.0, 5.0))
    np.testing.assert_allclose(noise_by_place(model, untouched(background), None), alike, rtol=1e-3)


def test_it_stays_within_bounds():
    background = np.full((60, 80, 3), 100.0)
    background[:, :10] = 0
    background[:, 70:] = 255
    found = noise_by_place(Linear([[1, 0], [0, 1], [0, 0]]), untouched(background), (1.0, 1.0, 1.0))
    assert found.min() >= LEAST
    assert found.max() <= MOST
    assert found.dtype == np.float32
    blind = noise_by_place(Linear(np.zeros((3, 2))), untouched(background), None)
    assert (blind == 1).all()
