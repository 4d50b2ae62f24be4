"""The threads of a stream: what an error ends, how long a close takes, that kernels run side by side."""

import time
from threading import Event, Thread

import pytest

from gelform.streams.feed import feed_from_source
from gelform.streams.memory import Memory
from gelform.streams.pipeline import Pipeline
from made.sources import ImageSource


class Failing(Memory):
    """Forgets how to remember."""

    def __call__(self, image, result):
        raise MemoryError("no more")


class Hanging(Memory):
    """A stage that does not come back before it is let go."""

    def __init__(self, reconstruct):
        super().__init__(reconstruct)
        self.entered, self.let_go = Event(), Event()

    def __call__(self, image, result):
        self.entered.set()
        self.let_go.wait(60)
        return result


def test_an_error_in_the_last_stage_arrives_too(reconstruct, at_rest):
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), Failing(reconstruct))
    pipeline.start()
    with pytest.raises(MemoryError, match="no more"):
        pipeline.results.newest(timeout_s=60)
    assert pipeline.stats().state == "failed"
    pipeline.close()


def test_a_slow_stage_does_not_hold_up_capture(reconstruct, at_rest):
    memory = Hanging(reconstruct)
    pipeline = Pipeline(feed_from_source(ImageSource(at_rest)), memory)
    pipeline.start()
    assert memory.entered.wait(60)
    seen = pipeline.feed.next(-1).index
    assert pipeline.feed.next(seen).index > seen
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
    assert stats.stage_ms.keys() == {"wait", "view", "reconstruct", "remember"}
    assert stats.stage_ms["reconstruct"] > stats.stage_ms["view"] > 0
    assert stats.latency_ms >= stats.stage_ms["reconstruct"]
