"""Held-out pixels: the same errors as the run's figures, and a deviation that is honest on presses never seen.

Correlation lengths, gains and factors that are put into errors come out of them.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from gelform.calibration import held_out as module
from gelform.calibration.circles.find import ContactCircle, PreparedPress, magnitude
from gelform.calibration.held_out import (
    LAGS,
    _lag_products,
    at_pixels,
    by_press,
    common_error,
    correlation_from_products,
    depth_factor,
    errors_of,
    fraction_trained,
    measure_held_out,
    press_errors_as_read,
    rest_correlation,
    slope_sigma_from_folds,
    with_factors,
)
from gelform.calibration.selection import FIRST_GUESS, Candidate, Fitted, Fold, Selection
from gelform.reconstruct import Reconstructor
from gelform.result.metrics import angle_deg, ball_gradients
from gelform.slopes.color_models.forward_response import RIDGES, Step
from gelform.slopes.sigma import ONE_SIGMA, SlopeSigma


def slow(*values):
    return pytest.param(*values, marks=pytest.mark.slow)


def correlated(length, size, rng):
    """Errors of deviation 1, blurred by L/sqrt(2): their correlation is exp(-r^2/(2 L^2))."""
    field = gaussian_filter(rng.standard_normal((size, size, 2)), (length / 2**0.5,) * 2 + (0,))
    return field / field.std()


@pytest.mark.parametrize(("length", "share"), [slow(4.0, 0.8), (8.0, 0.5), slow(6.0, 1.0)])
def test_correlation_is_recovered(length, share):
    """White noise on top is the nugget."""
    rng = np.random.default_rng(0)
    smooth = correlated(length, 1200, rng)
    error = np.sqrt(share) * smooth + np.sqrt(1 - share) * rng.standard_normal(smooth.shape)
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


class Reader:
    """Reads the slopes that lie in the color change 7 % too gentle, with white errors of 0.03.

    It states so many times as much, and leaves residuals of one degree of freedom of which a tenth is outliers.
    """

    def __init__(self, stated=1.0):
        self.stated = stated

    def frame(self, press):
        rng = np.random.default_rng(round(1e3 * press.size.sum()))
        read = 0.93 * press.color_change[..., :2] + rng.normal(0, 0.03, (*press.size.shape, 2))
        left = np.square(rng.normal(size=press.size.shape))
        left *= np.where(rng.uniform(size=press.size.shape) < 0.1, 50, 1)
        return Step(read, np.full(press.size.shape, (0.03 * self.stated) ** 2), left)


NOISE = np.zeros((120, 160), np.float32)  # of the image: none


def press_at(x_px, y_px):
    """A press whose color change is its slopes, and the visible circle; the gel leaves the ball at 18 px."""
    y, x = np.mgrid[:120, :160]
    contact, away = ContactCircle(x_px, y_px, 22.5, 1.0, 9.0), np.hypot(x - x_px, y - y_px)
    slopes = np.where((away < 18)[..., None], ball_gradients(x, y, (x_px, y_px), 40.0), 0)
    slopes[(away >= 18) & (away < 2.8 * 18) & (y < y_px)] += 0.1  # gel that is drawn down around the ball
    change = np.concatenate([slopes, 0 * slopes[..., :1]], axis=-1).astype(np.float32)
    return PreparedPress("one", change, magnitude(change), 40.0, contact, contact_radius_ratio=0.8)


@pytest.fixture(scope="module")
def six():
    """Presses and two folds."""
    places = [(30, 30), (80, 60), (130, 90), (40, 85), (120, 35), (75, 95)]
    presses = [press_at(*place) for place in places]
    found = tuple(press.found for press in presses)
    return presses, [Fold((0, 1, 2), (3, 4, 5), found[3:]), Fold((3, 4, 5), (0, 1, 2), found[:3])]


@pytest.mark.parametrize("stated", [1.0, 0.5, 3.0])
def test_the_law_is_that_of_the_errors_that_were_made(six, stated):
    """Of two folds: a model of all presses has seen twice as many, and its errors are taken for smaller by a root of 2.

    What a step states is multiplied by factors, so that they come out the same whatever it says.
    """
    presses, folds = six
    sigma, _ = slope_sigma_from_folds([Reader(stated)] * 2, folds, presses, NOISE)
    assert sigma.rest == pytest.approx(0.03, rel=0.1)
    gentle = sigma.per_step * np.hypot(1, 0.1 * sigma.per_slope) * 0.03 * stated
    assert gentle == pytest.approx(0.03 / np.sqrt(2), rel=0.25)
    assert sigma.correlated_share < 0.5
    assert 0.02 < sigma.full_confidence_sigma < 0.06


def test_the_residuals_scale_is_that_of_the_95_percent(six):
    """A tenth of the pixels has fifty times the usual square: the 95 % are reached among them, far below the largest."""
    presses, folds = six
    _, scale = slope_sigma_from_folds([Reader()] * 2, folds, presses, NOISE)
    left = [Reader().frame(p).residual[p.pixels(p.found, 1.0)] for p in presses]
    at_most = np.quantile(np.concatenate(left), 0.95)
    assert scale == pytest.approx(at_most / 3.84, rel=1e-6)
    assert 3 < scale < 15

    class Usual(Reader):
        def frame(self, press):
            return super().frame(press)._replace(residual=np.full(press.size.shape, 0.1))

    _, least = slope_sigma_from_folds([Usual()] * 2, folds, presses, NOISE)
    assert least == 1, "at least what the covariance says"


def test_pixels_as_read_are_thinned_ones_of_the_contact(monkeypatch):
    monkeypatch.setattr(module, "PRESS_PIXELS", 300)
    press = press_at(60, 70)
    frame = Reader().frame(press)
    pixels, rest, _, _ = press_errors_as_read(press, frame, NOISE, 1)
    assert 300 <= len(pixels) < 600
    rows, cols = press.pixels(press.found, 1.0)
    at = rows[:: len(rows) // 300], cols[:: len(rows) // 300]
    np.testing.assert_array_equal(pixels["residual"], frame.residual[at].astype(np.float32))
    np.testing.assert_allclose(pixels["stated"], 0.03)
    true = press.color_change[at][:, :2]
    assert np.abs(pixels["slope"] - 0.93 * np.linalg.norm(true, axis=1)).mean() < 0.05
    np.testing.assert_allclose(pixels["error"], frame.gradients[at] - true, atol=0.05)
    away = np.hypot(cols - 60, rows - 70)
    assert 17 < away.max() < 18, "up to the edge of the contact"
    assert np.abs(np.median(rest["error"], axis=0)).max() < 1e-9
    assert 100 < len(rest) < 300


@pytest.mark.parametrize(("short", "share"), [slow(1.8, 0.0), (1.8, 0.3), slow(0.3, 0.2)])
def test_correlation_at_rest_is_recovered(short, share):
    """Blurred noise, and on it what is correlated as in a contact."""
    rng = np.random.default_rng(0)
    near, far = (correlated(length, 900, rng) for length in (short, 9.0))
    products = _lag_products(np.sqrt(1 - share) * near + np.sqrt(share) * far, 1)
    found_short, found_share = rest_correlation(products, 9.0)
    assert found_short == pytest.approx(short, abs=0.25)
    assert found_share == pytest.approx(share, abs=0.05)


def off_deg(pixels):
    """Mean angle to the ball's normals."""
    return angle_deg(pixels["solved"], pixels["true"]).mean()


