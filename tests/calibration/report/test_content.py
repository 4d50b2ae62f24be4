"""The report in numbers: those of the run with their intervals, statistics of pixels of known truth, and the verdict."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.coverage import NEEDED
from gelform.calibration.inputs import MOST_SIGMAS, REMEDY, BallReading
from gelform.calibration.report.content import (
    FORMAT,
    HEADLINE,
    LIMITS,
    REFUTING,
    SLOPE_EDGES,
    checks_of,
    error_map,
    errors_where,
    fraction_within_sigma,
    gain_curve,
    interval_of,
    level_of,
    limit_in_words,
    report_content,
    square_error_by_direction,
    verdict_of,
)
from gelform.calibration.report.record import FIGURES, summary
from gelform.result.metrics import PressErrors, angle_deg


def test_figures_are_the_runs_own(content, calibration):
    for name, one in content["figures"].items():
        assert one["value"] == pytest.approx(calibration.held_out[name])
        assert one["interval"][0] <= one["value"] <= one["interval"][1]
    assert content["figures"]["radius_percent"]["statistic"] == "median"


def test_it_is_json_and_says_what_it_is(content, calibration):
    """Without the pixels, the pictures and the start."""
    again = json.loads(json.dumps(content))
    assert again["format"] == FORMAT
    assert again["calibration"]["digest"] == calibration.digest
    assert len(again["presses"]) == len(calibration.report.presses)
    assert again["held_out"] == pytest.approx(calibration.report.held_out)
    of_run = json.loads(json.dumps(calibration.report.to_dict()))
    assert not {"pixels", "caps_um", "start", "offered"} & of_run.keys()
    assert of_run["held_out"]["presses"] == sum(row.accepted for row in calibration.report.presses)


def values_of(content):
    return {check["name"]: check["value"] for check in content["checks"]}


def test_the_checks_read_the_figures(content, presses, calibration):
    checks = values_of(content)
    used = sum(row["accepted"] for row in content["presses"])
    assert checks["presses_used"] == used
    assert checks["rejected_percent"] == pytest.approx(100 * (1 - used / len(content["presses"])))
    assert checks["ball_sizes"] == 2
    assert checks["normal_free_deg"] == content["figures"]["normal_free_deg"]["value"]
    assert checks["covered_percent"] == pytest.approx(100 * content["coverage"]["covered"])
    assert checks["scale_percent"] is None
    assert 0.6 < content["sigma"]["all"] < 0.9
    known = replace(calibration, mm_per_px_sigma=0.02 * calibration.mm_per_px)
    content = report_content(presses, known, rng=np.random.default_rng(0))
    assert values_of(content)["scale_percent"] == pytest.approx(2)


def test_simulated_slopes_are_read_at_their_size(content):
    gain, settings = content["gain"], content["calibration"]["settings"]
    bins = [b for b in gain["contact"] if b["slope_to"] <= 0.5]
    assert bins
    assert all(0.85 < b["gain"] < 1.15 for b in bins)
    assert sum(b["pixels"] for b in gain["rim"]) > sum(b["pixels"] for b in gain["contact"]) > 0
    ratio = gain["contact_radius_ratio"]
    assert ratio == content["where"]["contact_radius_ratio"] == settings["contact_radius_ratio"]


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


SHAPE = (60, 80)


@pytest.mark.parametrize("gain", [0.8, 1.0, 1.25])
def test_a_gain_is_found_in_every_bin_whatever_the_noise(sample, gain):
    rng = np.random.default_rng(1)
    pixels = np.concatenate([sample(k, gain=gain, noise=0.1, rng=rng) for k in range(6)])
    curve = gain_curve(pixels, np.random.default_rng(0))
    assert len(curve) >= 5
    assert {b["slope_from"] for b in curve} <= set(SLOPE_EDGES)
    for b in curve[1:]:
        assert b["gain"] == pytest.approx(gain, abs=0.05)
        assert b["interval"][0] <= b["gain"] <= b["interval"][1]
        assert b["presses"] == 6


def test_intervals_are_over_presses_not_pixels(sample):
    """Presses that differ make a wide interval, however many pixels each has; bins of few are left out."""
    alike, differ = (
        gain_curve(np.concatenate([sample(k, gain=gain(k)) for k in range(8)]), np.random.default_rng(0))
        for gain in (lambda _: 1.0, lambda k: 0.8 + 0.05 * k)
    )
    width = [b["interval"][1] - b["interval"][0] for b in (alike[2], differ[2])]
    assert width[0] < 1e-3 < 0.1 < width[1]
    assert gain_curve(np.concatenate([sample(0), sample(1)]), np.random.default_rng(0)) == []


def test_the_error_map_has_the_bias_where_it_is(sample):
    left = sample(0, bias=(0.1, 0.0), circle=(20.0, 30.0, 18.0))
    right = sample(1, bias=(0.0, -0.2), circle=(60.0, 30.0, 18.0))
    errors = error_map(np.concatenate([left, right]), SHAPE, (1, 2))
    np.testing.assert_allclose(errors["mean"], [[0.1, 0.0], [0.0, -0.2]], atol=1e-6)
    np.testing.assert_allclose(errors["rms"], [0.1, 0.2], atol=1e-6)
    assert errors["pixels"] == [len(left), len(right)]
    assert error_map(left, SHAPE, (1, 2))["rms"][1] is None


def test_square_errors_stand_where_and_whither_they_are(sample):
    """A bias on the left alone: large there in every direction, the overall mean where nothing was measured."""
    left = sample(0, bias=(0.3, 0.0), circle=(20.0, 30.0, 18.0))
    pixels = np.concatenate([left, sample(1, circle=(60.0, 30.0, 18.0))])
    errors = square_error_by_direction(pixels, SHAPE, (3, 2))
    overall = 0.09 * len(left) / len(pixels)
    assert errors.shape == (3, 2, 8)
    assert (errors[1, 0] > overall).all()
    assert (errors[1, 1] < overall).all()
    assert square_error_by_direction(left, SHAPE, (3, 2))[0, 1] == pytest.approx([0.09] * 8, rel=1e-5)


def test_a_right_sigma_holds_68_percent_everywhere(sample):
    rng = np.random.default_rng(2)
    pixels = np.concatenate([sample(k, noise=0.01, rng=rng) for k in range(8)])
    sigma = np.full_like(pixels["solved"], 0.01)
    share = fraction_within_sigma(pixels, sigma, SHAPE, (2, 2))
    assert share["all"] == pytest.approx(0.683, abs=0.01)
    assert all(0.63 < one["share"] < 0.73 for one in share["by_slope"][1:-1])
    assert all(0.65 < one < 0.72 for one in share["by_place"])
    halved = fraction_within_sigma(pixels, sigma / 2, SHAPE, (2, 2))
    assert halved["all"] == pytest.approx(0.383, abs=0.01)
    assert share["off"][1] < 3
    assert halved["off"][0] > 25
    assert halved["off"][1] == 0


def test_a_deviation_that_few_presses_show_by_chance_is_none(sample):
    """A press whose slopes are all within sigma says nothing about others; presses that agree do."""
    pixels = np.concatenate([sample(k) for k in range(4)])
    sigma = np.full_like(pixels["solved"], 0.01)
    pixels["solved"][pixels["press"] == 3] *= -1
    below, above = fraction_within_sigma(pixels, sigma, SHAPE, (1, 1))["off"]
    assert below == 0
    assert above == 0, "3 of 4 presses"
    assert fraction_within_sigma(pixels, sigma - 1, SHAPE, (1, 1))["off"] == pytest.approx(
        [68.27, 0], abs=0.01
    )
    alone = fraction_within_sigma(pixels[pixels["press"] < 2], sigma[pixels["press"] < 2], SHAPE, (1, 1))
    assert alone["off"] == []


CIRCLE = (40.0, 30.0, 25.0)


def with_errors(pixels, mask, gain=0.7):
    other = pixels.copy()
    other["solved"] = np.where(mask[:, None], gain * pixels["true"], pixels["true"])
    return other


def test_a_flat_rim_is_up_to_the_rim_and_not_inside_the_edge(sample):
    one = sample(0, circle=CIRCLE)
    flat = with_errors(one, one["rho"] >= 0.8)
    where = errors_where(flat, SHAPE, 0.8)
    expected = angle_deg(flat["solved"], flat["true"])
    assert where["contact_radius_ratio"] == 0.8
    assert where["contact"]["normal_deg"] == pytest.approx(0, abs=1e-4)
    assert where["rim"]["normal_deg"] == pytest.approx(expected.mean(), rel=1e-6)
    assert expected.mean() > 1
    steep = where["rim"]["by_slope"][-1]
    assert steep["gain"] == pytest.approx(0.7, abs=1e-5)
    assert steep["slope_from"] >= 0.6 > where["contact"]["by_slope"][-1]["slope_from"]
    assert all(b["gain"] == pytest.approx(1, abs=1e-5) for b in where["contact"]["by_slope"])
    part = errors_where(flat, SHAPE, 0.9)["contact"]["normal_deg"]
    assert part == pytest.approx(expected[one["rho"] < 0.9].mean(), rel=1e-5), "the edge says what is counted"


def test_errors_stand_in_the_slope_bin_that_has_them(sample):
    one = sample(0, circle=CIRCLE)
    gentle = with_errors(one, np.linalg.norm(one["true"], axis=1) < 0.2, gain=1.3)
    for b in errors_where(gentle, SHAPE, 1.0)["contact"]["by_slope"]:
        assert b["gain"] == pytest.approx(1.3 if b["slope_to"] <= 0.2 else 1.0, abs=1e-5)
        assert (b["normal_deg"] > 0.1) == (b["slope_to"] <= 0.2)


def test_errors_stand_in_the_place_that_has_them(sample):
    left, right = sample(0, circle=(20.0, 30.0, 18.0)), sample(1, circle=(60.0, 30.0, 18.0), gain=0.8)
    place = errors_where(np.concatenate([left, right]), SHAPE, 1.0, (1, 2))["contact"]["by_place"]
    assert place["pixels"] == [len(left), len(right)]
    assert place["normal_deg"][0] == pytest.approx(0, abs=1e-4)
    assert place["normal_deg"][1] == pytest.approx(angle_deg(right["solved"], right["true"]).mean(), rel=1e-5)
    assert errors_where(left, SHAPE, 1.0, (1, 2))["contact"]["by_place"]["normal_deg"][1] is None


COVERED_LABEL = "gel that presses cover, in all slope directions"
GOOD = {limit.name: limit.good for limit in LIMITS}


def verdict(errors=None, **other):
    """The verdict on figures that are good but for some."""
    return verdict_of(checks_of({**GOOD, **other}, errors))


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_levels_change_at_their_limits(limit):
    worse = -1 if limit.rising else 1
    assert level_of(limit, limit.good) == level_of(limit, limit.good + 1e-4 * worse) == "good", "as printed"
    assert level_of(limit, limit.good + 0.1 * worse) == ("fair" if limit.fair != limit.good else "poor")
    if np.isfinite(limit.fair):
        assert level_of(limit, limit.fair) == ("fair" if limit.fair != limit.good else "good")
        assert level_of(limit, limit.fair + 0.1 * worse) == "poor"
    assert level_of(limit, None) == level_of(limit, float("nan")) == "not known"


def test_the_report_contradicts_a_diameter_where_the_notes_do():
    """At 1.88 standard deviations, the console had said that they agree, and the report that they do not."""
    for sigmas in (1.88, MOST_SIGMAS, MOST_SIGMAS + 0.1):
        read = 6.0 * np.exp(sigmas * 0.05)
        reading = BallReading(6.0, read, 0.05 * read, "another unit")
        assert reading.sigmas == pytest.approx(sigmas)
        judged = verdict(ball_sigmas=sigmas)
        assert ("agrees" in reading.sentence()) == (judged["level"] == "good")
        assert (REMEDY in reading.sentence()) == (REMEDY in judged["next"]) == (sigmas > MOST_SIGMAS)


def test_limits_in_words():
    checks, levels = {one["name"]: one for one in checks_of(GOOD)}, ("good", "fair")
    for name, said in (
        ("normal_free_deg", ["≤ 3", "≤ 5"]),
        ("covered_percent", ["≥ 80", "≥ 60"]),
        ("scale_off_percent", ["≤ 10", "any"]),
    ):
        assert [limit_in_words(checks[name], level) for level in levels] == said


def test_all_good_is_to_be_used_and_what_is_not_known_is_said():
    """The level is the worse of normals and radius."""
    judged = verdict()
    assert judged["headline"] == "Good: held-out normals are off by 3.0°, the ball radius by 3.0 %"
    assert judged["next"].startswith("Use it.")
    assert judged["because"] is None
    assert judged["counts"] == {"good": len(LIMITS), "fair": 0, "poor": 0, "not known": 0}
    assert verdict(scale_percent=None)["because"] == "uncertainty of the scale: not known"
    assert verdict(scale_percent=None)["counts"]["fair"] == 0
    assert verdict(radius_percent=9.0)["level"] == "poor"
    assert verdict(normal_free_deg=4.0)["level"] == "fair"


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_no_headline_is_good_over_a_poor_check(limit):
    """They count errors at the places that were pressed, so what else is poor caps them, and is said."""
    if not np.isfinite(limit.fair):
        return
    worse = limit.fair - 1 if limit.rising else 2 * limit.fair
    poor, fair = verdict(**{limit.name: worse}), verdict(**{limit.name: limit.fair})
    assert poor["level"] == ("poor" if limit.name in (*HEADLINE, *REFUTING) else "fair")
    assert not poor["headline"].startswith("Good")
    if limit.name not in (*HEADLINE, *REFUTING):
        assert f"; poor: {limit.label} (" in poor["checks"]
    assert fair["level"] == ("fair" if limit.name in HEADLINE else "good")
    assert "poor" not in fair["checks"]


def test_all_poor_checks_are_said_and_a_poor_headline_stays_poor():
    figures = {"presses_used": 5.0, "covered_percent": 17.2, "normal_free_deg": 2.0}
    judged = verdict(**figures)
    assert judged["headline"] == (
        "Fair: held-out normals are off by 2.0°, the ball radius by 3.0 %, where presses are. Elsewhere errors are not known"
    )
    assert judged["checks"] == (
        f"{len(LIMITS) - 2} of {len(LIMITS)} are good; poor: presses used (5), {COVERED_LABEL} (17.2 %)"
    )
    assert verdict(**{**figures, "normal_free_deg": 6.0})["headline"].startswith("Poor: held-out normals")


def test_the_error_of_few_presses_is_said_with_its_own():
    """From 12 presses on it is small beside the error."""
    errors = {"normal_free_deg": 0.62}
    few, more = (verdict(errors, presses_used=n)["headline"] for n in (11.0, 12.0))
    assert "off by 3.0 ± 0.6°" in few
    assert "off by 3.0°" in more


@pytest.mark.parametrize(
    ("figures", "because"),
    [
        # poor before fair, causes before effects
        ({"ball_sizes": 1.0, "normal_free_deg": 9.0}, "angle error of the normals, held out: 9°, poor"),
        ({"presses_used": 6.0, "normal_free_deg": 90.0}, "presses used: 6, poor"),
        ({"presses_used": 9.0, "radius_percent": 30.0}, "presses used: 9, poor"),
        ({"presses_used": 10.0, "off_contact_um": 79.0}, "presses used: 10, fair"),
        # what more presses mend waits for them
        ({"presses_used": 10.0, "normal_free_deg": 9.0}, "presses used: 10, fair"),
        ({"covered_percent": 70.0, "cap_free_um": 90.0}, f"{COVERED_LABEL}: 70 %, fair"),
        (
            {"presses_used": 10.0, "covered_percent": 7.0, "narrow_percent": 50.0},
            f"{COVERED_LABEL}: 7 %, poor",
        ),
        ({"presses_used": 10.0, "off_contact_um": 90.0}, "depth error off contact, held out: 90 µm, poor"),
        # what is not known is no fault
        ({"rejected_percent": None, "ball_sizes": 1.0}, "ball sizes: 1, fair"),
        ({"wide_percent": 32.0, "ball_sizes": 1.0}, "ball sizes: 1, fair"),
    ],
)
def test_the_cause_of_the_largest_fault_comes_next(figures, because):
    judged = verdict(**figures)
    assert judged["because"] == because
    named = because.split(":")[0]
    action = next(limit.action for limit in LIMITS if limit.label == named)
    assert judged["next"] == action.format(press="Press again", steep="")


def test_an_uncertainty_that_is_too_large_is_fair_and_no_step():
    judged = verdict(wide_percent=32.0)
    assert judged["headline"].startswith("Good: ")
    assert judged["counts"]["fair"] == 1
    assert judged["next"].startswith("Use it.")
    assert verdict(narrow_percent=32.0)["level"] == "fair"


def test_advice_has_a_number_of_presses_and_their_depth(content, calibration):
    """As many as are advised, or as cover the gel; as deep as the contacts of the ball say."""
    number, depth = re.search(
        r"(\d+) more times?, about (\S+) mm deep", action_of(content, "presses_used")
    ).groups()
    rows = [row for row in content["presses"] if row["accepted"]]
    assert int(number) >= NEEDED.advised.presses - len(rows)
    radii = np.array([row["contact_radius_px"] for row in rows]) * calibration.known_mm_per_px
    balls = np.array([row["ball_diameter_mm"] for row in rows]) / 2
    assert float(depth) == pytest.approx(np.median(balls - np.sqrt(balls**2 - radii**2)), rel=0.5)
    assert not any("{" in check["action"] for check in content["checks"])


def action_of(content, name):
    return next(check["action"] for check in content["checks"] if check["name"] == name)


def test_a_refuted_diameter_makes_all_poor_and_an_unchecked_one_is_said():
    refuted = verdict(ball_sigmas=9.0, presses_used=1.0)
    wrong = "Poor: the ball diameter or mm_per_px is wrong. With them, held-out normals are off by 3.0°"
    assert refuted["level"] == "poor"
    assert refuted["headline"].startswith(wrong)
    assert refuted["next"].startswith("Check the ball's diameter")
    unknown = verdict(ball_sigmas=None)["checks"]
    assert unknown.endswith("; not known: stated ball diameter against the measured one")
    assert verdict(scale_off_percent=25.0)["checks"].endswith("; fair: mm_per_px against the make's (25 %)")


def test_next_names_two_balls_before_what_more_presses_mend():
    mixed = BallReading(6.0, 9.0, 0.45, "the others", presses=tuple("abcdefg"))
    assert mixed.checks
    assert "7 of them (a, b, c, d, e ...) look like a ball 1.5 times as large" in mixed.remedy
    checks = checks_of(
        {**GOOD, "ball_sigmas": mixed.sigmas, "covered_percent": 10.0}, None, {"ball": mixed.remedy}
    )
    assert verdict_of(checks)["next"] == mixed.remedy
    effects = {"covered_percent": 10.0, "gain_percent": 50.0}
    assert "two balls under one diameter" in verdict(radius_percent=20.0, **effects)["next"]
    assert verdict(radius_percent=20.0, presses_used=5.0)["next"].startswith("Press again"), (
        "few presses are a cause"
    )


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
    ratios = [one["normal_free_deg"] / one["slope_error"] for one in tried]
    assert 30 < min(ratios) < max(ratios) < 70, "of the same slopes"


def test_the_summary_is_of_all_presses():
    names = PressErrors.__dataclass_fields__
    errors = [PressErrors(**dict.fromkeys(names, value)) for value in (1.0, 2.0, 6.0)]
    said = summary(errors)
    assert said["presses"] == 3
    assert said["normal_free_deg"] == pytest.approx(3.0)
    assert np.isfinite(list(said.values())).all()
    assert list(said) == list(FIGURES), "every figure has words"
    assert len(set(FIGURES.values())) == len(FIGURES)


def test_the_notes_say_how_often_folds_agreed_and_whence_the_scale_is(calibration):
    report = calibration.report
    held_out, *others = report.notes
    assert f"{report.held_out['presses']:.0f} presses in 5 folds" in held_out
    assert " of 5 folds chose" in held_out
    assert any("The scale comes from the number given" in note for note in others)
