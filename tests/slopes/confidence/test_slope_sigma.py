"""The law of the slopes' standard deviation: recovered from errors of known size."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gelform.slopes.confidence.slope_sigma import LEAST_FACTOR, SlopeErrors, SlopeSigma

LAW = SlopeSigma(rest=0.01, per_step=0.02, per_slope=2.0, full_confidence_sigma=0.03, correlation_px=8.0)


def errors_by(law, rest: float = 0.01, count: int = 60_000):
    """Errors whose deviation is law(|g|)."""
    rng = np.random.default_rng(0)
    slopes = rng.uniform(0, 0.8, count)
    errors = law(slopes)[:, None] * rng.standard_normal((count, 2))
    return SlopeErrors(slopes, errors, rest * rng.standard_normal((5000, 2)), np.zeros(5000))


def law_of(sigma, slopes):
    """Factor of a step's deviation."""
    return sigma.per_step * np.sqrt(1 + (sigma.per_slope * np.asarray(slopes)) ** 2)


def shares_within(sigma, held_out, bins):
    stated = held_out.stated * law_of(sigma, held_out.slopes)
    within = np.abs(held_out.errors) < stated[:, None]
    return [within[bins == b].mean() for b in np.unique(bins)]


@pytest.mark.parametrize(("floor", "growth"), [(0.02, 0.0), (0.02, 0.1), (0.005, 0.2)])
def test_law_is_recovered(floor, growth):
    def law(slopes):
        return np.sqrt(floor**2 + (growth * slopes) ** 2)

    held_out = errors_by(law)
    sigma = SlopeSigma.fit(held_out, 8.0, 0.7)
    for slope in (0.1, 0.3, 0.7):
        assert law_of(sigma, slope) == pytest.approx(law(slope), rel=0.12)
    assert sigma.rest == pytest.approx(0.01, rel=0.05)
    assert sigma.full_confidence_sigma == pytest.approx(
        law(0.95 * 0.8), rel=0.12
    )  # 95 % of the slopes are gentler
    assert (sigma.correlation_px, sigma.correlated_share) == (8.0, 0.7)
    shares = shares_within(sigma, held_out, np.digitize(held_out.slopes, np.linspace(0, 0.8, 9)[1:-1]))
    assert min(shares) > (0.64 if floor > 0.01 else 0.55)  # within the first bin it varies by four times
    assert max(shares) < 0.76


def test_the_law_is_of_the_deviation_that_a_step_states():
    """A step that knows how its errors vary leaves nothing to the slope; one that is off by a factor is put right."""
    held_out = errors_by(lambda s: 0.02 + 0.1 * s)
    true = 0.02 + 0.1 * held_out.slopes
    for share in (1.0, 0.4):
        sigma = SlopeSigma.fit(replace(held_out, stated=share * true), 8.0, 0.5)
        np.testing.assert_allclose(law_of(sigma, [0.0, 0.4, 0.8]), 1 / share, rtol=0.06)
        assert sigma.full_confidence_sigma == pytest.approx(np.quantile(true, 0.95), rel=0.05)
        assert sigma.rest == pytest.approx(0.01, rel=0.05)


def test_shown_slopes_are_quantiles_of_the_presses():
    sigma = SlopeSigma.fit(errors_by(lambda s: 0.02 + 0 * s), 8.0, 0.5)
    np.testing.assert_allclose(sigma.shown, (0.4 * 0.8, 0.8 * 0.8), rtol=0.02)


@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0])
def test_the_factor_of_solved_slopes_is_recovered(factor):
    rng = np.random.default_rng(0)
    stated = rng.uniform(0.01, 0.1, 20_000)
    errors = factor * stated[:, None] * rng.standard_normal((20_000, 2))
    assert LAW.with_solved(errors, stated).solved_factor == pytest.approx(factor, rel=0.02)
    assert LAW.with_solved(errors[:10], stated[:10]) == LAW, "too few"
    assert LAW.with_solved(0 * errors, stated).solved_factor == LEAST_FACTOR


def test_rest_that_no_press_showed_is_as_a_gentle_slope():
    held_out = replace(errors_by(lambda s: 0.02 + 0 * s), rest=np.zeros((0, 2)), rest_noise=np.zeros(0))
    assert SlopeSigma.fit(held_out, 8.0, 0.5).rest == pytest.approx(0.02, rel=0.05)
    stated = replace(held_out, stated=np.full(held_out.slopes.shape, 0.1))
    assert SlopeSigma.fit(stated, 8.0, 0.5).rest == pytest.approx(0.02, rel=0.05)


def test_the_deviation_at_rest_has_a_part_that_grows_with_the_place_s_noise():
    rng = np.random.default_rng(1)
    noise = rng.uniform(0.005, 0.05, 20_000) ** 2
    true = np.sqrt(0.01**2 + 0.3**2 * noise)
    rest = true[:, None] * rng.standard_normal((20_000, 2))
    held_out = replace(errors_by(lambda s: 0.02 + 0 * s), rest=rest, rest_noise=noise)
    sigma = SlopeSigma.fit(held_out, 8.0, 0.5)
    assert (sigma.rest, sigma.rest_per_noise) == pytest.approx((0.01, 0.3), rel=0.06)
    alike = SlopeSigma.fit(replace(held_out, rest=0.02 * rest / true[:, None]), 8.0, 0.5)
    assert (alike.rest, alike.rest_per_noise) == pytest.approx((0.02, 0.0), abs=2e-3, rel=0.05)


def test_a_few_wild_errors_do_not_widen_it():
    held_out = errors_by(lambda s: 0.02 + 0.1 * s)
    wild = held_out.errors.copy()
    wild[::50] = 3.0
    spoilt, right = (SlopeSigma.fit(one, 8.0, 0.5) for one in (replace(held_out, errors=wild), held_out))
    assert spoilt.full_confidence_sigma == pytest.approx(right.full_confidence_sigma, rel=0.1)


def test_a_law_comes_back_from_its_settings():
    assert SlopeSigma.from_dict(asdict(LAW)) == LAW
