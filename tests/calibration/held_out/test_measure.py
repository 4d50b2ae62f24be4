"""Held-out samples: the same errors as the run's figures, and binned truths that are put in come out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

import gelform
from gelform.calibration.candidates import Candidate
from gelform.calibration.circles.locate import Located, Refined
from gelform.calibration.fitted import Fitted
from gelform.calibration.held_out import measure as module
from gelform.calibration.held_out.measure import (
    common_error,
    errors_of,
    measure_held_out,
    sample_of,
    solved_by_place,
    stated_sigma,
)
from gelform.calibration.held_out.scores import Selection
from gelform.calibration.report.statistics import fraction_within_sigma
from gelform.reconstruct import Reconstructor
from gelform.result.metrics import angle_deg
from gelform.slopes.color_models.forward_response import RIDGES
from gelform.slopes.confidence import all_shown
from gelform.slopes.confidence.slope_sigma import ONE_SIGMA, SlopeSigma


def off_deg(sample):
    """Mean angle to the ball's normals."""
    return angle_deg(sample.gradients, sample.true_gradients).mean()


def test_samples_carry_the_errors_of_the_report(calibration):
    """Those up to the visible rim; inside the contact's edge they are the figures that the report counts first."""
    report, ratio = calibration.report, calibration.settings["contact_radius_ratio"]
    assert len(report.samples) > 3
    assert "samples" not in report.to_dict()
    assert {one.index for one in report.samples} == {i for i, row in enumerate(report.presses) if row.errors}
    for one in report.samples:
        errors = report.presses[one.index].errors
        assert off_deg(one) == pytest.approx(errors["normal_rim_deg"], rel=0.02)
        assert off_deg(one.within(ratio)) == pytest.approx(errors["normal_free_deg"], rel=0.02)
        assert np.nanstd(one.cap_error_um) > 0.9 * errors["cap_free_um"], "its rim is counted"
        assert np.nanmean(one.cap_error_um) == pytest.approx(0, abs=1e-2)


@pytest.mark.slow
def test_each_press_is_reconstructed_once(presses, monkeypatch):
    seen = []
    plain = Reconstructor.from_image

    def counted(self, image):
        seen.append(id(image))
        return plain(self, image)

    monkeypatch.setattr(Reconstructor, "from_image", counted)
    report = gelform.calibrate(presses.subset(range(8)), color_model="polynomial").report
    assert len(set(seen)) == sum(row.accepted for row in report.presses)
    # By its fold, by all with walls and without, where its fold chose otherwise, and for the error of its place.
    assert all(seen.count(one) <= 5 for one in seen)


@pytest.fixture(scope="module")
def judged(presses, prepared, found, held_out):
    """Judges a calibration with what was selected."""
    refined = Refined(tuple(found), (None,) * len(found), None)
    located = Located(presses, prepared, found, refined)
    return lambda draft, chosen, by_fold: measure_held_out(
        Fitted(located, held_out, Selection(chosen, by_fold, ()), draft)
    )


@pytest.mark.slow
@pytest.mark.parametrize("step_ridge", [None, RIDGES[0]])
def test_the_saved_models_errors_are_those_of_its_settings_in_every_fold(
    calibration, held_out, judged, step_ridge
):
    """Where a fold chose otherwise the procedure's errors are of that, the saved model's of its own settings."""
    plain = Candidate("polynomial", (("position_degrees", (2, 1)),), step_ridge=step_ridge)
    other = Candidate("polynomial", (("position_degrees", (1,)),))
    folds = len(held_out.folds)
    always, once = (
        judged(calibration, plain, by_fold)
        for by_fold in ((plain,) * folds, (other,) + (plain,) * (folds - 1))
    )
    assert always.saved_errors == always.errors == once.saved_errors
    differing = {i for i in once.errors if once.errors[i] != once.saved_errors[i]}
    assert differing == set(held_out.folds[0].held_out)
    assert always.slope_sigma.sigmas == once.slope_sigma.sigmas
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
    plain = Candidate("polynomial", (("position_degrees", (2, 1)),), step_ridge=RIDGES[0])
    clipped = np.array([[True, False, False], [False, False, True]])
    draft = replace(calibration, forward=replace(calibration.forward, clipped=clipped, residual_scale=1.0))
    folds = len(held_out.folds)
    measured = judged(draft, plain, (plain,) * folds).forward
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


def test_thinning_keeps_the_press_and_an_empty_picture_is_no_crash(calibration, presses, first):
    full, thin = (sample_of(0, *first, calibration.mm_per_px, 0.85, max_pixels=n) for n in (10**6, 150))
    assert 75 <= len(thin.x_px) <= 160 < len(full.x_px)
    assert thin.circle_px == full.circle_px
    assert off_deg(thin) == pytest.approx(off_deg(full), rel=0.15)
    assert {*zip(thin.x_px, thin.y_px)} <= {*zip(full.x_px, full.y_px)}
    blank = replace(first[0], image=presses.background.astype(np.uint8))
    result = Reconstructor(calibration).from_image(blank.image)
    assert sample_of(0, blank, first[1], result, calibration.mm_per_px, 0.85).cap_error_um.ndim == 2


