"""Held-out samples: the same errors as the run's figures, and binned truths that are put in come out."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.ball import ball_gradients
from gelform.calibration.report.held_out import (
    SLOPE_EDGES,
    HeldOutSample,
    cells_of,
    error_map,
    gain_curve,
    held_out_sample,
    share_within_sigma,
    stated_sigma,
)
from gelform.reconstruct import Reconstructor

SHAPE = (60, 80)


def sample(index=0, *, gain=1.0, noise=0.0, bias=(0.0, 0.0), circle=(40.0, 30.0, 25.0), rng=None):
    """Pixels of a ball of radius 40 px, read with a gain, a bias and noise."""
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    inside = np.hypot(x - circle[0], y - circle[1]) < circle[2] - 2
    x, y = x[inside].astype(np.float32), y[inside].astype(np.float32)
    true = ball_gradients(x, y, circle[:2], 40.0)
    seen = gain * true + np.asarray(bias)
    if noise:
        seen = seen + noise * rng.standard_normal(true.shape)
    empty = np.zeros((3, 3), dtype=np.float32)
    return HeldOutSample(index, circle, x, y, true.astype(np.float32), seen.astype(np.float32), empty)


def test_samples_carry_the_errors_of_the_report(calibration):
    report = calibration.report
    assert [one.index for one in report.samples] != []
    assert {one.index for one in report.samples} == {i for i, row in enumerate(report.presses) if row.errors}
    for one in report.samples:
        errors = report.presses[one.index].errors
        assert one.normal_deg == pytest.approx(errors["normal_free_deg"], rel=0.02)
        assert np.nanstd(one.cap_error_um) == pytest.approx(errors["cap_free_um"], rel=1e-3)
        assert np.nanmean(one.cap_error_um) == pytest.approx(0, abs=1e-2)


def test_samples_are_not_in_the_json_record(calibration):
    assert "samples" not in calibration.report.to_dict()
    assert len(calibration.report.samples) > 3


def test_thinning_keeps_the_press(calibration, presses):
    report = calibration.report
    one = report.samples[0]
    row, press = report.presses[one.index], presses.presses[one.index]
    circle = (row.center_x_px, row.center_y_px, row.contact_radius_px)
    reconstruct = Reconstructor(calibration)
    full = held_out_sample(0, press, circle, reconstruct, max_pixels=10**6)
    thin = held_out_sample(0, press, circle, reconstruct, max_pixels=150)
    assert 75 <= len(thin.x_px) <= 160 < len(full.x_px)
    assert thin.circle_px == full.circle_px
    assert thin.normal_deg == pytest.approx(full.normal_deg, rel=0.15)
    assert {*zip(thin.x_px, thin.y_px)} <= {*zip(full.x_px, full.y_px)}


def test_within_keeps_the_middle():
    one = sample()
    half = one.within(0.5)
    assert 0 < len(half.x_px) < len(one.x_px)
    assert np.hypot(half.x_px - 40, half.y_px - 30).max() < 12.5
    assert half.true_slope.max() < one.true_slope.max()


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.25])
def test_a_gain_is_found_in_every_bin_whatever_the_noise(gain):
    rng = np.random.default_rng(1)
    samples = [sample(k, gain=gain, noise=0.1, rng=rng) for k in range(6)]
    curve = gain_curve(samples, np.random.default_rng(0))
    assert len(curve) >= 5
    assert {b["slope_from"] for b in curve} <= set(SLOPE_EDGES)
    for b in curve[1:]:
        assert b["gain"] == pytest.approx(gain, abs=0.05)
        assert b["interval"][0] <= b["gain"] <= b["interval"][1]
        assert b["presses"] == 6


def test_intervals_are_over_presses_not_pixels():
    """Presses that differ make a wide interval, however many pixels each has."""
    alike = gain_curve([sample(k, gain=1.0) for k in range(8)], np.random.default_rng(0))
    differ = gain_curve([sample(k, gain=0.8 + 0.05 * k) for k in range(8)], np.random.default_rng(0))
    width = [b["interval"][1] - b["interval"][0] for b in (alike[2], differ[2])]
    assert width[0] < 1e-3 < 0.1 < width[1]


def test_bins_of_few_presses_are_left_out():
    assert gain_curve([sample(0), sample(1)], np.random.default_rng(0)) == []


def test_cells_are_counted_along_rows():
    assert cells_of(np.array([0, 79, 0, 79]), np.array([0, 0, 59, 59]), SHAPE, (3, 4)).tolist() == [
        0,
        3,
        8,
        11,
    ]


def test_the_error_map_has_the_bias_where_it_is():
    left = sample(0, bias=(0.1, 0.0), circle=(20.0, 30.0, 18.0))
    right = sample(1, bias=(0.0, -0.2), circle=(60.0, 30.0, 18.0))
    errors = error_map([left, right], SHAPE, (1, 2))
    np.testing.assert_allclose(errors["mean"], [[0.1, 0.0], [0.0, -0.2]], atol=1e-6)
    np.testing.assert_allclose(errors["rms"], [0.1, 0.2], atol=1e-6)
    assert errors["pixels"] == [len(left.x_px), len(right.x_px)]
    assert error_map([left], SHAPE, (1, 2))["rms"][1] is None


def test_a_right_sigma_holds_68_percent_everywhere():
    rng = np.random.default_rng(2)
    samples = [sample(k, noise=0.01, rng=rng) for k in range(8)]
    sigmas = [np.full_like(one.gradients, 0.01) for one in samples]
    share = share_within_sigma(samples, sigmas, SHAPE, (2, 2))
    assert share["all"] == pytest.approx(0.683, abs=0.01)
    assert all(0.63 < one["share"] < 0.73 for one in share["by_slope"][1:-1])
    assert all(0.65 < one < 0.72 for one in share["by_place"])
    halved = share_within_sigma(samples, [s / 2 for s in sigmas], SHAPE, (2, 2))
    assert halved["all"] == pytest.approx(0.383, abs=0.01)


def test_sigma_is_what_users_are_told_and_wide_where_clipped(calibration, presses):
    one, reconstruct = calibration.report.samples[0], Reconstructor(calibration)
    image = presses.presses[one.index].image
    sigma = stated_sigma(reconstruct, image, one)
    assert sigma.shape == one.gradients.shape
    row, column = int(one.y_px[0]), int(one.x_px[0])
    np.testing.assert_array_equal(sigma[0], reconstruct(image).gradients_sigma[row, column])
    clipped = image.copy()
    clipped[row, column] = 255
    assert stated_sigma(reconstruct, clipped, one)[0, 0] > 2 * sigma[0, 0]


def test_a_ball_outside_the_frame_has_no_cap(calibration, presses):
    """A circle whose pixels lead the fit away is an empty picture, not a crash."""
    report = calibration.report
    blank = replace(presses.presses[0], image=presses.background.astype(np.uint8))
    row = report.presses[0]
    one = held_out_sample(
        0, blank, (row.center_x_px, row.center_y_px, row.contact_radius_px), Reconstructor(calibration)
    )
    assert one.cap_error_um.ndim == 2
