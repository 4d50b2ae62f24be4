"""The numbers of the report: those of the run, with intervals, in JSON; another folder's presses are refused."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.report.content import FORMAT, interval_of, report_content


def test_figures_are_the_runs_own(content, calibration):
    for name, one in content["figures"].items():
        assert one["value"] == pytest.approx(calibration.held_out[name])
        assert one["interval"][0] <= one["value"] <= one["interval"][1]
    assert content["figures"]["radius_percent"]["statistic"] == "median"


def test_it_is_json_and_says_what_it_is(content, calibration):
    again = json.loads(json.dumps(content))
    assert again["format"] == FORMAT
    assert again["calibration"]["digest"] == calibration.digest
    assert len(again["presses"]) == len(calibration.report.presses)
    assert again["held_out"] == pytest.approx(calibration.report.held_out)


def test_the_checks_read_the_figures(content):
    checks = {check["name"]: check["value"] for check in content["checks"]}
    used = sum(row["accepted"] for row in content["presses"])
    assert checks["presses_used"] == used
    assert checks["rejected_percent"] == pytest.approx(100 * (1 - used / len(content["presses"])))
    assert checks["ball_sizes"] == 2
    assert checks["normal_free_deg"] == content["figures"]["normal_free_deg"]["value"]
    assert checks["covered_percent"] == pytest.approx(100 * content["coverage"]["covered"])
    assert checks["scale_percent"] is None


def test_a_known_scale_is_a_percentage(presses, calibration):
    known = replace(calibration, mm_per_px_sigma=0.02 * calibration.mm_per_px)
    content = report_content(presses, known, rng=np.random.default_rng(0))
    assert {c["name"]: c["value"] for c in content["checks"]}["scale_percent"] == pytest.approx(2)


def test_simulated_slopes_are_read_at_their_size(content):
    bins = [b for b in content["gain"]["contact"] if b["slope_to"] <= 0.5]
    assert bins
    assert all(0.85 < b["gain"] < 1.15 for b in bins)
    up_to_rim = sum(b["pixels"] for b in content["gain"]["rim"])
    assert up_to_rim > sum(b["pixels"] for b in content["gain"]["contact"]) > 0
    assert content["gain"]["contact_radius_ratio"] == content["where"]["contact_radius_ratio"]
    assert (
        content["gain"]["contact_radius_ratio"] == content["calibration"]["settings"]["contact_radius_ratio"]
    )


def test_intervals_cover_the_truth_as_often_as_they_say():
    rng = np.random.default_rng(5)
    covered = []
    for _ in range(200):
        low, high = interval_of(rng.normal(3, 1, 40), np.mean, rng)
        covered.append(low <= 3 <= high)
    assert 0.88 <= np.mean(covered) <= 0.99


def test_other_presses_and_saved_calibrations_are_refused(presses, calibration):
    with pytest.raises(ValueError, match="others"):
        report_content(presses.subset([0, 1]), calibration, rng=np.random.default_rng(0))
    with pytest.raises(ValueError, match="a saved one has none"):
        report_content(presses, replace(calibration, report=None), rng=np.random.default_rng(0))