def test_pixels_carry_the_errors_of_the_report(calibration):
    """Those up to the visible rim; inside the contact's edge they are the figures that the report counts first."""
    report, ratio = calibration.report, calibration.settings["contact_radius_ratio"]
    parts = {int(part["press"][0]): part for part in by_press(report.pixels)}
    assert len(parts) > 3
    assert parts.keys() == report.caps_um.keys() == {i for i, row in enumerate(report.presses) if row.errors}
    for i, part in parts.items():
        errors, cap_um = report.presses[i].errors, report.caps_um[i]
        assert off_deg(part) == pytest.approx(errors["normal_rim_deg"], rel=0.02)
        assert off_deg(part[part["rho"] < ratio]) == pytest.approx(errors["normal_free_deg"], rel=0.02)
        assert np.nanstd(cap_um) > 0.9 * errors["cap_free_um"], "its rim is counted"
        assert np.nanmean(cap_um) == pytest.approx(0, abs=1e-2)


PLAIN = Candidate("polynomial", (("position_degrees", (2, 1)),))


@pytest.fixture(scope="module")
def judged(held_out):
    """Judges a calibration with what was selected, and by the first fold; the others select the same as all."""

    def judged(draft, chosen, by_first):
        by_fold = (by_first, *[chosen] * (len(held_out.folds) - 1))
        return measure_held_out(Fitted(held_out, Selection(chosen, by_fold, ()), draft))

    return judged


