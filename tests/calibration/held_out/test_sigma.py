"""Spread of held-out slopes: correlation length and share recovered, and honest on presses never seen."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import gelform
from gelform.calibration.circles.find import ContactCircle, magnitude
from gelform.calibration.circles.samples import PRESS_PIXELS, PreparedPress
from gelform.calibration.held_out.folds import Fold
from gelform.calibration.held_out.sigma import (
    LAGS,
    _lag_products,
    correlation_from_products,
    fraction_trained,
    press_residuals,
    rest_correlation,
    slope_sigma_from_folds,
)
from gelform.result.metrics.ball import ball_center, ball_gradients
from gelform.slopes.color_models.forward_response import Step


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


@pytest.mark.parametrize(("length", "share"), [slow(4.0, 0.8), (8.0, 0.5), slow(6.0, 1.0)])
def test_correlation_is_recovered(length, share):
    """A field blurred by L/sqrt(2) has the correlation exp(-r^2/(2 L^2)); white noise on top is the nugget."""
    rng = np.random.default_rng(0)
    smooth = gaussian_filter(rng.standard_normal((1200, 1200, 2)), (length / 2**0.5,) * 2 + (0,))
    error = np.sqrt(share) * smooth / smooth.std() + np.sqrt(1 - share) * rng.standard_normal(smooth.shape)
    error[:, ::50] = np.nan  # not known, as outside of a contact
    found_length, found_share = correlation_from_products(_lag_products(0.04 * error, 1), 1)
    assert found_length == pytest.approx(length, rel=0.1)
    assert found_share == pytest.approx(share, abs=0.06)


def test_white_errors_have_no_correlated_share():
    error = np.random.default_rng(0).standard_normal((600, 600, 2))
    _, share = correlation_from_products(_lag_products(error, 1), 1)
    assert share < 0.05
    assert correlation_from_products(np.array([1.0, *[-0.3] * 23]), 1)[1] == 0
    assert correlation_from_products(np.array([1.0, *[1.3] * 23]), 1)[1] == 1
    assert len(_lag_products(error, 1)) == LAGS
    assert rest_correlation(np.zeros(LAGS), 9.0) == (0.0, 0.0), "of nothing"


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
    # On a noisy sensor of few rows what blur takes from slopes is stated too widely: docs/decisions/0009-stated-slopes.md
    assert 0.45 < np.mean(inside) < 0.95
    assert 0.45 < np.nanmean(rest) < 0.95  # solved slopes at rest are better than the factor of contacts says


class Reader:
    """Reads the slopes that lie in the color change 7 % too gentle, with white errors of 0.03.

    It states so many times as much, and leaves residuals of one degree of freedom of which a tenth is outliers.
    """

    def __init__(self, stated=1.0):
        self.stated = stated

    def frame(self, press):
        rng = np.random.default_rng(round(1e3 * press.size.sum()))
        read = 0.93 * press.color_change[..., :2] + rng.normal(0, 0.03, (*press.size.shape, 2))
        left = np.square(rng.normal(size=press.size.shape)) * np.where(
            rng.uniform(size=press.size.shape) < 0.1, 50, 1
        )
        return Step(read, np.full(press.size.shape, (0.03 * self.stated) ** 2), left)


VISIBLE_PX = 22.5  # the gel leaves the ball at 18


NOISE = np.zeros((120, 160), np.float32)  # of the image: none


def press_at(x_px, y_px, shape=(120, 160)):
    """A press whose color change is its slopes, and the visible circle."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    contact = ContactCircle(x_px, y_px, VISIBLE_PX, 1.0, 9.0)
    inside = np.hypot(x - x_px, y - y_px) < 18
    slopes = np.where(inside[..., None], ball_gradients(x, y, (x_px, y_px), 40.0), 0)
    beside = (np.hypot(x - x_px, y - y_px) < 2.8 * 18) & ~inside
    slopes[beside & (y < y_px)] += 0.1  # gel that is drawn down around the ball
    change = np.concatenate([slopes, 0 * slopes[..., :1]], axis=-1).astype(np.float32)
    return PreparedPress("one", change, magnitude(change), 40.0, contact_radius_ratio=0.8), contact


