"""The effect of a sequence on results: smoothing, a zero, refused frames.

The threads of a stream: effect of an error, duration of a close, the result that a reader gets, the counts.
"""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from dataclasses import replace
from queue import Queue
from threading import Event, Thread, current_thread

import numpy as np
import pytest

from gelform import Reconstructor, depth_from_gradients
from gelform.errors import Finding
from gelform.image.health import DepthLimit
from gelform.image.view import Frame
from gelform.result import Reconstruction
from gelform.sensors.grabber import Newest
from gelform.sensors.streams.memory import (
    NOT_THIS_GEL,
    Memory,
    Smoothing,
    against_zero,
    result_from_image,
    zero_from_results,
)
from gelform.sensors.streams.pipeline import Pipeline, feed_from_source
from gelform.sensors.streams.sensor_health import BackgroundDrift
from gelform.sensors.streams.stream import Stream
from made.images import grid, image_of_dots
from made.sources import ImageSource


def remembered(memory, images, rate_hz=25.0):
    """The results of a sequence of images."""
    results = []
    for index, image in enumerate(images):
        result = replace(memory.result_from_image(image), index=index, time_s=index / rate_hz)
        results.append(memory(image, result))
    return results


def test_smoothing_is_asked_for(reconstruct, at_rest):
    plain = remembered(Memory(reconstruct), at_rest)
    smooth = remembered(Memory(reconstruct, smoothing=1.0), at_rest)
    assert smooth[-1].depth_sigma_mm.mean() < plain[-1].depth_sigma_mm.mean()
    moved = [np.abs(one[-1].depth - one[-2].depth).mean() for one in (smooth, plain)]
    assert moved[0] < 0.4 * moved[1]


def test_it_learns_from_a_frame_of_each_look_and_from_all_of_a_background_that_is_asked_for(
    reconstruct, at_rest, monkeypatch
):
    def learned(memory, asked=False):
        times_s = []
        monkeypatch.setattr(
            BackgroundDrift, "__call__", lambda _, image, result: times_s.append(result.time_s)
        )
        memory._drift.asked = asked
        remembered(memory, at_rest)
        return times_s

    assert learned(Memory(reconstruct)) == pytest.approx(np.arange(10) / 25)
    assert learned(Memory(reconstruct, look_s=0.1)) == pytest.approx([0, 0.12, 0.2, 0.32])
    assert len(learned(Memory(reconstruct, look_s=0.1), asked=True)) == 10


def test_a_frame_alone_is_reconstructed_whatever_came_before(reconstruct, at_rest, pressed):
    memory = Memory(reconstruct, smoothing=5.0)
    for index, image in enumerate(at_rest):
        memory.reconstructed(Frame(image, index / 25, 10**18, index))
    given = memory.reconstructed(Frame(pressed[0], 7.0, 10**18, 20), alone=True)
    np.testing.assert_array_equal(given.result.depth, reconstruct.from_image(pressed[0]).depth)
    assert (given.result.index, given.result.time_s, given.index) == (20, 7.0, 20)


@pytest.fixture
def zeroed(reconstruct, at_rest, pressed):
    """Results before and after a tilt of the gel at rest was set as zero: of the tilt itself, and of a press over it."""
    rest, press = (reconstruct.from_image(images[0]) for images in (at_rest, pressed))
    x = np.arange(rest.shape[1], dtype=np.float32)
    slope = np.float32([0.002 / rest.mm_per_px, 0])
    tilted, over = (
        replace(one, depth=one.depth + 0.002 * x, gradients=one.gradients + slope) for one in (rest, press)
    )
    zero = zero_from_results([tilted, tilted])
    return press, over, against_zero(tilted, zero), against_zero(over, zero)


def test_against_a_zero_a_press_is_as_deep_as_over_the_gel_at_rest(zeroed, reconstruct):
    press, over, rest, found = zeroed
    np.testing.assert_allclose(rest.depth, 0, atol=1e-6)
    assert not rest.contact.any()
    assert rest.zero == found.zero == "set"
    inside = press.contact
    assert np.abs(over.depth - press.depth)[inside].mean() > 0.02
    assert np.abs(found.depth - press.depth)[inside].mean() < 0.01
    assert found.contact[inside].mean() > 0.85
    assert (found.contact & ~inside).mean() < 0.02


