"""The threads of a stream: effect of an error, duration of a close, the result that a reader gets, the counts."""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from threading import Event, Thread

import numpy as np
import pytest

from gelform.image.frame import Frame
from gelform.sensors.streams.feed import feed_from_source
from gelform.sensors.streams.memory import Memory
from gelform.sensors.streams.pipeline import HandOver, Meter, Pipeline
from gelform.sensors.streams.stream import Stream
from made.sources import ImageSource


def test_results_drops_ages_and_the_median_of_each_stage_are_counted():
    meter = Meter()
    stats = meter.stats("starting", "")
    assert (stats.results, stats.drops, stats.rate_hz, stats.stage_ms) == (0, 0, 0, {})
    assert stats.age_s == math.inf
    assert math.isnan(stats.latency_ms)
    for index in (5, 6, 9, 10):  # what came before the first result is no drop of the stream's
        meter.given(index, time.monotonic() - 3)
    stats = meter.stats("running", "")
    assert (stats.results, stats.drops) == (4, 2)
    assert stats.rate_hz > 0
    assert 3 <= stats.age_s < 60
    assert 3000 <= stats.latency_ms < 60_000
    meter = Meter()
    for seconds in (0.001, 0.002, 0.5):
        meter.add("view", seconds)
    with meter.timed("reconstruct"):
        pass
    stage_ms = meter.stats("running", "all is well").stage_ms
    assert stage_ms["view"] == pytest.approx(2)
    assert 0 <= stage_ms["reconstruct"] < 60_000


def started(act):
    """A thread that does it."""
    thread = Thread(target=act, daemon=True)
    thread.start()
    return thread


@contextmanager
def running(feed, memory):
    """A pipeline from a feed, or a live source of images, through a memory."""
    pipeline = Pipeline(feed if isinstance(feed, Stepwise) else feed_from_source(feed), memory)
    pipeline.start()
    try:
        yield pipeline
    finally:
        pipeline.close()


def test_late_readers_get_the_newest_alone_and_do_not_take_from_each_other():
    values = HandOver()
    for number, value in enumerate("abc"):
        values.put(number, value)
    assert values.newest() == values.newest(after=1) == next(iter(values)) == "c"
    assert values.newest(after=2, timeout_s=0.01) is None


def test_where_every_value_counts_the_writer_waits():
    values, done = HandOver(every=True), Event()
    started(lambda: ([values.put(k, value) for k, value in enumerate("abc")], done.set()))
    assert [values.newest(k - 1, timeout_s=5) for k in range(2)] == ["a", "b"]
    unread = HandOver(every=True)
    unread.put(0, "a")
    writer = started(lambda: unread.put(1, "b"))
    writer.join(0.05)
    assert writer.is_alive()  # an unread one is not replaced
    unread.end()  # frees a writer that nobody reads from any more
    writer.join(5)
    assert not writer.is_alive()
    assert done.wait(5)


def test_the_end_wakes_readers_and_its_error_comes_after_the_last_value():
    values, found = HandOver(), []
    reader = started(lambda: found.append(values.newest()))
    values.end()
    reader.join(5)
    assert found == [None]
    values = HandOver()
    values.put(0, "a")
    values.end(ValueError("broken"))
    values.end()
    assert values.newest() == "a"
    with pytest.raises(ValueError, match="broken"):
        values.newest(after=0)
    assert values.ended


def test_a_value_that_is_being_made_is_waited_for():
    """What lies here gets older while the new one is made: a reader gets the new one, where it comes in time."""
    values, found = HandOver(), []
    values.put(0, "old")
    values.expect(1)
    assert values.newest(timeout_s=0) == values.newest(timeout_s=0.02) == "old"
    reader = started(lambda: found.append(values.newest(timeout_s=5)))
    reader.join(0.05)
    assert found == []
    values.put(1, "new")
    reader.join(5)
    assert found == ["new"]
    values.expect(2)
    values.end()
    assert values.newest() == "new"


class Failing(Memory):
    """Forgets how to learn."""

    def learn(self, image, result):
        raise MemoryError("no more")


class Hanging(Memory):
    """A stage that does not come back before it is let go."""

    def __init__(self, reconstruct):
        super().__init__(reconstruct)
        self.entered, self.let_go = Event(), Event()

    def remembered(self, image, result):
        self.entered.set()
        self.let_go.wait(60)
        return result


class SlowToLearn(Memory):
    """Learns until it is let go."""

    def __init__(self, reconstruct):
        super().__init__(reconstruct)
        self.learning, self.let_go = Event(), Event()

    def learn(self, image, result):
        self.learning.set()
        self.let_go.wait(60)