@pytest.mark.slow
@pytest.mark.parametrize("step_ridge", [None, RIDGES[0]])
def test_the_saved_models_errors_are_those_of_its_settings_in_every_fold(
    calibration, held_out, judged, step_ridge
):
    """Where a fold chose otherwise the procedure's errors are of that, the saved model's of its own settings."""
    plain = replace(PLAIN, step_ridge=step_ridge)
    other = Candidate("polynomial", (("position_degrees", (1,)),))
    always, once = (judged(calibration, plain, by_first) for by_first in (plain, other))
    assert always.saved_errors == always.errors == once.saved_errors
    differing = {i for i in once.errors if once.errors[i] != once.saved_errors[i]}
    assert differing == set(held_out.folds[0].held_out)
    assert always.slope_sigma == once.slope_sigma, "a factor is of the other candidate's slopes"
    assert always.forward.residual_scale == once.forward.residual_scale


def test_what_is_an_outlier_is_told_as_the_calibration_will_tell_it(
    calibration, held_out, judged, monkeypatch
):
    """In units of what held-out presses leave unexplained, and with the channels that all presses have clipped.

    In those of the presses that train, half of a contact where nobody has pressed before would be taken for no gel.
    """
    used = []

    class Reconstructs(Reconstructor):
        def __init__(self, own, **more):
            used.append(own)
            super().__init__(own, **more)

    monkeypatch.setattr(module, "Reconstructor", Reconstructs)
    plain = replace(PLAIN, step_ridge=RIDGES[0])
    clipped = np.array([[True, False, False], [False, False, True]])
    draft = replace(calibration, forward=replace(calibration.forward, clipped=clipped, residual_scale=1.0))
    folds, measured = len(held_out.folds), judged(draft, plain, plain).forward
    assert measured.residual_scale > 1.5
    assert {own.forward.residual_scale for own in used} == {measured.residual_scale}
    assert all(own.forward.clipped is clipped for own in used)
    assert len({id(own.forward.nodes) for own in used[:folds]}) == folds, "each fitted without its fold"


@pytest.fixture
def first(calibration, presses):
    """The first press, its circle and its result."""
    row, press = calibration.report.presses[0], presses.presses[0]
    circle = (row.center_x_px, row.center_y_px, row.contact_radius_px)
    return press, circle, Reconstructor(calibration).from_image(press.image)


def test_thinning_keeps_the_press_and_an_empty_picture_is_no_crash(calibration, presses, first, monkeypatch):
    stated = first[2].gradients_sigma[..., 0]
    found = []
    for most in (10**6, 150):
        monkeypatch.setattr(module, "PRESS_PIXELS", most)
        found.append(errors_of(4, *first, calibration.mm_per_px, 0.85, stated=stated))
    (_, full, cap), (_, thin, same) = found
    assert 75 <= len(thin) <= 160 < len(full)
    assert set(full["press"]) == set(thin["press"]) == {4}
    np.testing.assert_array_equal(cap, same)
    assert off_deg(thin) == pytest.approx(off_deg(full), rel=0.15)
    assert {*zip(thin["x_px"], thin["y_px"])} <= {*zip(full["x_px"], full["y_px"])}
    np.testing.assert_array_equal(thin["stated"], at_pixels(stated, thin))
    blank = replace(first[0], image=presses.background.astype(np.uint8))
    result = Reconstructor(calibration).from_image(blank.image)
    assert errors_of(0, blank, first[1], result, calibration.mm_per_px, 0.85)[2].ndim == 2


