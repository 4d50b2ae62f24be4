"""Stamps, counts and ends of a stream that is sent."""

import time

import pytest

import gelform
from gelform.errors import DataError
from gelform.robots.stamped import StampedResults

START_NS, RATE_HZ = 1_700_000_000_123_456_789, 50


def test_stamps_are_those_of_the_frames(recording, calibration):
    with gelform.stream(recording, calibration) as running:
        results = StampedResults(running, recording, None)
        stamps = [stamp for _, stamp in results]
        stats = results.stats("left")
    assert stamps == [START_NS + k * 10**9 // RATE_HZ for k in range(4)]
    assert (stats.sensor, stats.frames, stats.drops, stats.stamped) == ("left", 4, 0, True)
    assert stats.duration_s == pytest.approx(3 / RATE_HZ)


def test_seconds_end_it_before_the_frame_that_is_later(recording, calibration):
    with gelform.stream(recording, calibration) as running:
        results = StampedResults(running, recording, 1.5 / RATE_HZ)
        assert len(list(results)) == results.stats("left").frames == 2


def test_frames_without_a_time_are_stamped_from_now_on(recording, calibration, tmp_path):
    for k in range(2):
        (tmp_path / f"{k}.png").write_bytes((recording / f"{k:08d}.png").read_bytes())
    before = time.time_ns()
    with gelform.stream(tmp_path, calibration) as running:
        results = StampedResults(running, tmp_path, None)
        first, second = (stamp for _, stamp in results)
    assert before <= first <= time.time_ns()
    assert second - first == 10**9 // 25
    assert not results.stats("left").stamped


class Empty:
    """A source that ends before its first frame."""

    live, name, serial, settings = False, "empty", None, {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def close(self):
        pass

    def __iter__(self):
        return iter(())


def test_an_empty_source_is_an_error(calibration):
    with (
        gelform.stream(Empty(), calibration) as running,
        pytest.raises(DataError, match="No frame came from here"),
    ):
        list(StampedResults(running, "here", None))
