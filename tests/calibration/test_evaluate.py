"""evaluate: says what was seen, uses labels where there are any, and measures through the whole path."""

from dataclasses import replace

import numpy as np
import pytest

import gelform


def test_seen_presses_are_counted(calibration, presses):
    evaluation = gelform.evaluate(calibration, presses)
    assert evaluation.seen == len(calibration.training_digests)
    other = replace(presses.presses[0], digest="new")
    assert gelform.evaluate(calibration, replace(presses, presses=(other,))).seen == 0


def test_labels_are_used(calibration, presses, simulated):
    truth = simulated.presses[0]
    label = (*truth.center_px, truth.contact_radius_px)
    labelled = replace(presses, presses=(replace(presses.presses[0], label=label),))
    evaluation = gelform.evaluate(calibration, labelled)
    assert evaluation.rows[0]["circle_px"] == label
    assert evaluation.summary["normal_deg"] < 6


def test_untouched_images_cannot_be_evaluated(calibration, presses):
    rest = replace(presses.presses[0], image=np.round(presses.background).astype(np.uint8))
    with pytest.raises(gelform.DataError, match="could be evaluated"):
        gelform.evaluate(calibration, replace(presses, presses=(rest,)))
