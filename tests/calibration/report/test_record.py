"""What a calibration run found, as its report lists it."""

import json

import numpy as np
import pytest

from gelform.calibration.report.record import FIGURES, summary
from gelform.result.metrics import PressErrors


def test_every_press_has_a_row_and_only_accepted_ones_have_errors(presses, calibration):
    rows = calibration.report.presses
    assert [row.name for row in rows] == [press.name for press in presses.presses]
    assert any(row.accepted for row in rows)
    for row in rows:
        assert row.accepted == (row.reason is None) == (row.errors is not None)
        assert (row.center_sigma_px is not None) == row.accepted


def test_one_candidate_is_chosen_and_none_has_no_error(calibration):
    tried = calibration.report.candidates
    assert sum(one["chosen"] for one in tried) == 1
    errors = [one["slope_error"] for one in tried]
    assert errors == sorted(errors), "the best one first"
    assert errors[0] > 0
    assert tried[0]["chosen"], "by its error alone"
    for one in tried:
        assert 30 * one["slope_error"] < one["normal_free_deg"] < 70 * one["slope_error"], (
            "of the same slopes"
        )


def test_it_is_json_without_the_samples(calibration):
    content = json.loads(json.dumps(calibration.report.to_dict()))
    assert "samples" not in content
    assert "start" not in content
    assert content["held_out"]["presses"] == sum(row.accepted for row in calibration.report.presses)


def test_the_summary_is_of_all_presses():
    names = PressErrors.__dataclass_fields__
    errors = [PressErrors(**dict.fromkeys(names, value)) for value in (1.0, 2.0, 6.0)]
    said = summary(errors)
    assert said["presses"] == 3
    assert said["normal_free_deg"] == pytest.approx(3.0)
    assert np.isfinite(list(said.values())).all()


def test_the_notes_say_how_often_folds_agreed_and_whence_the_scale_is(calibration):
    report = calibration.report
    held_out, *others = report.notes
    assert f"{report.held_out['presses']:.0f} presses in 5 folds" in held_out
    assert " of 5 folds chose" in held_out
    assert any("The scale comes from the number given" in note for note in others)


def test_every_figure_has_words(calibration):
    assert list(calibration.report.held_out) == list(FIGURES)
    assert len(set(FIGURES.values())) == len(FIGURES)
