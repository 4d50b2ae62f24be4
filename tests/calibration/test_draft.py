"""The color model of all presses: how large a change an untouched pixel may show."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.draft import USUAL_UNTOUCHED_CHANGE, _settings, untouched_change


class Change:
    """A prepared press, as far as its size of change goes."""

    def __init__(self, size):
        self.size = size


def circle(x, y, radius):
    fields = dict.fromkeys(ContactCircle.__dataclass_fields__, 0.0)
    return ContactCircle(**{**fields, "x_px": x, "y_px": y, "radius_px": radius})


def test_it_is_seen_beyond_three_radii():
    size = np.full((60, 80), 9.0, dtype=np.float32)
    rows, columns = np.mgrid[:60, :80]
    size[np.hypot(columns - 20, rows - 30) > 30] = 0.01
    assert untouched_change([Change(size)], [circle(20, 30, 10)]) == pytest.approx(0.01)
    assert untouched_change([Change(size)], [circle(20, 30, 9)]) > 1, (
        "a ring of touched gel is inside three radii"
    )


def test_a_press_as_large_as_the_image_leaves_the_usual():
    size = np.ones((20, 30), dtype=np.float32)
    assert untouched_change([Change(size)], [circle(15, 10, 30)]) == USUAL_UNTOUCHED_CHANGE


def test_the_draft_is_of_the_accepted_presses(presses, calibration):
    digests = [
        press.digest for press, row in zip(presses.presses, calibration.report.presses) if row.accepted
    ]
    assert list(calibration.training_digests) == digests
    assert calibration.settings["presses"] == len(digests)


def test_the_cameras_settings_are_kept(presses, calibration):
    assert "camera" not in calibration.settings
    candidate = SimpleNamespace(zone="contact", settings={}, start=None)
    with_camera = replace(presses, camera={"exposure": 50.0})
    kept = _settings(with_camera, candidate, [press.image for press in presses.presses], relaxation_mm=0.5)
    assert kept["camera"] == {"exposure": 50.0}
    assert kept["relaxation_mm"] == 0.5