def test_pixels_are_about_the_center_of_the_slopes_and_caps_about_that_of_the_depth(first):
    """Where the two differ by 4 px, each agrees with its own ball."""
    y, x = np.mgrid[:120, :160].astype(np.float32)
    depth_mm = 0.1 * np.sqrt(np.maximum(40**2 - (x - 82) ** 2 - (y - 60) ** 2, 0))
    gradients = ball_gradients(x, y, (78, 61), 40.0).astype(np.float32)
    result = SimpleNamespace(depth_mm=depth_mm, gradients=gradients, shape=depth_mm.shape)
    press = replace(first[0], ball_diameter_mm=8.0)
    _, pixels, cap_um = errors_of(0, press, (80.0, 60.0, 22.0), result, 0.1, 0.8)
    assert off_deg(pixels) < 0.05
    assert np.nanmax(np.abs(cap_um)) < 1


WHITE = SlopeSigma(
    rest=0.01, per_step=0.05, full_confidence_sigma=0.05, correlation_px=8.0, correlated_share=0.0
)


def stated(sample, presses, noise, rng):
    """The pixels of some presses, whose slopes are stated to be off by 0.05."""
    pixels = np.concatenate([sample(k, noise=noise, rng=rng) for k in range(presses)])
    pixels["stated"] = 0.05
    return pixels


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_factor_of_solved_slopes_leaves_68_percent_within(sample, factor):
    pixels = stated(sample, 8, 0.05 * factor, np.random.default_rng(0))
    found = with_factors(WHITE, pixels, [], 1.0, None)
    within = np.abs(pixels["solved"] - pixels["true"]) < 0.05 * found.solved_factor
    assert within.mean() == pytest.approx(ONE_SIGMA, abs=0.02)
    assert found.depth_factor == WHITE.depth_factor, "no press left room for it"


def test_pixels_beyond_the_edge_say_nothing(sample):
    """There the gel has left the ball: errors as large as one likes leave the factor as it is."""
    rng, ratio = np.random.default_rng(0), 0.7
    plain = stated(sample, 4, 0.05, rng)
    spoilt = plain.copy()
    spoilt["solved"] += (plain["rho"] >= ratio)[:, None]
    one, other = (with_factors(WHITE, pixels, [], 1.0, ratio) for pixels in (plain, spoilt))
    assert one == other
    assert one != with_factors(WHITE, spoilt, [], 1.0, None)


def far_depth(square, own=0.0, common=0.0):
    """Squared depths far from a contact whose variance by slopes is 1 for a factor of 1."""
    return np.stack(np.broadcast_arrays(square, own, 1.0, common)).astype(np.float32)


def test_the_factor_of_depth_covers_two_thirds_of_it_and_presses_count_alike():
    rng = np.random.default_rng(0)
    far = [far_depth(np.square(7 * rng.standard_normal(n))) for n in (5000, 50_000)]
    assert depth_factor(far, 0.0, 1.0) == pytest.approx(7, rel=0.02)
    halves = [far_depth(np.full(n, size**2)) for n, size in ((100, 2.0), (10_000, 4.0), (100, 3.0))]
    assert depth_factor(halves, 0.0, 1.0) == 4
    spoilt = [*far, far_depth(np.full(900, 7e4))]  # something else lay on the gel
    assert depth_factor(spoilt, 0.0, 1.0) == pytest.approx(7, rel=0.02)
    assert depth_factor([], 0.0, 11.0) == depth_factor([np.empty((4, 0), np.float32)], 0.0, 11.0) == 11


def test_a_tenth_of_depth_that_is_far_off_widens_the_factor():
    """Two thirds are within one sigma of 7, but 95 % within two sigma of more only."""
    squares = np.square(7 * np.random.default_rng(0).standard_normal(50_000))
    squares[::10] *= 16
    factor = depth_factor([far_depth(squares)], 0.0, 1.0)
    assert np.mean(squares < 4 * factor**2) == pytest.approx(0.9545, abs=0.002)
    assert factor > 8