def test_errors_are_counted_inside_the_edge(calibration, first):
    """The figures that do not say otherwise; a rim that is read wrong changes the rim's alone."""
    press, circle, result = first
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    beyond = np.hypot(x - circle[0], y - circle[1]) > 0.75 * circle[2]
    spoilt = replace(result, gradients=np.where(beyond[..., None], 0, result.gradients).astype(np.float32))
    plain, rim = (errors_of(press, circle, one, calibration.mm_per_px, 0.7) for one in (result, spoilt))
    assert plain.normal_free_deg == pytest.approx(rim.normal_free_deg, rel=0.02)
    assert rim.normal_rim_deg > plain.normal_rim_deg + 3


def test_within_keeps_the_middle(sample):
    one = sample()
    half = one.within(0.5)
    assert 0 < len(half.x_px) < len(one.x_px)
    assert np.hypot(half.x_px - 40, half.y_px - 30).max() < 12.5


@pytest.fixture
def readings_alone(calibration, monkeypatch):
    """Without what blur takes at walls, which is stated whatever presses of balls say."""
    monkeypatch.setattr("gelform.slopes.confidence.solved.BLURRED", 0.0)
    return calibration


def share_of(calibration, presses, sigma):
    reconstruct = Reconstructor(replace(calibration, slope_sigma=sigma), depth_sigma=False)
    reconstruct.steep_slopes = all_shown
    samples = [one.within(0.85) for one in calibration.report.samples]
    sigmas = [stated_sigma(reconstruct, presses.presses[one.index].image, one) for one in samples]
    return fraction_within_sigma(samples, sigmas, calibration.image_shape, (1, 1))["all"]


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


WHITE = SlopeSigma(0.01, (0.0, 1.0), (0.05, 0.05), 0.05, 8.0, correlated_share=0.0)


def test_what_slopes_of_one_size_share_is_common_and_their_noise_is_not(sample):
    rng = np.random.default_rng(0)
    noisy = [sample(k, gain=1 + 0.1 * (-1) ** k, noise=0.1, rng=rng) for k in range(8)]
    assert common_error(noisy, WHITE) == pytest.approx(0.1, rel=0.1)
    clean = [sample(k, noise=0.1, rng=rng) for k in range(8)]
    assert common_error(clean, WHITE) < 0.03
    assert common_error([sample().within(0)], WHITE) == 0


def test_errors_that_cancel_in_the_height_of_a_ball_are_common_to_slopes_of_one_size(sample):
    """Gentle slopes are read too steep, and steep ones too gentle."""
    one = sample()
    size = np.linalg.norm(one.true_gradients, axis=1)[:, None]
    turned = replace(one, gradients=one.true_gradients * (1 + 0.1 * np.where(size < 0.4, 1, -1)))
    assert common_error([turned], WHITE) == pytest.approx(0.1, rel=0.2)


def test_correlated_errors_count_once(sample):
    """Fields of errors that are alike over several pixels leave a mean in each ring, which is no common error."""
    rng = np.random.default_rng(0)
    fields = np.float32(rng.standard_normal((30, 60, 80, 2)))
    fields = gaussian_filter(fields, (0, 5 / 2**0.5, 5 / 2**0.5, 0))
    fields *= 0.1 / fields.std()
    samples = []
    for field in fields:
        one = sample()
        there = field[one.y_px.astype(int), one.x_px.astype(int)]
        samples.append(replace(one, gradients=one.true_gradients + there))
    alike = replace(WHITE, correlation_px=5.0, correlated_share=1.0)
    assert common_error(samples, alike) < 0.5 * common_error(samples, WHITE)


def test_the_common_error_of_the_folds_is_that_of_the_depth(calibration, presses):
    samples = calibration.report.samples
    off = [replace(one, gradients=0.7 * one.true_gradients) for one in samples]
    for trained in (1.0, 0.5):
        sigma = solved_by_place(calibration, calibration.slope_sigma, presses, off, trained)
        assert sigma.gain_sigma == pytest.approx(0.3 * np.sqrt(trained), rel=0.2)
    assert 0 < calibration.slope_sigma.gain_sigma < 0.12


def test_what_blur_takes_is_not_learnt_from_balls(calibration, presses, monkeypatch):
    """A large part of the error is foretold by it: the readings' factors have less left to explain."""
    samples, known = calibration.report.samples, calibration.slope_sigma
    sharp = replace(
        known, sigmas=tuple(s / 4 for s in known.sigmas)
    )  # else a ball's bends are within their noise
    found = []
    for blurred in (0.0, 0.6):
        monkeypatch.setattr("gelform.slopes.confidence.solved.BLURRED", blurred)
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
        spoilt.append(replace(one, gradients=one.gradients + np.float32(beyond[:, None])))
    assert any(np.any(one.gradients != other.gradients) for one, other in zip(plain, spoilt))
    known = [
        solved_by_place(readings_alone, readings_alone.slope_sigma, presses, samples, 1.0).solved_places
        for samples in (plain, spoilt)
    ]
    assert known[0] == known[1]
