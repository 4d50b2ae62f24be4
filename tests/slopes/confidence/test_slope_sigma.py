"""The law of the slopes' standard deviation: recovered from errors of known size."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from gelform.slopes.confidence.slope_sigma import SlopeErrors, SlopeSigma, factor_at, law_at

LAW = SlopeSigma(
    rest=0.01,
    slopes=(0.0, 0.5, 1.0),
    sigmas=(0.02, 0.05, 0.12),
    full_confidence_sigma=0.03,
    correlation_px=8.0,
)


def errors_by(law, place=lambda x, y: 1.0, rest: float = 0.01, count: int = 60_000):
    """Errors whose deviation is law(|g|) times place(x, y), on 40 presses."""
    rng = np.random.default_rng(0)
    slopes, x, y = rng.uniform(0, 0.8, count), rng.uniform(0, 1, count), rng.uniform(0, 1, count)
    press = rng.integers(0, 40, count)
    errors = (law(slopes) * place(x, y))[:, None] * rng.standard_normal((count, 2))
    return SlopeErrors(slopes, errors, x, y, press, rest * rng.standard_normal((5000, 2)), np.zeros(5000))


def factors_of(sigma, slopes, x, y):
    """Of a step's deviation, at scattered pixels."""
    slopes, x, y = (np.asarray(one, dtype=float) for one in (slopes, x, y))
    return law_at(slopes, np.array(sigma.slopes), np.array(sigma.sigmas)) * factor_at(
        np.array(sigma.place), x, y
    )


def shares_within(sigma, held_out, bins):
    stated = held_out.stated * factors_of(sigma, held_out.slopes, held_out.x, held_out.y)
    within = np.abs(held_out.errors) < stated[:, None]
    return [within[bins == b].mean() for b in np.unique(bins)]


@pytest.mark.parametrize(("floor", "growth"), [(0.02, 0.0), (0.02, 0.1), (0.005, 0.2)])
def test_law_is_recovered(floor, growth):
    def law(slopes):
        return np.sqrt(floor**2 + (growth * slopes) ** 2)

    held_out = errors_by(law)
    sigma = SlopeSigma.fit(held_out, 8.0, 0.7)
    for slope in (0.1, 0.3, 0.7):
        assert factors_of(sigma, slope, 0.5, 0.5) == pytest.approx(law(slope), rel=0.12)
    assert sigma.rest == pytest.approx(0.01, rel=0.05)
    assert sigma.full_confidence_sigma == pytest.approx(
        law(0.95 * 0.8), rel=0.12
    )  # 95 % of the slopes are gentler
    assert (sigma.correlation_px, sigma.correlated_share) == (8.0, 0.7)
    shares = shares_within(sigma, held_out, np.digitize(held_out.slopes, np.linspace(0, 0.8, 9)[1:-1]))
    assert min(shares) > 0.64
    assert max(shares) < 0.76


def test_factors_are_of_the_deviation_that_a_step_states():
    """A step that knows how its errors vary leaves nothing to slope and place; one that is off by a factor is put right."""
    held_out = errors_by(lambda s: 0.02 + 0.1 * s, place=lambda x, y: np.where(x > 0.75, 3.0, 1.0))
    true = (0.02 + 0.1 * held_out.slopes) * np.where(held_out.x > 0.75, 3.0, 1.0)
    for share in (1.0, 0.4):
        sigma = SlopeSigma.fit(replace(held_out, stated=share * true), 8.0, 0.5)
        np.testing.assert_allclose(sigma.sigmas, 1 / share, rtol=0.06)
        np.testing.assert_allclose(sigma.place, 1, atol=0.06)
        assert sigma.full_confidence_sigma == pytest.approx(np.quantile(true, 0.95), rel=0.05)
        assert sigma.rest == pytest.approx(0.01, rel=0.05)
    shares = shares_within(sigma, replace(held_out, stated=share * true), (4 * held_out.x).astype(int))
    assert min(shares) > 0.64
    assert max(shares) < 0.72


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


def test_place_counts_where_presses_show_it():
    held_out = errors_by(lambda s: 0.02 + 0 * s, place=lambda x, y: np.where(x > 0.75, 2.0, 1.0))
    sigma = SlopeSigma.fit(held_out, 8.0, 0.5)
    assert sigma.place[1][3] / sigma.place[1][0] == pytest.approx(2.0, rel=0.25)
    shares = shares_within(sigma, held_out, (held_out.x > 0.85).astype(int) + 2 * (held_out.x < 0.6))
    assert min(shares) > 0.6
    assert max(shares) < 0.76


@pytest.mark.parametrize(
    ("times", "presses", "low", "high"),
    [(4.0, 1, 1, 3), (0.0, 40, 1.5, 5)],
    ids=["touched by one press", "all right"],
)
def test_a_place_of_little_or_perfect_evidence_counts_less(times, presses, low, high):
    """One press that shows four times as much counts for less; slopes that were all right are not taken for exact."""
    held_out = errors_by(lambda s: 0.02 + 0 * s, place=lambda x, y: np.where(x > 0.75, times, 1.0))
    press = np.where(held_out.x > 0.75, held_out.press % presses, held_out.press)
    place = SlopeSigma.fit(replace(held_out, press=press), 8.0, 0.5).place[1]
    ratio = place[3] / place[0] if times else 1 / place[3] / 2
    assert low < ratio < high


def test_a_few_wild_errors_do_not_widen_it():
    held_out = errors_by(lambda s: 0.02 + 0.1 * s)
    wild = held_out.errors.copy()
    wild[::50] = 3.0
    spoilt, right = (SlopeSigma.fit(one, 8.0, 0.5) for one in (replace(held_out, errors=wild), held_out))
    assert spoilt.full_confidence_sigma == pytest.approx(right.full_confidence_sigma, rel=0.1)


def test_a_law_comes_back_from_its_settings():
    assert SlopeSigma.from_dict(asdict(LAW)) == LAW
