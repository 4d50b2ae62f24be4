"""Spread of held-out slopes: correlation length and share recovered, and honest on presses never seen."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import gelform
from gelform.ball import ball_center, ball_gradients
from gelform.calibration.selection.slope_errors import LAGS, _lag_products, correlation_from_products, gain_of


@pytest.mark.parametrize(("length", "share"), [(4.0, 0.8), (8.0, 0.5), (6.0, 1.0)])
def test_correlation_is_recovered(length, share):
    """A field blurred by L/sqrt(2) has the correlation exp(-r^2/(2 L^2)); white noise on top is the nugget."""
    rng = np.random.default_rng(0)
    smooth = gaussian_filter(rng.standard_normal((1200, 1200, 2)), (length / 2**0.5,) * 2 + (0,))
    error = np.sqrt(share) * smooth / smooth.std() + np.sqrt(1 - share) * rng.standard_normal(smooth.shape)
    found_length, found_share = correlation_from_products(_lag_products(error, 1), 1)
    assert found_length == pytest.approx(length, rel=0.1)
    assert found_share == pytest.approx(share, abs=0.06)


def test_white_errors_have_no_correlated_share():
    error = np.random.default_rng(0).standard_normal((600, 600, 2))
    _, share = correlation_from_products(_lag_products(error, 1), 1)
    assert share < 0.05
    assert len(_lag_products(error, 1)) == LAGS


def test_sigma_holds_on_presses_never_seen(calibration, sensor):
    """The share of slopes within one sigma, at presses of a ball that calibration did not have, and at rest."""
    from gelform.simulate import simulate_ball_presses

    fresh = simulate_ball_presses(sensor, ball_diameters_mm=[6.0], count=6, rng=np.random.default_rng(77))
    reconstruct = gelform.Reconstructor(calibration)
    inside, rest = [], []
    for press in fresh.presses:
        result = reconstruct(press.image)
        y, x = np.mgrid[: sensor.shape[0], : sensor.shape[1]]
        rho = np.hypot(x - press.center_px[0], y - press.center_px[1])
        zone = rho < 0.8 * press.contact_radius_px
        radius = press.ball_diameter_mm / 2 / sensor.mm_per_px
        center = ball_center(result.gradients[zone], x[zone], y[zone], press.center_px, radius)
        truth = ball_gradients(x[zone], y[zone], center, radius)
        within = np.abs(result.gradients - 0) < result.gradients_sigma
        inside.append((np.abs(result.gradients[zone] - truth) < result.gradients_sigma[zone]).mean())
        rest.append(within[rho > 3.5 * press.contact_radius_px].mean())
    assert 0.45 < np.mean(inside) < 0.9
    assert 0.45 < np.nanmean(rest) < 0.9


def test_gain_of_a_press():
    truth = np.random.default_rng(0).normal(0, 0.3, (20, 30, 2))
    seen = 0.93 * truth
    truth[3, 4] = np.nan
    assert gain_of(seen, truth) == pytest.approx(0.93)