def test_against_a_zero_depth_slopes_and_deviations_agree(zeroed):
    """Integrated, the slopes give the depth; nothing is more certain than before."""
    press, over, _, found = zeroed
    integrated = depth_from_gradients(found.gradients, mm_per_px=found.mm_per_px)
    difference = integrated - found.depth
    assert np.std(difference) < 0.003 < 0.03 < np.std(found.depth)
    assert np.std(depth_from_gradients(over.gradients, mm_per_px=found.mm_per_px) - found.depth) > 0.05
    assert (found.depth_sigma_mm >= press.depth_sigma_mm).all()
    assert (found.depth_sigma_mm > press.depth_sigma_mm).mean() > 0.9
    assert (found.gradients_sigma >= press.gradients_sigma).all()
    assert (found.depth_difference_sigma() >= press.depth_difference_sigma(found.contact)).all()


def test_the_memory_learns_against_the_gel_at_rest_whatever_the_zero(reconstruct, pressed):
    memory = Memory(reconstruct)
    frame = Frame(pressed[0], 0.0, 10**18, 0)
    memory.zero = zero_from_results([memory.reconstructed(frame).result])
    given = memory.reconstructed(frame)
    assert not given.result.contact.any()
    assert given.against_rest.contact.any()
    learned = []
    memory.learn = lambda image, result: learned.append(result)
    memory.learn_from(given)
    assert learned == [given.against_rest]


def test_a_finding_of_the_sequence_is_not_repeated(reconstruct, pressed):
    one, other = (Finding(name, "of the sequence", 1.0) for name in ("torn", "other_camera"))
    memory, mine = Memory(reconstruct, standing=lambda: (one, other)), Finding("torn", "of the image", 0.5)
    result = replace(reconstruct.from_image(pressed[0]), health=(mine,))
    assert memory.remembered(pressed[0], result).health == (mine, other)


def test_marker_dots_are_followed_from_frame_to_frame(calibration):
    """Over one and a half spacings, where a Reconstructor alone takes them for their neighbors."""
    shape, pitch = calibration.image_shape, 14.0
    rest = grid(pitch, shape, 12.0)
    away = np.sum(((rest - [70, 50]) / [70, 60]) ** 2, axis=1)
    drag = np.exp(-1.2 * away)[:, None] * np.array([1.5 * pitch, 0.4 * pitch])
    marked = replace(calibration, background=image_of_dots(rest, shape=shape).astype(np.float32))
    images = [image_of_dots(rest + share * drag, shape=shape) for share in np.linspace(0, 1, 12)]
    flow = remembered(Memory(Reconstructor(marked)), images)[-1].markers
    nearest = np.linalg.norm(flow.rest_px[:, None] - rest, axis=-1).argmin(axis=1)
    error = np.linalg.norm(flow.displacement_px - drag[nearest], axis=1)[flow.seen]
    assert error.max() < 1.0
    alone = Reconstructor(marked).from_image(images[-1]).markers
    assert np.linalg.norm(alone.displacement_px, axis=1).max() < pitch


def test_of_another_gel_nothing_is_known_and_the_refusal_is_a_finding(reconstruct, at_rest):
    """The gel's image turned over: no gain makes one of the other."""
    foreign = np.ascontiguousarray(at_rest[0][::-1, ::-1, [2, 0, 1]])
    result = result_from_image(reconstruct, foreign)
    assert result.health[-1].name == NOT_THIS_GEL
    assert "background" in result.health[-1].message
    for nothing in (result.known, result.confidence, result.contact):
        assert not nothing.any()
    limit = DepthLimit.of(result.shape, result.mm_per_px).ignorance_mm
    assert result.depth_sigma_mm.min() == np.float32(limit)
    assert result.calibration_digest == reconstruct.calibration.digest
    with pytest.raises(ValueError, match="132"):
        result_from_image(reconstruct, at_rest[0][:-1])


SHAPE, PITCH, RATE_HZ = (48, 64), 0.1, 50.0
SYSTEMATIC_MM, NOISE_MM = 0.010, 0.004


