"""What decides the colours and was another at the calibration is a finding of every result."""

from dataclasses import replace

import gelform
from gelform.streams.health.settings import settings_findings
from made.sources import ImageSource


def camera(calibration, **settings):
    return replace(calibration, settings={**calibration.settings, "camera": settings})


def test_another_exposure_is_a_finding_of_the_stream(calibration, at_rest):
    source = ImageSource(at_rest, live=False, count=2)
    source.settings = {"exposure": 200.0, "gain": 1.0}
    results = list(gelform.stream(source, camera(calibration, exposure=100.0, gain=1.0)))
    for result in results:
        (finding,) = [one for one in result.health if one.name == "settings_mismatch"]
        assert finding.figure == 1
        assert "exposure 200.0 instead of 100.0" in finding.message


def test_the_same_or_unknown_settings_are_none(calibration):
    assert settings_findings(camera(calibration, exposure=100.0), {"exposure": 100.0}) == ()
    assert settings_findings(camera(calibration, exposure=100.0), {}) == ()
    assert settings_findings(calibration, {"exposure": 100.0}) == ()