class Stepwise:
    """A feed whose frames a test gives."""

    every, state, reason, settings, skipped = False, "running", "", {}, 0

    def __init__(self):
        self.frames, self.closed = [], Event()

    def next(self, after_index):
        self.closed.wait(0.001)
        return self.frames.pop(0) if self.frames else None

    def close(self):
        self.closed.set()


def test_an_error_in_the_last_stage_arrives_too(reconstruct, at_rest):
    with running(ImageSource(at_rest), Failing(reconstruct)) as pipeline:
        first = pipeline.results.newest(timeout_s=60)  # it was given before anything was learned from it
        with pytest.raises(MemoryError, match="no more"):
            pipeline.results.newest(first.index + 10**6, timeout_s=60)
        assert pipeline.stats().state == "failed"


def test_a_slow_stage_does_not_hold_up_capture(reconstruct, at_rest):
    memory = Hanging(reconstruct)
    with running(ImageSource(at_rest), memory) as pipeline:
        assert memory.entered.wait(60)
        index = pipeline.feed.next(-1).index
        assert pipeline.feed.next(index).index > index
        assert pipeline.stats().results == 0
        memory.let_go.set()
    assert pipeline.stats().drops > 0 or pipeline.stats().results <= 1


def test_close_ends_every_wait(reconstruct, at_rest):
    """A reader, a writer that waits to be read, and a stage that waits for frames."""
    with running(ImageSource(at_rest, live=False), Memory(reconstruct)) as pipeline:
        time.sleep(0.2)  # nobody reads: both stages wait
        reader = started(lambda: list(iter(lambda: pipeline.results.newest(10**6), None)))
    reader.join(10)
    assert not reader.is_alive()
    assert not any(thread.is_alive() for thread in pipeline._threads)
    assert pipeline.stats().state == "closed"
    unused = Pipeline(feed_from_source(ImageSource(at_rest)), Memory(reconstruct))
    unused.close()  # never started
    assert unused.feed.state == "ended"


def test_stages_are_timed(reconstruct, at_rest):
    with running(ImageSource(at_rest), Memory(reconstruct)) as pipeline:
        pipeline.results.newest(timeout_s=60)
        stats = pipeline.stats()
    assert stats.stage_ms.keys() - {"learn"} == {"wait", "view", "reconstruct", "remember"}
    assert min(stats.stage_ms["reconstruct"], stats.stage_ms["view"]) > 0
    assert stats.latency_ms >= stats.stage_ms["reconstruct"]


def test_a_result_is_given_before_it_is_learned_from(reconstruct, at_rest):
    memory = SlowToLearn(reconstruct)
    with running(ImageSource(at_rest), memory) as pipeline:
        first = pipeline.results.newest(timeout_s=60)
        assert memory.learning.wait(60)
        assert pipeline.results.newest(first.index, timeout_s=60).index > first.index
        memory.let_go.set()


def test_a_reader_gets_the_result_that_is_being_made(reconstruct, at_rest):
    """One that lies there since the frame before would be older by a frame."""
    feed, memory = Stepwise(), Hanging(reconstruct)
    memory.let_go.set()
    pipeline = Pipeline(feed, memory)
    stream = Stream(pipeline, memory)  # starts it
    feed.frames.append(Frame(at_rest[0], time.monotonic(), 0, 0))
    assert pipeline.results.newest(timeout_s=60).index == 0
    memory.entered.clear()
    memory.let_go.clear()
    feed.frames.append(Frame(at_rest[1], time.monotonic(), 0, 1))
    assert memory.entered.wait(60)
    assert pipeline.results.newest(-1, 0).index == 0  # no time to wait
    found, asked = [], (pipeline.results.newest, lambda: stream.latest(3600))
    readers = [started(lambda ask=ask: found.append(ask().index)) for ask in asked]
    memory.let_go.set()
    for reader in readers:
        reader.join(60)
    pipeline.close()
    assert found == [1, 1]


def test_a_recording_teaches_the_same_each_time(reconstruct, at_rest):
    """Learned from frame by frame: a minute of a light that fades, twice, byte for byte."""
    fading = [(at_rest[k % 10] * (1 - 0.001 * k)).astype(np.uint8) for k in range(30)]

    def last():
        memory = Memory(reconstruct)
        with running(ImageSource(fading, live=False, count=30, rate_hz=2.0), memory) as pipeline:
            *_, given = pipeline.results
        return given.result.depth, memory.reconstruct.background

    (depth, background), (again, background_again) = last(), last()
    np.testing.assert_array_equal(depth, again)
    np.testing.assert_array_equal(background, background_again)
    assert np.abs(background - reconstruct.background).max() > 1  # it learned