def test_what_is_known_otherwise_does_not_count_in_the_factor_of_depth():
    squares = np.square(5 * np.random.default_rng(0).standard_normal(50_000))
    alone, with_common, with_own = (
        depth_factor([far_depth(squares, **how)], 0.1, 1.0) for how in ({}, {"common": 900.0}, {"own": 20.0})
    )
    assert alone == pytest.approx(5, rel=0.02)
    assert with_common == pytest.approx(4, rel=0.02), "of 25, 9 are in common"
    assert np.mean(squares < with_own**2 + 0.5 * max(20.0 - with_own**2, 0)) >= 0.68
    assert with_own <= alone


def test_the_errors_of_a_calibration_are_within_what_it_states(calibration, presses):
    """Of slopes and of depth far from contacts, on the presses that it was made of."""
    reconstruct = Reconstructor(calibration)
    shares, far = [], []
    for one in by_press(calibration.report.pixels):
        i, inner = one["press"][0], one[one["rho"] < 0.85]
        result, row = reconstruct.from_image(presses.presses[i].image), calibration.report.presses[i]
        sigma = at_pixels(result.gradients_sigma, inner)
        shares.append(np.mean(np.abs(inner["solved"] - inner["true"]) < sigma))
        y, x = np.ogrid[: result.shape[0], : result.shape[1]]
        away = np.hypot(x - row.center_x_px, y - row.center_y_px) > 2.5 * row.contact_radius_px
        if away.any():
            far.append(np.mean(np.abs(result.depth_mm[away]) < result.depth_sigma_mm[away]))
    assert 0.64 < np.mean(shares) < 0.84  # the presses are those of the fit
    assert 0.6 < np.mean(far) < 0.95
    assert calibration.slope_sigma.depth_factor != FIRST_GUESS.depth_factor


def test_what_slopes_of_one_size_share_is_common_and_their_noise_is_not(sample):
    rng = np.random.default_rng(0)
    noisy = [sample(k, gain=1 + 0.1 * (-1) ** k, noise=0.1, rng=rng) for k in range(8)]
    assert common_error(np.concatenate(noisy), WHITE) == pytest.approx(0.1, rel=0.1)
    clean = [sample(k, noise=0.1, rng=rng) for k in range(8)]
    assert common_error(np.concatenate(clean), WHITE) < 0.03
    assert common_error(sample()[:0], WHITE) == 0
    # Gentle slopes that are read too steep, and steep ones too gentle, cancel in the height of a ball.
    turned = sample()
    size = np.linalg.norm(turned["true"], axis=1)[:, None]
    turned["solved"] = turned["true"] * (1 + 0.1 * np.where(size < 0.4, 1, -1))
    assert common_error(turned, WHITE) == pytest.approx(0.1, rel=0.2)


def test_correlated_errors_count_once(sample):
    """Fields of errors that are alike over several pixels leave a mean in each ring, which is no common error."""
    rng = np.random.default_rng(0)
    fields = np.float32(rng.standard_normal((30, 60, 80, 2)))
    fields = gaussian_filter(fields, (0, 5 / 2**0.5, 5 / 2**0.5, 0))
    fields *= 0.1 / fields.std()
    presses = [sample(k) for k in range(len(fields))]
    for one, field in zip(presses, fields):
        one["solved"] = one["true"] + at_pixels(field, one)
    alike, pixels = replace(WHITE, correlation_px=5.0, correlated_share=1.0), np.concatenate(presses)
    assert common_error(pixels, alike) < 0.5 * common_error(pixels, WHITE)


def test_the_common_error_is_that_of_the_depth_by_the_share_of_presses_that_folds_have_seen(calibration):
    folds = [Fold((0, 1), tuple(range(2, 10)), ()), Fold((2, 3, 4, 5), (0, 1, 6, 7, 8, 9), ())]
    assert fraction_trained(folds) == pytest.approx((0.8 + 0.6) / 2)
    off = calibration.report.pixels.copy()
    off["solved"], off["stated"] = 0.7 * off["true"], 0.05
    for trained in (1.0, 0.5):
        sigma = with_factors(calibration.slope_sigma, off, [], trained, 0.85)
        assert sigma.gain_sigma == pytest.approx(0.3 * np.sqrt(trained), rel=0.2)
    assert 0 < calibration.slope_sigma.gain_sigma < 0.12
