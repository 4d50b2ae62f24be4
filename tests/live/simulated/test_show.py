"""The simulated sensor as a source: frames at its rate, presses where they are asked for."""

import threading

import numpy as np
import pytest

from gelform.live.simulated.show import Show
from gelform.simulate import simulate_background
from live_waiting import until


@pytest.fixture
def show(sensor):
    with Show(sensor, rate_hz=200) as made:
        yield made


def frames(show, count):
    source = iter(show)
    return [next(source) for _ in range(count)]


def test_at_rest_it_is_the_untouched_sensor(show, sensor):
    show.rest()
    image = frames(show, 1)[0].image
    untouched = simulate_background(sensor, None).astype(float)
    assert image.dtype == np.uint8
    assert np.abs(image - untouched).mean() < 3 * max(sensor.noise_sd, 1)


def test_at_rest_no_act_is_computed(show, monkeypatch):
    simulated = []
    monkeypatch.setattr(show, "_simulated", lambda *given: simulated.append(given) or show._rest)
    show.rest()
    frames(show, 40)  # 0.2 s: seven poses' time
    assert simulated == []
    show.rest(False)
    until(lambda: simulated)


def test_each_frame_has_noise_of_its_own_and_a_later_time(show):
    show.rest()
    first, second = frames(show, 2)
    assert (first.image != second.image).mean() > 0.2
    assert second.time_s > first.time_s
    assert second.index > first.index


def test_a_press_is_where_it_was_asked_for(show, sensor):
    show.rest()
    untouched = frames(show, 1)[0].image.astype(float)
    show.press_at(40, 90, 0.5, held_s=60)
    image = until_pressed(show, untouched)
    change = np.abs(image - untouched).sum(axis=-1)
    y, x = np.mgrid[: sensor.shape[0], : sensor.shape[1]]
    weight = np.where(change > 60, change, 0)
    assert np.average(x, weights=weight) == pytest.approx(40, abs=6)
    assert np.average(y, weights=weight) == pytest.approx(90, abs=6)


def until_pressed(show, untouched):
    for frame in show:
        image = frame.image.astype(float)
        if (np.abs(image - untouched).sum(axis=-1) > 60).mean() > 0.01:
            return image
    raise AssertionError("the source ended")


def test_the_ball_moves_from_the_first_second(show):
    images = np.stack([frame.image for frame in frames(show, 80)[::4]]).astype(float)
    assert np.ptp(images, axis=0).max() > 40


def test_closed_it_ends(show):
    source = iter(show)
    next(source)
    show.close()
    assert list(source) == []


def test_it_can_be_closed_just_as_its_loop_begins(show, monkeypatch):
    start = threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda thread: (show.close(), start(thread)))
    assert list(show) == []
