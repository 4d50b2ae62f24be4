"""Held-out samples: the same errors as the run's figures, and binned truths that are put in come out."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.report.held_out import measure_held_out, sample_of
from gelform.calibration.selection.candidates import Candidate
from gelform.calibration.selection.folds import make_folds
from gelform.calibration.selection.select import Selection
from gelform.calibration.selection.trials import HeldOutPresses
from gelform.reconstruct import Reconstructor


def test_samples_carry_the_errors_of_the_report(calibration):
    report = calibration.report
    assert [one.index for one in report.samples] != []
    assert {one.index for one in report.samples} == {i for i, row in enumerate(report.presses) if row.errors}
    for one in report.samples:
        errors = report.presses[one.index].errors
        assert one.normal_deg == pytest.approx(errors["normal_free_deg"], rel=0.02)
        assert np.nanstd(one.cap_error_um) == pytest.approx(errors["cap_free_um"], rel=1e-3)
        assert np.nanmean(one.cap_error_um) == pytest.approx(0, abs=1e-2)


def test_each_press_is_reconstructed_once(presses, monkeypatch):
    seen = []
    plain = Reconstructor.from_image

    def counted(self, image):
        seen.append(id(image))
        return plain(self, image)

    monkeypatch.setattr(Reconstructor, "from_image", counted)
    report = gelform.calibrate(presses.subset(range(8)), color_model="polynomial").report
    assert len(set(seen)) == sum(row.accepted for row in report.presses)
    assert all(
        seen.count(one) <= 3 for one in seen
    )  # by its fold and by all; once more where the fold chose otherwise


def test_the_saved_models_errors_are_those_of_its_settings_in_every_fold(presses, calibration):
    """Where a fold chose otherwise the procedure's errors are of that, the saved model's of its own settings."""
    prepared = prepare(presses)
    found = find_contacts(prepared)
    held_out = HeldOutPresses({10.0: prepared}, found, make_folds(prepared, found, range(len(prepared))), [])
    plain, other = (Candidate("polynomial", 0.8, (("position_degrees", d),)) for d in ((2, 1), (1,)))
    folds = len(held_out.folds)
    always, once = (
        measure_held_out(calibration, presses, held_out, Selection(plain, by_fold, ()))
        for by_fold in ((plain,) * folds, (other,) + (plain,) * (folds - 1))
    )
    assert always.saved_errors == always.errors == once.saved_errors
    differing = {i for i in once.errors if once.errors[i] != once.saved_errors[i]}
    assert differing == set(held_out.folds[0].held_out)


def test_samples_are_not_in_the_json_record(calibration):
    assert "samples" not in calibration.report.to_dict()
    assert len(calibration.report.samples) > 3


def test_thinning_keeps_the_press(calibration, presses):
    report = calibration.report
    one = report.samples[0]
    row, press = report.presses[one.index], presses.presses[one.index]
    circle = (row.center_x_px, row.center_y_px, row.contact_radius_px)
    result = Reconstructor(calibration).from_image(press.image)
    full = sample_of(0, press, circle, result, calibration.mm_per_px, max_pixels=10**6)
    thin = sample_of(0, press, circle, result, calibration.mm_per_px, max_pixels=150)
    assert 75 <= len(thin.x_px) <= 160 < len(full.x_px)
    assert thin.circle_px == full.circle_px
    assert thin.normal_deg == pytest.approx(full.normal_deg, rel=0.15)
    assert {*zip(thin.x_px, thin.y_px)} <= {*zip(full.x_px, full.y_px)}


def test_within_keeps_the_middle(sample):
    one = sample()
    half = one.within(0.5)
    assert 0 < len(half.x_px) < len(one.x_px)
    assert np.hypot(half.x_px - 40, half.y_px - 30).max() < 12.5
    assert half.true_slope.max() < one.true_slope.max()


def test_a_ball_outside_the_frame_has_no_cap(calibration, presses):
    """A circle whose pixels lead the fit away is an empty picture, not a crash."""
    report = calibration.report
    blank = replace(presses.presses[0], image=presses.background.astype(np.uint8))
    row = report.presses[0]
    circle = (row.center_x_px, row.center_y_px, row.contact_radius_px)
    result = Reconstructor(calibration).from_image(blank.image)
    one = sample_of(0, blank, circle, result, calibration.mm_per_px)
    assert one.cap_error_um.ndim == 2


def test_the_share_of_error_in_solved_slopes_is_measured(calibration):
    """Some of the errors of slopes have curl, which no surface follows; some are those of a surface."""
    assert 0.3 < calibration.slope_sigma.solved_factor < 1
