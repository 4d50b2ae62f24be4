"""A stream without a calibration starts with a starter's, after a second of the gel at rest."""

import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, SensorError, StaleError
from live_waiting import until
from made.sources import ImageSource

MAKE = "simulated-three-edges"


@pytest.fixture(autouse=True)
def no_library(tmp_path, monkeypatch):
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path / "none"))


class TouchedFirst(ImageSource):
    """A sensor on which something moves until it is let go."""

    def __init__(self, rest, pressed):
        super().__init__(rest, rate_hz=60)
        self.pressed, self.touched = pressed, True

    def __iter__(self):
        for frame in super().__iter__():
            moved = self.touched and frame.index // 5 % 2
            yield (
                frame
                if not moved
                else type(frame)(self.pressed[0], frame.time_s, frame.wall_time_ns, frame.index)
            )


def test_it_waits_while_something_moves_says_so_and_begins_then(unpressed):
    source = TouchedFirst(unpressed[0.0], unpressed[0.4])
    with gelform.stream(source, sensor=MAKE) as stream:
        until(lambda: "Something moves" in stream.stats.reason)
        assert stream.stats.state == "starting"
        with pytest.raises(StaleError, match="is starting: Something moves on the gel"):
            stream.latest(max_age_s=0.05)
        with pytest.raises(StaleError, match="Touch nothing"):
            _ = stream.calibration
        source.touched = False
        result = stream.newest(timeout_s=20).result
        assert "starter" in [finding.name for finding in result.health]
        assert abs(result.peak_mm) < 0.05
        source.images = unpressed[0.4]
        until(lambda: stream.latest(max_age_s=5).peak_mm > 0.3)
        assert stream.calibration.settings.starter["sensor"] == MAKE
        assert stream.stats.state == "running"


def test_a_recording_begins_with_the_untouched_gel_and_loses_no_frame(unpressed):
    images = [*unpressed[0.0] * 4, *unpressed[0.4]]
    results = list(gelform.stream(ImageSource(images, live=False, count=20), sensor=MAKE))
    assert [result.index for result in results] == list(range(20))
    assert max(result.peak_mm for result in results[:16]) < 0.05
    assert min(result.peak_mm for result in results[16:]) == pytest.approx(0.4, abs=0.08)


def test_a_recording_that_does_not_begin_with_it_is_refused(unpressed):
    images = [*unpressed[0.0], *unpressed[0.4]]
    with pytest.raises(CalibrationError, match=r"first frames.*simulated-three-edges.*background="):
        list(gelform.stream(ImageSource(images, live=False, count=20), sensor=MAKE))


def test_a_background_that_is_given_wins(unpressed):
    background = np.mean(unpressed[0.0], axis=0)
    source = ImageSource(unpressed[0.4], live=False, count=3)
    results = list(gelform.stream(source, sensor=MAKE, background=background))
    assert [result.index for result in results] == [0, 1, 2]
    assert results[0].peak_mm == pytest.approx(0.4, abs=0.08)


def test_the_library_comes_before_the_starter(unpressed, tmp_path, monkeypatch):
    from gelform.calibration.library import add_calibration

    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path))
    mine = gelform.calibration_from_background(
        np.mean(unpressed[0.0], axis=0), MAKE, serial="S7", gel_id="mine"
    )
    add_calibration(mine)
    source = ImageSource(unpressed[0.0], live=False, count=1)
    source.serial = "S7"
    (result,) = gelform.stream(source, sensor=MAKE)
    assert result.calibration_digest == mine.digest


def test_another_make_reaches_who_reads(unpressed):
    with pytest.raises(CalibrationError, match="background of a DIGIT"):
        list(
            gelform.stream(
                ImageSource([i.transpose(1, 0, 2) for i in unpressed[0.0]], live=False, count=4),
                sensor="digit",
            )
        )


def test_the_make_is_that_of_the_source(unpressed):
    """A GelSight Mini's name is taken for it, and what it shows is not its light."""
    source = ImageSource(unpressed[0.0], live=False, count=4)
    source.name = "GelSight Mini R0B 2BKR"
    with pytest.raises(CalibrationError, match="background of a GelSight Mini"):
        list(gelform.stream(source))


def test_mistakes_are_said_before_anything_opens(unpressed, calibration):
    source = ImageSource(unpressed[0.0])
    with pytest.raises(CalibrationError, match=r"sensor= \(--sensor\), one of digit, gelsight-mini"):
        gelform.stream(source)
    with pytest.raises(SensorError, match="with a starter"):
        gelform.stream(source, sensor="gelslim")
    with pytest.raises(ValueError, match="got both"):
        gelform.stream(source, calibration, sensor=MAKE)
