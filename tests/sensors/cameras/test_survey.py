"""A camera looked at: its measured rate, or why there is none."""

import time

import pytest

from gelform.errors import SensorError
from gelform.sensors.cameras import survey as surveyed
from gelform.sensors.cameras.camera import Camera
from gelform.sensors.cameras.survey import survey_of
from made.recorded import camera as frames_of

CAMERA = Camera("a camera", "/dev/none", "S1")


def test_the_rate_is_measured(monkeypatch):
    monkeypatch.setattr(surveyed, "MEASURED_S", 0.2)
    found = survey_of(CAMERA, opened=lambda _: frames_of(200)())
    assert 20 < found.rate_hz < 60  # 50, less where the machine has no time
    assert found.settings == {"gain": 3.0}
    assert found.problem == ""


def test_without_measuring_it_is_not_opened():
    found = survey_of(CAMERA, measure=False, opened=lambda _: pytest.fail("opened"))
    assert (found.rate_hz, found.problem) == (None, "")


def test_why_it_does_not_open_or_gives_nothing(monkeypatch):
    def absent(_):
        raise SensorError("it was unplugged")

    assert survey_of(CAMERA, opened=absent).problem == "it was unplugged"
    monkeypatch.setattr(surveyed, "FIRST_S", 0.05)
    started = time.monotonic()
    assert "no frame" in survey_of(CAMERA, opened=lambda _: frames_of(0)()).problem
    assert time.monotonic() - started < 5
