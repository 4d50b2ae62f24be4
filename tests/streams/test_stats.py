"""What a stream counts: results, frames lost on the way, times."""

import math
import time

import pytest

from gelform.streams.stats import Meter


def test_before_the_first_result():
    stats = Meter().stats("starting", "")
    assert (stats.results, stats.drops, stats.rate_hz, stats.stage_ms) == (0, 0, 0, {})
    assert stats.age_s == math.inf
    assert math.isnan(stats.latency_ms)


def test_gaps_in_the_index_are_drops():
    meter = Meter()
    for index in (5, 6, 9, 10):  # what came before the first result is no drop of the stream's
        meter.given(index, time.monotonic())
    stats = meter.stats("running", "")
    assert (stats.results, stats.drops) == (4, 2)
    assert stats.rate_hz > 0


def test_age_and_latency_are_counted_from_the_capture():
    meter = Meter()
    meter.given(0, time.monotonic() - 3)
    stats = meter.stats("running", "")
    assert 3 <= stats.age_s < 60
    assert 3000 <= stats.latency_ms < 60_000


def test_each_stage_has_its_median():
    meter = Meter()
    for seconds in (0.001, 0.002, 0.5):
        meter.add("view", seconds)
    with meter.timed("reconstruct"):
        pass
    stage_ms = meter.stats("running", "all is well").stage_ms
    assert stage_ms["view"] == pytest.approx(2)
    assert 0 <= stage_ms["reconstruct"] < 60_000
