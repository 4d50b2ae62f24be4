"""The verdict: levels at their limits, the worst of normals and radius in front, the first thing to mend."""

import pytest

from gelform.calibration.report.verdict import LIMITS, checks_of, level_of, verdict_of

GOOD = {limit.name: limit.good for limit in LIMITS}


@pytest.mark.parametrize("limit", LIMITS, ids=lambda limit: limit.name)
def test_levels_change_at_their_limits(limit):
    worse = -1 if limit.rising else 1
    assert level_of(limit, limit.good) == "good"
    assert level_of(limit, limit.good + 0.01 * worse) == "fair"
    assert level_of(limit, limit.fair) == "fair"
    assert level_of(limit, limit.fair + 0.01 * worse) == "poor"
    assert level_of(limit, None) == level_of(limit, float("nan")) == "fair"


def test_all_good_is_to_be_used():
    verdict = verdict_of(checks_of(GOOD))
    assert verdict["headline"] == "Good: normals 3.0°, radius 3.0 %, held out"
    assert verdict["next"].startswith("Use it.")
    assert verdict["because"] is None
    assert verdict["counts"] == {"good": len(LIMITS), "fair": 0, "poor": 0}


def test_the_worse_of_normals_and_radius_is_the_level():
    assert verdict_of(checks_of({**GOOD, "radius_percent": 9.0}))["level"] == "poor"
    assert verdict_of(checks_of({**GOOD, "normal_free_deg": 4.0}))["level"] == "fair"
    assert verdict_of(checks_of({**GOOD, "covered_percent": 1.0}))["level"] == "good"


def test_causes_are_mended_before_their_effects():
    """Few presses are the reason of poor normals: more of them come first, though they are only fair."""
    verdict = verdict_of(checks_of({**GOOD, "presses_used": 20.0, "normal_free_deg": 9.0}))
    assert "30 presses" in verdict["next"]
    assert verdict["because"] == "presses used: 20, fair"
    assert verdict["level"] == "poor"
    alone = verdict_of(checks_of({**GOOD, "normal_free_deg": 9.0}))
    assert alone["because"] == "normals, held out: 9°, poor"


def test_what_is_not_known_is_said():
    verdict = verdict_of(checks_of({**GOOD, "scale_percent": None}))
    assert verdict["because"] == "uncertainty of the scale: not known, fair"