def result_of(depth, index):
    """A result whose deviation is an error that all frames share, and noise of this frame."""
    ones = np.ones(SHAPE, np.float32)
    return Reconstruction(
        depth=depth.astype(np.float32),
        depth_sigma_mm=ones * np.float32(np.hypot(SYSTEMATIC_MM, NOISE_MM)),
        gradients=np.zeros((*SHAPE, 2), np.float32),
        gradients_sigma=None,
        confidence=ones,
        contact=depth > 0.02,
        known=ones > 0,
        mm_per_px=PITCH,
        index=index,
        time_s=index / RATE_HZ,
    )


def smoothed(truths, time_s, seed=0):
    """Every result of the truths with noise."""
    rng, smooth = np.random.default_rng(seed), Smoothing(time_s)
    noisy = (truth + rng.normal(0, NOISE_MM, SHAPE) for truth in truths)
    return [smooth(result_of(depth, index)) for index, depth in enumerate(noisy)]


def test_noise_falls_as_exponential_weights_say_from_the_first_frames_on():
    """Of a time constant of n frames the mean's variance is k/(2 - k), k = 1 - exp(-1/n)."""
    n = 10
    results = smoothed([np.zeros(SHAPE)] * 80, n / RATE_HZ)
    k = 1 - np.exp(-1 / n)
    found = np.std([result.depth for result in results[60::10]])
    assert found == pytest.approx(NOISE_MM * np.sqrt(k / (2 - k)), rel=0.25)
    expected = np.sqrt(SYSTEMATIC_MM**2 + NOISE_MM**2 * k / (2 - k))
    assert np.median(results[-1].depth_sigma_mm) == pytest.approx(expected, rel=0.03)
    fifth = smoothed([np.zeros(SHAPE)] * 5, 10.0)[-1]
    assert fifth.depth.std() == pytest.approx(NOISE_MM / np.sqrt(5), rel=0.2)


def test_a_step_is_followed_in_its_first_frame():
    step = np.zeros(SHAPE)
    step[10:30, 20:40] = 0.1
    first = smoothed([np.zeros(SHAPE)] * 30 + [step], 1.0)[-1]
    assert first.depth[15:25, 25:35].mean() == pytest.approx(0.1, abs=0.002)
    assert abs(first.depth[36:, :10].std()) < NOISE_MM / 3  # what stood still stays averaged
    assert first.depth_sigma_mm[20, 30] > first.depth_sigma_mm[44, 4]


def test_what_is_slower_than_noise_is_late_by_the_time_constant():
    rate_mm_per_s, time_s = 0.02, 0.2
    truths = [np.full(SHAPE, rate_mm_per_s * index / RATE_HZ) for index in range(100)]
    lag_s = (truths[-1].mean() - smoothed(truths, time_s)[-1].depth.mean()) / rate_mm_per_s
    assert 0.5 * time_s < lag_s <= 1.1 * time_s


def test_slopes_are_those_of_the_smoothed_depth():
    x = np.broadcast_to(np.arange(SHAPE[1]) * PITCH, SHAPE)
    result = smoothed([0.3 * x] * 40, 1.0)[-1]
    np.testing.assert_allclose(result.gradients[5:-5, 5:-5, 0].mean(), 0.3, atol=0.002)


def test_time_that_goes_back_starts_anew_and_what_is_no_time_is_refused():
    smooth = Smoothing(1.0)
    for index in range(5):
        smooth(result_of(np.zeros(SHAPE), index))
    again = smooth(result_of(np.full(SHAPE, 0.003), 0))
    np.testing.assert_allclose(again.depth, 0.003)
    for time_s in (-1, np.nan, 1e3, "long"):
        with pytest.raises((ValueError, TypeError), match="smoothing"):
            Smoothing(time_s)


def test_results_of_the_frame_itself_stay():
    result = result_of(np.zeros(SHAPE), 3)
    seen = Smoothing(0.5)(result)
    assert (seen.index, seen.time_s) == (3, result.time_s)
    assert seen.contact is result.contact
    assert Smoothing(0.5)(replace(result, depth_sigma_mm=None)).depth_sigma_mm is None


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


