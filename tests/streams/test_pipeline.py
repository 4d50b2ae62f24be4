"""The threads of a stream: what an error ends, how long a close takes, which result a reader gets."""

import threading
import time
from threading import Event, Thread

import numpy as np
import pytest

from gelform.frames import Frame
from gelform.streams.feed import feed_from_source
from gelform.streams.memory import Memory
from gelform.streams.pipeline import Pipeline
from made.sources import ImageSource


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

    every, state, reason, settings = False, "running", "", {}

    def __init__(self):
        self.frames, self.closed = [], Event()

    def next(self, after_index):
        self.closed.wait(0.001)
        return self.frames.pop(0) if self.frames else None

    def close(self):
        self.closed.set()


def test_an_error_in_the_last_stage_arrives_too(reconstruct, at_rest):
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), Failing(reconstruct))
    pipeline.start()
    first = pipeline.results.newest(timeout_s=60)  # it was given before anything was learned from it
    with pytest.raises(MemoryError, match="no more"):
        pipeline.results.newest(first.index + 10**6, timeout_s=60)
    assert pipeline.stats().state == "failed"
    pipeline.close()


def test_a_slow_stage_does_not_hold_up_capture(reconstruct, at_rest):
    memory = Hanging(reconstruct)
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), memory)
    pipeline.start()
    assert memory.entered.wait(60)
    seen = pipeline.feed.next(-1).index
    assert pipeline.feed.next(seen).index > seen
    assert pipeline.stats().results == 0
    memory.let_go.set()
    pipeline.close()
    assert pipeline.stats().drops > 0 or pipeline.stats().results <= 1


def test_close_ends_every_wait(reconstruct, at_rest):
    """A reader, a writer that waits to be read, and a stage that waits for frames."""
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest, live=False)), Memory(reconstruct))
    pipeline.start()
    time.sleep(0.2)  # nobody reads: both stages wait
    reader = Thread(target=lambda: [None for _ in iter(lambda: pipeline.results.newest(10**6), None)])
    reader.start()
    pipeline.close()
    reader.join(10)
    assert not reader.is_alive()
    assert not any(thread.is_alive() for thread in pipeline._threads)
    assert pipeline.stats().state == "closed"


def test_a_pipeline_that_never_started_closes(reconstruct, at_rest):
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), Memory(reconstruct))
    pipeline.close()
    assert pipeline.feed.state == "ended"


def test_stages_are_timed(reconstruct, at_rest):
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), Memory(reconstruct))
    pipeline.start()
    pipeline.results.newest(timeout_s=60)
    stats = pipeline.stats()
    pipeline.close()
    assert stats.stage_ms.keys() == {"wait", "view", "reconstruct", "remember"} | (
        stats.stage_ms.keys() & {"learn"}
    )
    assert min(stats.stage_ms["reconstruct"], stats.stage_ms["view"]) > 0
    assert stats.latency_ms >= stats.stage_ms["reconstruct"]


def test_a_result_is_given_before_it_is_learned_from(reconstruct, at_rest):
    memory = SlowToLearn(reconstruct)
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), memory)
    pipeline.start()
    first = pipeline.results.newest(timeout_s=60)
    assert memory.learning.wait(60)
    assert pipeline.results.newest(first.index, timeout_s=60).index > first.index
    memory.let_go.set()
    pipeline.close()


def test_a_reader_gets_the_result_that_is_being_made(reconstruct, at_rest):
    """One that lies there since the frame before would be older by a frame."""
    feed, memory = Stepwise(), Hanging(reconstruct)
    memory.let_go.set()
    pipeline = Pipeline(feed, memory)
    pipeline.start()
    feed.frames.append(Frame(at_rest[0], time.monotonic(), 0, 0))
    assert pipeline.results.newest(timeout_s=60).index == 0
    memory.entered.clear()
    memory.let_go.clear()
    feed.frames.append(Frame(at_rest[1], time.monotonic(), 0, 1))
    assert memory.entered.wait(60)
    assert pipeline.results.newest(-1, 0).index == 0  # no time to wait
    found = []
    readers = [
        Thread(target=lambda ask=ask: found.append(ask().index))
        for ask in (pipeline.results.newest, lambda: pipeline.younger_than(3600))
    ]
    for reader in readers:
        reader.start()
    memory.let_go.set()
    for reader in readers:
        reader.join(60)
    pipeline.close()
    assert found == [1, 1]


def test_a_recording_teaches_the_same_each_time(reconstruct, at_rest):
    """Learned from frame by frame: a minute of a light that fades, twice, byte for byte."""
    fading = [(at_rest[k % 10] * (1 - 0.001 * k)).astype(np.uint8) for k in range(30)]

    def last():
        source = ImageSource(fading, live=False, count=30, rate_hz=2.0)
        pipeline = Pipeline(feed_from_source(source), Memory(reconstruct))
        pipeline.start()
        index = -1
        while (seen := pipeline.results.newest(index)) is not None:
            index, result = seen.index, seen.result
        pipeline.close()
        return result.depth, pipeline.memory.reconstruct.background

    (depth, background), (again, background_again) = last(), last()
    np.testing.assert_array_equal(depth, again)
    np.testing.assert_array_equal(background, background_again)
    assert np.abs(background - reconstruct.background).max() > 1  # it learned


def test_the_helper_ends_with_the_pipeline(reconstruct, at_rest):
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), Memory(reconstruct))
    pipeline.start()
    pipeline.results.newest(timeout_s=60)
    assert any(thread.name.startswith("gelform sigma") for thread in threading.enumerate())
    pipeline.close()
    assert not any(thread.name.startswith("gelform") for thread in threading.enumerate())
