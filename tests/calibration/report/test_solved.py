"""Factors of the solved slopes' deviation: learnt on presses that were held out, stated by the calibration."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.report.residuals import share_within_sigma, stated_sigma
from gelform.calibration.report.solved import solved_by_place
from gelform.confidence.slope_sigma import ONE_SIGMA
from gelform.reconstruct import Reconstructor


@pytest.fixture
def readings_alone(calibration, monkeypatch):
    """Without what blur takes at walls, which is stated whatever presses of balls say."""
    monkeypatch.setattr("gelform.confidence.solved.BLURRED", 0.0)
    return calibration


def share_of(calibration, presses, sigma):
    reconstruct = Reconstructor(replace(calibration, slope_sigma=sigma), depth_sigma=False)
    samples = [one.within(0.85) for one in calibration.report.samples]
    sigmas = [stated_sigma(reconstruct, presses.presses[one.index].image, one) for one in samples]
    return share_within_sigma(samples, sigmas, calibration.image_shape, (1, 1))["all"]


@pytest.mark.parametrize("factor", [0.4, 2.5])
def test_a_deviation_that_is_off_is_put_right(readings_alone, presses, factor):
    calibration = readings_alone
    right = calibration.slope_sigma
    off = replace(
        right, sigmas=tuple(factor * s for s in right.sigmas), solved_places=None, solved_slopes=None
    )
    again = solved_by_place(calibration, off, presses, calibration.report.samples, 1.0)
    assert share_of(calibration, presses, again) == pytest.approx(ONE_SIGMA, abs=0.06)
    assert abs(share_of(calibration, presses, off) - ONE_SIGMA) > 0.12


def test_fewer_presses_seen_by_the_folds_make_them_better_witnesses_of_worse_models(readings_alone, presses):
    sigma = replace(readings_alone.slope_sigma, solved_places=None, solved_slopes=None)
    samples = readings_alone.report.samples
    half, all_ = (
        np.mean(solved_by_place(readings_alone, sigma, presses, samples, seen).solved_places)
        for seen in (0.5, 1.0)
    )
    assert half == pytest.approx(np.sqrt(0.5) * all_, rel=0.15)


def test_what_blur_takes_is_not_learnt_from_balls(calibration, presses, monkeypatch):
    """A large part of the error is foretold by it: the readings' factors have less left to explain."""
    samples, known = calibration.report.samples, calibration.slope_sigma
    sharp = replace(
        known, sigmas=tuple(s / 4 for s in known.sigmas)
    )  # else a ball's bends are within their noise
    found = []
    for blurred in (0.0, 0.6):
        monkeypatch.setattr("gelform.confidence.solved.BLURRED", blurred)
        found.append(solved_by_place(calibration, sharp, presses, samples, 1.0))
    assert np.mean(found[1].solved_places) < 0.9 * np.mean(found[0].solved_places)


def test_pixels_beyond_the_edge_say_nothing(readings_alone, presses):
    """There the gel has left the ball: errors as large as one likes leave the factors as they are."""
    ratio = readings_alone.settings["contact_radius_ratio"]
    plain = readings_alone.report.samples
    spoilt = []
    for one in plain:
        x, y, radius = one.circle_px
        beyond = np.hypot(one.x_px - x, one.y_px - y) >= ratio * radius
        assert beyond.any()
        spoilt.append(replace(one, gradients=one.gradients + np.float32(beyond[:, None])))
    known = [
        solved_by_place(readings_alone, readings_alone.slope_sigma, presses, samples, 1.0).solved_places
        for samples in (plain, spoilt)
    ]
    assert known[0] == known[1]