@pytest.fixture(scope="module")
def six():
    """Presses, their circles and two folds."""
    places = [(30, 30), (80, 60), (130, 90), (40, 85), (120, 35), (75, 95)]
    presses, found = zip(*(press_at(*place) for place in places))
    return presses, found, [Fold((0, 1, 2), (3, 4, 5), found[3:]), Fold((3, 4, 5), (0, 1, 2), found[:3])]


@pytest.mark.parametrize("stated", [1.0, 0.5, 3.0])
def test_the_law_is_that_of_the_errors_that_were_made(six, stated):
    """Of two folds: a model of all presses has seen twice as many, and its errors are taken for smaller by a root of 2.

    What a step states is multiplied by factors, so that they come out the same whatever it says.
    """
    presses, found, folds = six
    sigma, _ = slope_sigma_from_folds([Reader(stated)] * 2, folds, presses, found, NOISE)
    assert sigma.rest == pytest.approx(0.03, rel=0.1)
    gentle = sigma.per_step * np.hypot(1, 0.1 * sigma.per_slope) * 0.03 * stated
    assert gentle == pytest.approx(0.03 / np.sqrt(2), rel=0.25)
    assert sigma.correlated_share < 0.5
    assert 0.02 < sigma.full_confidence_sigma < 0.06


def test_the_residuals_scale_is_that_of_the_95_percent(six):
    """A tenth of the pixels has fifty times the usual square: the 95 % are reached among them, far below the largest."""
    presses, found, folds = six
    _, scale = slope_sigma_from_folds([Reader()] * 2, folds, presses, found, NOISE)
    reader = Reader()
    left = [reader.frame(p).residual[p.pixels(c, 1.0)] for p, c in zip(presses, found)]
    at_most = np.quantile(np.concatenate(left), 0.95)
    assert scale == pytest.approx(at_most / 3.84, rel=1e-6)
    assert 3 < scale < 15

    class Usual(Reader):
        def frame(self, press):
            return super().frame(press)._replace(residual=np.full(press.size.shape, 0.1))

    assert slope_sigma_from_folds([Usual()] * 2, folds, presses, found, NOISE)[1] == 1, (
        "at least what the covariance says"
    )


def test_columns_are_thinned_pixels_of_the_contact():
    press, contact = press_at(60, 70)
    reader = Reader()
    residuals = press_residuals(press, contact, reader.frame(press), NOISE)
    slopes, errors, stated, residual = residuals.columns()
    assert 600 < len(slopes) <= 2 * 2000
    thin = slice(None, None, max(1, len(residuals.rows) // PRESS_PIXELS))
    pixels = residuals.rows[thin], residuals.cols[thin]
    np.testing.assert_array_equal(residual, reader.frame(press).residual[pixels])
    np.testing.assert_allclose(stated, 0.03)
    true = np.linalg.norm(press.color_change[pixels], axis=1)
    assert np.abs(slopes - 0.93 * true).mean() < 0.05
    assert errors.shape == (len(slopes), 2)
    away = np.hypot(pixels[1] - 60, pixels[0] - 70)
    assert 17 < away.max() < 18, "up to the edge of the contact"
    assert np.abs(np.median(residuals.untouched, axis=0)).max() < 1e-9
    assert len(residuals.untouched) > 500


@pytest.mark.parametrize(("short", "share"), [slow(1.8, 0.0), (1.8, 0.3), slow(0.3, 0.2)])
def test_correlation_at_rest_is_recovered(short, share):
    """Blurred noise, and on it what is correlated as in a contact."""
    rng = np.random.default_rng(0)
    fields = [
        gaussian_filter(rng.standard_normal((900, 900, 2)), (length / 2**0.5,) * 2 + (0,))
        for length in (short, 9.0)
    ]
    near, far = (field / field.std() for field in fields)
    products = _lag_products(np.sqrt(1 - share) * near + np.sqrt(share) * far, 1)
    found_short, found_share = rest_correlation(products, 9.0)
    assert found_short == pytest.approx(short, abs=0.25)
    assert found_share == pytest.approx(share, abs=0.05)


def test_the_share_that_folds_have_seen():
    folds = [Fold((0, 1), tuple(range(2, 10)), ()), Fold((2, 3, 4, 5), (0, 1, 6, 7, 8, 9), ())]
    assert fraction_trained(folds) == pytest.approx((0.8 + 0.6) / 2)
