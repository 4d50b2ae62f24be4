"""The stated ball: what its presses say of its diameter by another unit's model, or by another size's presses."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.balls import (
    MOST_SIGMAS,
    REMEDY,
    SIZE_SIGMA,
    UNCHECKED,
    BallReading,
    ball_readings,
    notes_of,
)
from gelform.calibration.candidates import Start, starter_start
from gelform.calibration.circles.locate import locate
from gelform.calibration.presses.press_set import presses_from_simulated
from gelform.calibration.report.content import report_content
from gelform.calibration.starters.starter import starter_from_calibration
from gelform.errors import CalibrationError
from gelform.result.metrics.ball import ball_gradients, radius_from_gradients
from gelform.simulate import simulate_ball_presses
from made.halved import halved

SPREAD = 0.05


@pytest.mark.parametrize("radius", [30.0, 50.0, 200.0])
def test_the_radius_comes_back_from_a_ball_s_slopes(radius):
    y, x = np.mgrid[:40, :40]
    near = np.hypot(x - 24, y - 17) < min(0.7 * radius, 25)
    slopes = ball_gradients(x[near], y[near], (24, 17), radius)
    assert radius_from_gradients(slopes, x[near], y[near]) == pytest.approx(radius, rel=1e-9)
    slopes[::50] = 5.0
    assert radius_from_gradients(slopes, x[near], y[near]) == pytest.approx(radius, rel=0.01), "2 % outliers"
    assert np.isinf(radius_from_gradients(np.zeros((9, 2)), np.arange(9), np.arange(9)))


def stated(presses, factor, of=lambda diameter: True):
    """The same images, of balls that are stated so many times as large."""
    return replace(
        presses,
        presses=tuple(
            replace(one, ball_diameter_mm=one.ball_diameter_mm * (factor if of(one.ball_diameter_mm) else 1))
            for one in presses.presses
        ),
    )


@pytest.fixture(scope="module")
def known(calibration):
    """A model that has learned from the right diameters, as another unit's has."""
    return Start(calibration.color_model, calibration.forward, "digest", SPREAD, "another unit")


@pytest.mark.parametrize("factor", [1.0, 2.0, 1.25, 0.8])
def test_a_wrong_diameter_is_read_by_another_unit_s_model(presses, known, factor):
    presses = presses.subset(range(8))
    readings = ball_readings(locate(stated(presses, factor)), known)
    right = sorted({one.ball_diameter_mm for one in presses.presses})
    assert sorted(one.read_mm for one in readings) == pytest.approx(right, rel=0.06)
    assert all((one.sigmas > MOST_SIGMAS) == (factor != 1) for one in readings)
    assert all(one.sigma_mm >= SPREAD * one.read_mm for one in readings)
    words = notes_of(readings)[0]
    assert (REMEDY in words) == (factor != 1)
    assert f"{readings[0].stated_mm:g} mm" in words


@pytest.fixture(scope="module")
def two_sizes(sensor, made_once):
    """Fifteen presses of each of two balls."""
    small = replace(sensor, shape=(120, 160), mm_per_px=0.1268)
    rng = np.random.default_rng(7)
    made = made_once(
        "two_sizes", lambda _: simulate_ball_presses(small, ball_diameters_mm=[4.0, 6.0], count=30, rng=rng)
    )
    return presses_from_simulated(made)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.25, 0.8])
def test_two_sizes_check_each_other(two_sizes, factor):
    (reading,) = ball_readings(locate(stated(two_sizes, factor, of=lambda diameter: diameter == 6)), None)
    against = {4.0: 1 / factor, 6 * factor: factor}[4.0 if reading.stated_mm != 4 else 6 * factor]
    assert reading.read_mm / reading.stated_mm == pytest.approx(against, rel=2 * SIZE_SIGMA)
    assert (reading.sigmas > MOST_SIGMAS) == (factor != 1)
    assert "presses of" in reading.by


def test_one_size_and_no_other_unit_is_said_to_be_unchecked(presses):
    smaller = min(one.ball_diameter_mm for one in presses.presses)
    own = presses.subset([i for i, one in enumerate(presses.presses) if one.ball_diameter_mm == smaller])
    readings = ball_readings(locate(own), None)
    assert readings == ()
    assert notes_of(readings) == (UNCHECKED,)


def test_twice_and_half_are_as_far_off():
    twice, half = BallReading(5.0, 10.0, 0.5, ""), BallReading(20.0, 10.0, 0.5, "")
    assert twice.sigmas == half.sigmas == pytest.approx(np.log(2) / 0.05, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "every", "factor"), [("mini-ball", 5, 2.0), ("mini-ball", 5, 0.8), ("digit-ball", 3, 2.0)]
)
def test_real_presses_of_a_wrong_diameter_are_never_good_in_silence(data, name, every, factor):
    presses = gelform.read_presses(data / name)
    presses = stated(presses.subset(range(0, len(presses.presses), every)), factor)
    calibration = gelform.calibrate(presses)
    verdict = report_content(presses, calibration, rng=np.random.default_rng(0))["verdict"]
    assert verdict["level"] == "poor"
    assert "diameter" in verdict["headline"]
    assert any("Check the ball's diameter and mm_per_px" in note for note in calibration.report.notes)


@pytest.mark.slow
def test_a_starter_helps_five_presses_of_another_unit(data, monkeypatch):
    """mini-d, read by what another GelSight Mini has shown; its ball is likelier 4.70 mm than the 4.0 that are stated."""
    presses = halved(stated(gelform.read_presses(data / "mini-d"), 1.175))
    five, rest = presses.subset(range(0, 45, 9)), presses.subset(range(4, 45, 9))
    ball = gelform.read_presses(data / "mini-ball")
    ball = halved(ball.subset(range(0, len(ball.presses), 5)))
    own = gelform.calibrate(ball, start=None)
    made = starter_from_calibration(own, "gelsight-mini", spread=0.06, units=("mini-ball",))
    monkeypatch.setattr("gelform.calibration.candidates.starter_for", lambda *sensor: made)
    alone, begun = (gelform.calibrate(five, start=start) for start in (None, "auto"))
    assert alone.settings.start is None
    assert begun.settings.start is not None
    assert any("The starter of a GelSight Mini was used" in note for note in begun.report.notes)
    errors = [gelform.evaluate(one, rest).summary["normal_free_deg"] for one in (alone, begun)]
    assert errors[1] < 0.85 * errors[0]


def test_a_starter_is_not_offered_to_the_presses_that_it_was_made_from(data):
    ball, other = (gelform.read_presses(data / name) for name in ("mini-ball", "mini-d"))
    make = starter_start(ball, "auto")
    assert make is not None, "its ball can be checked by it all the same"
    assert not make.offered
    assert starter_start(other, "auto").offered, "that unit says how far units differ, and is in no model"
    assert not starter_start(other, "lookup").offered
    assert starter_start(gelform.read_presses(data / "gelslim"), "auto") is None
    renamed = replace(gelform.read_presses(data / "gelsight-ball-deep"), sensor_name="DIGIT")
    assert starter_start(renamed, "auto") is None, "a name alone does not make it that sensor"


def test_where_no_press_fits_the_error_says_what_they_look_like(presses, calibration):
    with pytest.raises(CalibrationError, match="look like a ball of"):
        gelform.calibrate(stated(presses.subset(range(5)), 0.3), start=calibration)
