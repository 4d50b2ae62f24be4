"""The verdict: levels at their limits, the worst of normals and radius in front, the first thing to mend."""

import numpy as np
import pytest

from gelform.calibration.balls import MOST_SIGMAS, REMEDY, BallReading
from gelform.calibration.report.verdict import (
    HEADLINE,
    LIMITS,
    REFUTING,
    checks_of,
    level_of,
    limit_in_words,
    verdict_of,
)

GOOD = {limit.name: limit.good for limit in LIMITS}


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_levels_change_at_their_limits(limit):
    worse = -1 if limit.rising else 1
    assert level_of(limit, limit.good) == level_of(limit, limit.good + 1e-4 * worse) == "good", "as printed"
    assert level_of(limit, limit.good + 0.1 * worse) == ("fair" if limit.fair != limit.good else "poor")
    if np.isfinite(limit.fair):
        assert level_of(limit, limit.fair) == ("fair" if limit.fair != limit.good else "good")
        assert level_of(limit, limit.fair + 0.1 * worse) == "poor"
    assert level_of(limit, None) == level_of(limit, float("nan")) == "fair"


def test_the_report_contradicts_a_diameter_where_the_notes_do():
    """At 1.88 standard deviations, the console had said that they agree, and the report that they do not."""
    for sigmas in (1.88, MOST_SIGMAS, MOST_SIGMAS + 0.1):
        reading = BallReading(
            6.0, 6.0 * np.exp(sigmas * 0.05), 0.05 * 6.0 * np.exp(sigmas * 0.05), "another unit"
        )
        assert reading.sigmas == pytest.approx(sigmas)
        verdict = verdict_of(checks_of({**GOOD, "ball_sigmas": sigmas}))
        assert ("agrees" in reading.sentence()) == (verdict["level"] == "good")
        assert (REMEDY in reading.sentence()) == (REMEDY in verdict["next"]) == (sigmas > MOST_SIGMAS)


def test_limits_in_words():
    said = {
        one["name"]: [limit_in_words(one, level) for level in ("good", "fair")] for one in checks_of(GOOD)
    }
    assert said["normal_free_deg"] == ["≤ 3", "≤ 5"]
    assert said["covered_percent"] == ["≥ 80", "≥ 60"]
    assert said["scale_off_percent"] == ["≤ 10", "any"]


def test_all_good_is_to_be_used_and_what_is_not_known_is_said():
    verdict = verdict_of(checks_of(GOOD))
    assert verdict["headline"] == "Good: held-out normals are off by 3.0°, the ball radius by 3.0 %"
    assert verdict["next"].startswith("Use it.")
    assert verdict["because"] is None
    assert verdict["counts"] == {"good": len(LIMITS), "fair": 0, "poor": 0}
    unknown = verdict_of(checks_of({**GOOD, "scale_percent": None}))
    assert unknown["because"] == "uncertainty of the scale: not known, fair"


def test_the_worse_of_normals_and_radius_is_the_level():
    assert verdict_of(checks_of({**GOOD, "radius_percent": 9.0}))["level"] == "poor"
    assert verdict_of(checks_of({**GOOD, "normal_free_deg": 4.0}))["level"] == "fair"


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_no_headline_is_good_over_a_poor_check(limit):
    """They count errors at the places that were pressed, so what else is poor caps them, and is said."""
    if not np.isfinite(limit.fair):
        return
    worse = limit.fair - 1 if limit.rising else 2 * limit.fair
    verdict = verdict_of(checks_of({**GOOD, limit.name: worse}))
    assert verdict["level"] == ("poor" if limit.name in (*HEADLINE, *REFUTING) else "fair")
    assert not verdict["headline"].startswith("Good")
    if limit.name not in (*HEADLINE, *REFUTING):
        assert f". Poor checks: {limit.label} (" in verdict["headline"]
    fair = verdict_of(checks_of({**GOOD, limit.name: limit.fair}))
    assert fair["level"] == ("fair" if limit.name in HEADLINE else "good")
    assert "Poor checks" not in fair["headline"]


def test_all_poor_checks_are_said_and_a_poor_headline_stays_poor():
    figures = {"presses_used": 5.0, "covered_percent": 17.2, "normal_free_deg": 2.0}
    verdict = verdict_of(checks_of({**GOOD, **figures}))
    assert verdict["headline"] == (
        "Fair: where presses are (17.2 % of places and slope directions), held-out normals are off by 2.0°, "
        "the ball radius by 3.0 %. Elsewhere errors are not known. Poor checks: presses used (5), places and "
        "slope directions that presses show (17.2 %)"
    )
    poor = verdict_of(checks_of({**GOOD, **figures, "normal_free_deg": 6.0}))
    assert poor["headline"].startswith("Poor: where presses are (17.2 %")
    assert "Poor checks" not in poor["headline"]


def test_the_error_of_few_presses_is_said_with_its_own():
    """From 12 presses on it is small beside the error."""
    errors = {"normal_free_deg": 0.62}
    few, more = (verdict_of(checks_of({**GOOD, "presses_used": n}, errors))["headline"] for n in (11.0, 12.0))
    assert "off by 3.0 ± 0.6°" in few
    assert "off by 3.0°" in more


@pytest.mark.parametrize(
    ("figures", "because"),
    [
        (
            {"presses_used": 20.0, "normal_free_deg": 9.0},
            "angle error of the normals, held out: 9°, poor",
        ),  # poor before fair
        ({"presses_used": 6.0, "normal_free_deg": 9.0}, "presses used: 6, poor"),  # 5 times, not 3
        ({"presses_used": 9.0, "radius_percent": 30.0}, "error of the ball's radius, held out: 30 %, poor"),
        ({"presses_used": 10.0, "cap_free_um": 40.0}, "presses used: 10, fair"),  # alike: the cause
        ({"presses_used": 29.0, "off_contact_um": 79.0}, "depth error off contact, held out: 79 µm, fair"),
        (
            {"scale_percent": None, "ball_sizes": 1.0},
            "ball sizes: 1, fair",
        ),  # what is not known is no large fault
        (
            {"covered_percent": 0.0, "normal_free_deg": 90.0},
            "places and slope directions that presses show: 0 %, poor",
        ),
    ],
)
def test_the_largest_fault_comes_next(figures, because):
    verdict = verdict_of(checks_of({**GOOD, **figures}))
    assert verdict["because"] == because
    named = because.split(":")[0]
    assert verdict["next"] == next(limit.action for limit in LIMITS if limit.label == named)


def test_a_refuted_diameter_makes_all_poor_and_an_unchecked_one_is_said():
    refuted = verdict_of(checks_of({**GOOD, "ball_sigmas": 9.0, "presses_used": 1.0}))
    assert refuted["level"] == "poor"
    assert refuted["headline"].startswith(
        "Poor: the ball diameter or mm_per_px is wrong. With them, held-out normals are off by 3.0°"
    )
    assert refuted["next"].startswith("Check the ball's diameter")
    assert verdict_of(checks_of({**GOOD, "ball_sigmas": None}))["headline"].endswith(
        ". Nothing checked the ball diameter"
    )
    unusual = verdict_of(checks_of({**GOOD, "scale_off_percent": 25.0}))
    assert unusual["headline"].endswith(". The mm_per_px is unusual for this sensor")
