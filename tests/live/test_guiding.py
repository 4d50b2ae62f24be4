"""The buttons of the guided calibration: what they refuse, in words."""

import numpy as np
import pytest

from gelform.errors import GelformError
from gelform.frames import Frame
from gelform.live import guiding
from gelform.live.replay import buttons
from gelform.sensors.recordings.facts import RecordingFacts
from gelform.sensors.recordings.image_folder import FolderRecording
from gelform.simulate import Ball, simulate_background, simulate_press
from live_waiting import until


@pytest.mark.parametrize("diameter", [0.0, -3.0, 1e4])
def test_a_ball_of_no_size_is_refused(hub, diameter):
    with pytest.raises(GelformError, match="ball"):
        guiding.start(hub, 0, diameter, "", 0.0)
    assert not hub.guides


def test_without_a_guide_there_is_nothing_to_fit_or_use(hub):
    for act in (guiding.fit, guiding.use):
        with pytest.raises(GelformError, match="Start one"):
            act(hub, 0)


def test_the_simulated_sensor_knows_its_scale(hub, sensor):
    guiding.start(hub, 0, 5.0, "", 0.0)
    assert hub.guides[0].guide.asked.mm_per_px == sensor.mm_per_px
    guiding.start(hub, 0, 6.0, "", 0.0)
    assert hub.guides[0].guide.asked.ball_diameter_mm == 6.0
    assert len(hub.stations[0].taps) == 1


PLACES_MM = [(-5.0, -3.0), (5.0, 3.0), (0.0, 0.0), (-5.0, 3.5), (5.0, -3.5), (0.0, 4.0)]
HELD, LIFTED, UNTOUCHED = 14, 8, 40  # frames at 25 a second


@pytest.fixture
def filmed(sensor, tmp_path):
    """A recording of six presses of a ball, each held for half a second, after the untouched gel."""
    rng = np.random.default_rng(7)
    rest = simulate_background(sensor, None).astype(np.float64)
    folder = FolderRecording(tmp_path / "filmed", RecordingFacts("ring", None, {}, 25.0))
    count = 0

    def film(image, frames):
        nonlocal count
        for _ in range(frames):
            noisy = np.clip(image + rng.normal(0, sensor.noise_sd, image.shape), 0, 255).astype(np.uint8)
            folder.write(Frame(noisy, count / 25, 10**18 + count, count))
            count += 1

    film(rest, UNTOUCHED)
    for place in PLACES_MM:
        press = simulate_press(sensor, Ball(2.5), depth_mm=0.45, center_mm=place, rng=None, oversample=1)
        film(press.image.astype(np.float64), HELD)
        film(rest, LIFTED)
    folder.close()
    return tmp_path / "filmed"


@pytest.mark.slow
def test_a_recording_is_calibrated_from_start_to_end(hub, filmed, sensor, tmp_path, monkeypatch):
    monkeypatch.setattr("gelform.live.guide.guide.LOOK_EVERY_S", 0.02)
    hub.folder = tmp_path
    station = hub.stations[0]
    buttons.open_recording(hub, 0, hub.recordings.add(filmed))
    until(lambda: station.facts()["replay"])
    guiding.start(hub, 0, 5.0, "", sensor.mm_per_px)
    guide = hub.guides[0].guide
    until(lambda: not station.source.playing and station.source.facts()["number"] > 60, 60)
    assert guide.count >= 5, guide.facts()["rejected"]
    mm = [
        ((x - 87.5) * sensor.mm_per_px, (y - 65.5) * sensor.mm_per_px)
        for x, y, _ in guide.facts()["accepted"]
    ]
    assert all(min(np.hypot(x - px, y - py) for px, py in PLACES_MM) < 0.4 for x, y in mm)
    said = []
    hub.guides[0].fit(lambda done, total, what: said.append(what))
    assert guide.step == "report"
    assert said
    guiding.use(hub, 0)
    assert station.setup.name.endswith("calibration.npz")
    buttons.seek(hub, 0, UNTOUCHED + HELD // 2)
    deep = until(lambda: (s := station.newest) and s.measures and s.measures.peak > 0.3 and s.measures, 20)
    assert deep.peak == pytest.approx(0.45, abs=0.12)