def test_results_drops_ages_and_the_median_of_each_stage_are_counted(reconstruct, at_rest, monkeypatch):
    feed = Stepwise()
    with running(feed, Memory(reconstruct)) as pipeline:
        stats = pipeline.stats()
        assert (stats.results, stats.drops, stats.rate_hz, stats.stage_ms) == (0, 0, 0, {})
        assert stats.age_s == math.inf
        assert math.isnan(stats.latency_ms)
        for index in (5, 6, 9, 10):  # what came before the first result is no drop of the stream's
            feed.frames.append(Frame(at_rest[0], time.monotonic() - 3, 0, index))
            assert pipeline.results.newest(index - 1, timeout_s=60).index == index
        for seconds in (0.001, 0.002, 0.5):
            pipeline.took("mine", seconds)
        stats = pipeline.stats()
        monkeypatch.setattr("gelform.sensors.streams.pipeline.STALE_S", 0.0)
        assert pipeline.stats().rate_hz == 0, "the last result is old"
    assert (stats.results, stats.drops) == (4, 2)
    assert stats.rate_hz > 0
    assert 3 <= stats.age_s < 60
    assert 3000 <= stats.latency_ms < 60_000
    assert stats.stage_ms["mine"] == pytest.approx(2)
    assert stats.stage_ms.keys() - {"learn", "mine"} == {"wait", "view", "reconstruct", "remember"}
    assert min(stats.stage_ms["reconstruct"], stats.stage_ms["view"]) > 0


def test_late_readers_get_the_newest_alone_and_do_not_take_from_each_other():
    values = Newest()
    for number, value in enumerate("abc"):
        values.put(number, value)
    assert values.newest() == values.newest(after=1) == next(iter(values)) == "c"
    assert values.newest(after=2, timeout_s=0.01) is None


def test_where_every_value_counts_the_writer_waits():
    values, done = Newest(every=True), Event()
    started(lambda: ([values.put(k, value) for k, value in enumerate("abc")], done.set()))
    assert [values.newest(k - 1, timeout_s=5) for k in range(2)] == ["a", "b"]
    unread = Newest(every=True)
    unread.put(0, "a")
    writer = started(lambda: unread.put(1, "b"))
    writer.join(0.05)
    assert writer.is_alive()  # an unread one is not replaced
    unread.end()  # frees a writer that nobody reads from any more
    writer.join(5)
    assert not writer.is_alive()
    assert done.wait(5)


def test_the_end_wakes_readers_and_its_error_comes_after_the_last_value():
    values, found = Newest(), []
    reader = started(lambda: found.append(values.newest()))
    values.end()
    reader.join(5)
    assert found == [None]
    values = Newest()
    values.put(0, "a")
    values.end(ValueError("broken"))
    values.end()
    assert values.newest() == "a"
    with pytest.raises(ValueError, match="broken"):
        values.newest(after=0)
    assert values.ended


def test_a_value_that_is_being_made_is_waited_for():
    """What lies here gets older while the new one is made: a reader gets the new one, where it comes in time."""
    values, found = Newest(), []
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


class Hanging(Memory):
    """A stage that does not come back before it is let go: `remembered` or `learn`."""

    def __init__(self, reconstruct, stage="remembered"):
        super().__init__(reconstruct)
        self.entered, self.let_go = Event(), Event()
        own = getattr(self, stage)

        def hang(image, result):
            self.entered.set()
            self.let_go.wait(60)
            return own(image, result)

        setattr(self, stage, hang)


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


def test_slow_work_is_made_on_a_thread_of_its_own(reconstruct, at_rest):
    memory, makers = Memory(reconstruct), Queue()
    memory.examine(lambda: makers.put(current_thread().name))
    assert makers.get(timeout=0) == current_thread().name, "alone, it is made at once"
    with running(ImageSource(at_rest), memory):
        memory.examine(lambda: makers.put(current_thread().name))
        assert makers.get(timeout=60) == "gelform examine"


def test_an_error_in_the_last_stage_arrives_too(reconstruct, at_rest):
    def fail(*_):
        raise MemoryError("no more")

    memory = Memory(reconstruct)
    memory.learn = fail
    with running(ImageSource(at_rest), memory) as pipeline:
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


def test_a_result_is_given_before_it_is_learned_from(reconstruct, at_rest):
    memory = Hanging(reconstruct, "learn")
    with running(ImageSource(at_rest), memory) as pipeline:
        first = pipeline.results.newest(timeout_s=60)
        assert memory.entered.wait(60)
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
