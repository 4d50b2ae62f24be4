"""The simulated sensor as a source: pace, noise, its program, presses on request."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from gelform.sensors.simulated.settings import simulated_sensor_named
from gelform.sensors.simulated.source import REST_IMAGES, SimulatedSource, program
from gelform.simulate import LAYOUTS, simulate_background, simulate_pose
from live_waiting import until

SMALL = replace(LAYOUTS["three-edges"], shape=(48, 64), mm_per_px=0.3)
UNTOUCHED = simulate_background(SMALL, None).astype(float)


@pytest.fixture
def source():
    with SimulatedSource(SMALL, rate_hz=200.0) as made:
        yield made


def test_facts_and_range(source):
    assert (source.name, source.rate_hz) == ("simulated three-edges", 200.0)
    assert source.serial == "simulated-three-edges"
    assert source.settings == {"width": 64, "height": 48, "fps": 200.0}
    with pytest.raises(ValueError, match="rate_hz"):
        SimulatedSource(SMALL, rate_hz=0.0)


def test_frames_come_in_order_at_their_times_and_not_before(source):
    came = [(frame, time.monotonic()) for _, frame in zip(range(5), source)]
    times, steps = (np.diff([getattr(f, name) for f, _ in came]) for name in ("time_s", "index"))
    np.testing.assert_allclose(times, steps / 200)
    assert (steps >= 1).all()
    assert all(now >= frame.time_s for frame, now in came)
    reader = iter(source)
    before = next(reader).index
    time.sleep(0.1)
    assert next(reader).index >= before + 19


def test_closed_it_ends_also_just_as_its_loop_begins(source, monkeypatch):
    reader = iter(source)
    next(reader)
    source.close()
    assert list(reader) == []
    other, start = SimulatedSource(SMALL), threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda thread: (other.close(), start(thread)))
    assert list(other) == []


def test_noise_is_of_the_frame_and_the_seed():
    one, again, other = (SimulatedSource(SMALL, seed=seed) for seed in (1, 1, 2))
    for index in (5, 60):  # untouched, and under the ball
        np.testing.assert_array_equal(one.image_at(index), again.image_at(index))
    for different in (one.image_at(6), other.image_at(5)):
        assert (one.image_at(5) != different).mean() > 0.2


def test_a_frame_is_the_simulated_image_of_its_touch(source):
    k = REST_IMAGES + 24
    touch = program(SMALL)[0][k]
    truth = simulate_pose(SMALL, touch.indenter, touch.pose, rng=None).image
    rounds = len(program(SMALL)[0])
    shown = np.mean([source.image_at(round((k + 0.5 + rounds * n) * 200 / 30)) for n in range(60)], axis=0)
    assert np.abs(shown - truth).mean() < 0.4  # rounding of the truth, and noise of the mean
    assert np.abs(shown - UNTOUCHED).max() > 20


def test_objects_touch_in_turn_without_going_through_the_gel():
    sensor = simulated_sensor_named("three-edges")
    for images in program(sensor):
        assert images[:REST_IMAGES] == [None] * REST_IMAGES
        depths = [touch.pose.depth_mm for touch in images[REST_IMAGES:]]
        assert max(depths) > 0.2
        assert all(0 < depth < 0.5 * sensor.gel.thickness_mm for depth in depths)
        assert depths[0] < 0.1
        assert depths[-1] < 0.1


def test_at_rest_nothing_is_computed_ahead(source, monkeypatch):
    computed = []
    monkeypatch.setattr(source, "_levels_of_touch", lambda touch: computed.append(touch) or source._untouched)
    source.rest()
    images = [frame.image for _, frame in zip(range(40), source)]  # 0.2 s: six touches' time
    assert computed == []
    assert np.abs(np.mean(images, axis=0) - UNTOUCHED).mean() < 0.5
    source.rest(False)
    until(lambda: computed)


def test_a_press_is_where_it_was_asked_for_until_it_is_lifted(source):
    source.rest()
    source.press_at(20, 30, 0.5, held_s=60)
    change = next(
        one for frame in source if ((one := np.abs(frame.image - UNTOUCHED).sum(axis=-1)) > 60).mean() > 0.01
    )
    y, x = np.mgrid[: SMALL.shape[0], : SMALL.shape[1]]
    weight = np.where(change > 60, change, 0)
    assert np.average(x, weights=weight) == pytest.approx(20, abs=3)
    assert np.average(y, weights=weight) == pytest.approx(30, abs=3)
    source.lift()
    assert np.abs(source.image_at(0) - UNTOUCHED).mean() < 3
