"""The shipped calibration: it loads, and agrees with the simulated truth."""

import numpy as np
import pytest

from gelform.calibration.library import simulated as ready
from gelform.calibration.library.simulated import kept_path, ready_calibration
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.reconstruct import Reconstructor
from gelform.sensors.simulated.settings import simulated_sensor_named
from gelform.simulate import Ball, simulate_press


def test_the_one_shipped_is_right():
    sensor = simulated_sensor_named("three-edges")
    calibration = ready_calibration(sensor)
    press = simulate_press(
        sensor,
        Ball(2.5),
        depth_mm=0.5,
        center_mm=(3.0, 2.0),
        rng=np.random.default_rng(5),
        oversample=1,
    )
    found = Reconstructor(calibration).from_image(press.image)
    assert np.sqrt(np.mean((found.depth_mm - press.depth_mm) ** 2)) < 0.012
    assert found.peak_mm == pytest.approx(press.depth_mm.max(), rel=0.06)
    assert not found.health


def test_another_sensors_is_made_once_and_kept(monkeypatch, tmp_path, sensor, simulated, calibration):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = []
    monkeypatch.setattr(ready, "simulated_presses", lambda *_, **__: simulated)
    monkeypatch.setattr("gelform.calibration.fit.calibrate", lambda *_, **__: made.append(1) or calibration)
    assert ready_calibration(sensor).digest == calibration.digest
    assert ready_calibration(sensor).digest == calibration.digest
    assert len(made) == 1
    kept_path(sensor).write_bytes(b"damaged")
    assert ready_calibration(sensor).digest == calibration.digest
    assert len(made) == 2


def test_a_cache_that_cannot_be_written_does_no_harm(monkeypatch, tmp_path, sensor):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert kept_path(sensor) is None


def test_presses_are_what_a_folder_would_give(simulated, presses):
    made = presses_from_simulated(simulated)
    assert [one.digest for one in made.presses] == [one.digest for one in presses.presses]
    assert made.mm_per_px == presses.mm_per_px
