"""The slopes' standard deviation: recovered from errors of known spread, and what it makes of a frame."""

import numpy as np
import pytest

from gelform.confidence import SlopeSigma


def errors_that_grow(rest: float, growth: float, count: int = 60_000):
    rng = np.random.default_rng(0)
    slopes = rng.uniform(0, 0.8, count)
    spread = np.sqrt(rest**2 + (growth * slopes) ** 2)
    return slopes, spread[:, None] * rng.standard_normal((count, 2))


@pytest.mark.parametrize(("rest", "growth"), [(0.02, 0.0), (0.02, 0.1), (0.005, 0.2)])
def test_law_is_recovered(rest, growth):
    sigma = SlopeSigma.fit(*errors_that_grow(rest, growth), correlation_px=8.0)
    for slope in (0.05, 0.3, 0.7):
        found = np.sqrt(sigma.rest**2 + (sigma.growth * slope) ** 2)
        assert found == pytest.approx(np.sqrt(rest**2 + (growth * slope) ** 2), rel=0.12)
    assert sigma.correlation_px == 8.0


def test_a_few_wild_errors_do_not_widen_it():
    slopes, errors = errors_that_grow(0.02, 0.1)
    errors[::50] = 3.0
    wild = SlopeSigma.fit(slopes, errors, 8.0)
    assert wild.clean == pytest.approx(SlopeSigma.fit(*errors_that_grow(0.02, 0.1), 8.0).clean, rel=0.1)


def test_steep_pixels_are_less_certain_and_clipped_ones_not_at_all():
    sigma = SlopeSigma(rest=0.02, growth=0.1, clean=0.03, correlation_px=8.0)
    gradients = np.zeros((4, 5, 2), dtype=np.float32)
    gradients[1, 1] = (0.6, 0.8)
    image = np.full((4, 5, 3), 100, dtype=np.uint8)
    image[2, 2, 1], image[3, 3, 0] = 255, 0
    spread, confidence = sigma.at(gradients, image)
    assert spread.shape == gradients.shape
    assert spread[0, 0, 0] == pytest.approx(0.02)
    assert spread[1, 1, 1] == pytest.approx(np.hypot(0.02, 0.1))
    np.testing.assert_allclose(spread[[2, 3], [2, 3]], 1.0)
    assert confidence[0, 0] == 1
    assert confidence[1, 1] == pytest.approx((0.03 / np.hypot(0.02, 0.1)) ** 2, rel=1e-4)
    assert confidence[2, 2] == pytest.approx(0.03**2, rel=1e-4)
