"""The setup of a station: calibration, background, solver, zero."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.errors import CalibrationError
from gelform.image.frame import Frame
from gelform.live.setup import Setup
from gelform.reconstruct import Reconstructor
from gelform.simulate import simulate_background


@pytest.fixture
def frame(press):
    return Frame(press.image, 1.0, 2, 3)


def test_without_a_calibration_there_is_no_result(frame):
    setup = Setup()
    assert setup.result_of(frame, setup.image_of(frame)) is None
    assert setup.with_solver("dct").solver == "dct"


def test_the_result_is_the_reconstructors_with_the_frames_times(frame, calibration, result):
    setup = Setup().with_calibration(calibration, "mine")
    found = setup.result_of(frame, setup.image_of(frame))
    np.testing.assert_array_equal(found.depth, result.depth)
    assert (found.index, found.time_s, found.wall_time_ns) == (3, 1.0, 2)


def test_a_zero_that_is_set_is_taken_off(frame, calibration, result):
    setup = Setup().with_calibration(calibration, "mine")
    zeroed = replace(setup, zero_mm=result.depth)
    found = zeroed.against_zero(zeroed.result_of(frame, zeroed.image_of(frame)))
    np.testing.assert_allclose(found.depth, 0, atol=1e-6)
    assert not found.contact.any()
    assert found.zero == "set"


def test_todays_background_is_used_and_given_back_another_sensors_refused(calibration, sensor):
    today = simulate_background(sensor, np.random.default_rng(8)).astype(np.float32)
    setup = Setup().with_calibration(calibration, "mine").with_background(today)
    with pytest.raises(CalibrationError):
        setup.with_background(calibration.background[..., ::-1].copy())
    assert not setup.reconstruct.own_background
    assert setup.with_solver("dct").background is today
    assert setup.with_background(None).reconstruct.own_background


def test_anew_it_has_forgotten_what_the_sequence_taught(calibration, press):
    frame = Frame(press.image, 0.0, 0, 0)
    setup = Setup().with_calibration(calibration, "mine")
    setup.memory.reconstruct = setup.memory.reconstruct.with_background(calibration.background + 3)
    fresh = setup.anew()
    wanted = Reconstructor(calibration)(frame).depth_mm
    np.testing.assert_array_equal(fresh.result_of(frame, press.image).depth_mm, wanted)
    assert Setup().anew() == Setup()
