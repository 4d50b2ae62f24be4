"""Statistics of residuals: truths that are put into samples come out of them."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.held_out.measure import at_sample
from gelform.calibration.report.statistics import (
    SLOPE_EDGES,
    error_map,
    errors_where,
    fraction_within_sigma,
    gain_curve,
    square_error_by_direction,
)
from gelform.reconstruct import Reconstructor
from gelform.result.metrics import angle_deg

SHAPE = (60, 80)


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.25])
def test_a_gain_is_found_in_every_bin_whatever_the_noise(sample, gain):
    rng = np.random.default_rng(1)
    samples = [sample(k, gain=gain, noise=0.1, rng=rng) for k in range(6)]
    curve = gain_curve(samples, np.random.default_rng(0))
    assert len(curve) >= 5
    assert {b["slope_from"] for b in curve} <= set(SLOPE_EDGES)
    for b in curve[1:]:
        assert b["gain"] == pytest.approx(gain, abs=0.05)
        assert b["interval"][0] <= b["gain"] <= b["interval"][1]
        assert b["presses"] == 6


def test_intervals_are_over_presses_not_pixels(sample):
    """Presses that differ make a wide interval, however many pixels each has; bins of few are left out."""
    alike = gain_curve([sample(k, gain=1.0) for k in range(8)], np.random.default_rng(0))
    differ = gain_curve([sample(k, gain=0.8 + 0.05 * k) for k in range(8)], np.random.default_rng(0))
    width = [b["interval"][1] - b["interval"][0] for b in (alike[2], differ[2])]
    assert width[0] < 1e-3 < 0.1 < width[1]
    assert gain_curve([sample(0), sample(1)], np.random.default_rng(0)) == []


def test_the_error_map_has_the_bias_where_it_is(sample):
    left = sample(0, bias=(0.1, 0.0), circle=(20.0, 30.0, 18.0))
    right = sample(1, bias=(0.0, -0.2), circle=(60.0, 30.0, 18.0))
    errors = error_map([left, right], SHAPE, (1, 2))
    np.testing.assert_allclose(errors["mean"], [[0.1, 0.0], [0.0, -0.2]], atol=1e-6)
    np.testing.assert_allclose(errors["rms"], [0.1, 0.2], atol=1e-6)
    assert errors["pixels"] == [len(left.x_px), len(right.x_px)]
    assert error_map([left], SHAPE, (1, 2))["rms"][1] is None


def test_square_errors_stand_where_and_whither_they_are(sample):
    """A bias on the left alone: large there in every direction, the overall mean where nothing was measured."""
    samples = [sample(0, bias=(0.3, 0.0), circle=(20.0, 30.0, 18.0)), sample(1, circle=(60.0, 30.0, 18.0))]
    errors = square_error_by_direction(samples, SHAPE, (3, 2))
    pixels = sum(len(one.x_px) for one in samples)
    overall = 0.09 * len(samples[0].x_px) / pixels
    assert errors.shape == (3, 2, 8)
    assert (errors[1, 0] > overall).all()
    assert (errors[1, 1] < overall).all()
    assert square_error_by_direction(samples[:1], SHAPE, (3, 2))[0, 1] == pytest.approx([0.09] * 8, rel=1e-5)


def test_a_right_sigma_holds_68_percent_everywhere(sample):
    rng = np.random.default_rng(2)
    samples = [sample(k, noise=0.01, rng=rng) for k in range(8)]
    sigmas = [np.full_like(one.gradients, 0.01) for one in samples]
    share = fraction_within_sigma(samples, sigmas, SHAPE, (2, 2))
    assert share["all"] == pytest.approx(0.683, abs=0.01)
    assert all(0.63 < one["share"] < 0.73 for one in share["by_slope"][1:-1])
    assert all(0.65 < one < 0.72 for one in share["by_place"])
    halved = fraction_within_sigma(samples, [s / 2 for s in sigmas], SHAPE, (2, 2))
    assert halved["all"] == pytest.approx(0.383, abs=0.01)


def test_sigma_is_what_users_are_told_and_wide_where_clipped(calibration, presses):
    one, reconstruct = calibration.report.samples[0], Reconstructor(calibration)
    image = presses.presses[one.index].image
    sigma = at_sample(reconstruct(image).gradients_sigma, one)
    assert sigma.shape == one.gradients.shape
    row, column = int(one.y_px[0]), int(one.x_px[0])
    np.testing.assert_array_equal(sigma[0], reconstruct(image).gradients_sigma[row, column])
    clipped = image.copy()
    clipped[row, column] = 255
    assert at_sample(reconstruct(clipped).gradients_sigma, one)[0, 0] > 2 * sigma[0, 0]


CIRCLE = (40.0, 30.0, 25.0)


def with_errors(sample, mask, gain=0.7):
    gradients = np.where(mask[:, None], gain * sample.true_gradients, sample.true_gradients)
    return replace(sample, gradients=gradients.astype(np.float32))


def rho(sample):
    return np.hypot(sample.x_px - CIRCLE[0], sample.y_px - CIRCLE[1]) / CIRCLE[2]


def test_a_flat_rim_is_up_to_the_rim_and_not_inside_the_edge(sample):
    one = sample(0, circle=CIRCLE)
    flat = with_errors(one, rho(one) >= 0.8)
    where = errors_where([flat], SHAPE, 0.8)
    expected = angle_deg(flat.gradients, flat.true_gradients)
    assert where["contact_radius_ratio"] == 0.8
    assert where["contact"]["normal_deg"] == pytest.approx(0, abs=1e-4)
    assert where["rim"]["normal_deg"] == pytest.approx(expected.mean(), rel=1e-6)
    assert expected.mean() > 1
    steep = where["rim"]["by_slope"][-1]
    assert steep["gain"] == pytest.approx(0.7, abs=1e-5)
    assert steep["slope_from"] >= 0.6 > where["contact"]["by_slope"][-1]["slope_from"]
    assert all(b["gain"] == pytest.approx(1, abs=1e-5) for b in where["contact"]["by_slope"])
    part = errors_where([flat], SHAPE, 0.9)["contact"]["normal_deg"]
    assert part == pytest.approx(expected[rho(one) < 0.9].mean(), rel=1e-5), "the edge says what is counted"


def test_errors_stand_in_the_slope_bin_that_has_them(sample):
    one = sample(0, circle=CIRCLE)
    gentle = with_errors(one, np.linalg.norm(one.true_gradients, axis=1) < 0.2, gain=1.3)
    for b in errors_where([gentle], SHAPE, 1.0)["contact"]["by_slope"]:
        assert b["gain"] == pytest.approx(1.3 if b["slope_to"] <= 0.2 else 1.0, abs=1e-5)
        assert (b["normal_deg"] > 0.1) == (b["slope_to"] <= 0.2)


def test_errors_stand_in_the_place_that_has_them(sample):
    left, right = sample(0, circle=(20.0, 30.0, 18.0)), sample(1, circle=(60.0, 30.0, 18.0), gain=0.8)
    place = errors_where([left, right], SHAPE, 1.0, (1, 2))["contact"]["by_place"]
    assert place["pixels"] == [len(left.x_px), len(right.x_px)]
    assert place["normal_deg"][0] == pytest.approx(0, abs=1e-4)
    assert place["normal_deg"][1] == pytest.approx(
        angle_deg(right.gradients, right.true_gradients).mean(), rel=1e-5
    )
    assert errors_where([left], SHAPE, 1.0, (1, 2))["contact"]["by_place"]["normal_deg"][1] is None
