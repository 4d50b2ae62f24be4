"""A stream for its user: newest first, bounded ages, errors arrive, threads end; every frame of a recording.

Without a calibration it starts with a starter's, after a second of the gel at rest.
"""

import gc
import os
import re
import signal
import threading
import time
from dataclasses import replace
from itertools import islice
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, DataError, SensorError, StaleError
from gelform.image.view import View
from gelform.sensors import new_recording, record_frames
from gelform.sensors.grabber import Grabber
from gelform.sensors.record import KEPT_FRAMES
from gelform.sensors.streams.pipeline import feed_from_source
from gelform.sensors.streams.stream import still_stretches
from live_waiting import until
from made.sources import ImageSource

MAKE = "simulated-three-edges"


@pytest.fixture(autouse=True)
def no_library_and_every_thread_ends(tmp_path, monkeypatch):
    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path / "none"))
    yield
    left = [thread for thread in threading.enumerate() if thread.name.startswith(("gelform", "grab"))]
    assert left == []


class TouchedFirst(ImageSource):
    """A sensor on which something moves until it is let go."""

    def __init__(self, rest, pressed):
        super().__init__(rest, rate_hz=60)
        self.pressed, self.touched = pressed, True

    def __iter__(self):
        for frame in super().__iter__():
            moved = self.touched and frame.index // 5 % 2
            yield replace(frame, image=self.pressed[0]) if moved else frame


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
        begun = stream._memory
        assert begun.memory.examine is begun.examine, "slow work is made where the pipeline says"
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
    moving = [one for pair in zip(unpressed[0.0], unpressed[0.4]) for one in pair]
    with pytest.raises(CalibrationError, match=r"first frames.*simulated-three-edges.*background="):
        list(gelform.stream(ImageSource(moving, live=False, count=20), sensor=MAKE))


def test_a_recording_that_begins_in_contact_takes_a_later_stretch_at_rest(unpressed):
    images = [*unpressed[0.4] * 2, *unpressed[0.0]]
    results = list(gelform.stream(ImageSource(images, live=False, count=len(images)), sensor=MAKE))
    assert results[0].peak_mm == pytest.approx(0.4, abs=0.08)
    assert results[-1].peak_mm < 0.05
    assert "background_touched" not in {one.name for one in results[0].health}


@pytest.mark.parametrize(("noise", "step"), [(0.0, 0.0), (1.0, 0.0), (1.0, 0.7)])
def test_steps_that_a_film_has_at_rest_are_no_motion(noise, step):
    """Compressed video steps by gray levels from image to image; a touch moves by more of them."""
    rng = np.random.default_rng(0)
    smooth = cv2.resize(rng.normal(0, step, (12, 6, 8, 3)).reshape(72, 8, 3), (80, 720)).reshape(
        12, 60, 80, 3
    )
    film = 90 + smooth + rng.normal(0, noise, (12, 60, 80, 3))
    film[8:, 20:40, 30:50] += 40
    images = [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in film]
    assert still_stretches(images) == [range(8), range(8, 12)]


def test_a_background_that_is_given_wins(unpressed):
    background = np.mean(unpressed[0.0], axis=0)
    source = ImageSource(unpressed[0.4], live=False, count=3)
    results = list(gelform.stream(source, sensor=MAKE, background=background))
    assert [result.index for result in results] == [0, 1, 2]
    assert results[0].peak_mm == pytest.approx(0.4, abs=0.08)


def test_the_library_comes_before_the_starter(unpressed, tmp_path, monkeypatch):
    from gelform.calibration.library import add_calibration

    monkeypatch.setenv("GELFORM_CALIBRATIONS", str(tmp_path))
    background = np.mean(unpressed[0.0], axis=0)
    mine = gelform.calibration_from_background(background, MAKE, serial="S7", gel_id="mine")
    add_calibration(mine)
    source = ImageSource(unpressed[0.0], live=False, count=1)
    source.serial = "S7"
    (result,) = gelform.stream(source, sensor=MAKE)
    assert result.calibration_digest == mine.digest


def test_another_make_reaches_who_reads(unpressed):
    """Also where only the source names it: a GelSight Mini's name is taken for it, and what it shows is not its light."""
    lying = ImageSource([i.transpose(1, 0, 2) for i in unpressed[0.0]], live=False, count=4)
    with pytest.raises(CalibrationError, match="background of a DIGIT"):
        list(gelform.stream(lying, sensor="digit"))
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


def test_results_carry_what_is_known_of_their_frames(calibration, pressed):
    with gelform.stream(ImageSource(pressed), calibration) as stream:
        first, second = (result for result, _ in zip(stream, range(2)))
    assert second.index > first.index >= 0
    assert second.time_s > first.time_s
    assert 0 < time.monotonic() - first.time_s < 60
    assert first.wall_time_ns is not None
    assert first.calibration_digest == calibration.digest
    assert first.peak_mm == pytest.approx(0.5, abs=0.1)


def test_a_recording_loses_no_frame_and_is_as_without_a_stream(calibration, reconstruct, pressed):
    source = ImageSource(pressed, live=False, count=7)
    results = list(gelform.stream(source, calibration))
    assert [result.index for result in results] == list(range(7))
    np.testing.assert_array_equal(results[6].depth, reconstruct.from_image(pressed[6]).depth)


def test_the_threads_of_the_process_and_its_environment_stay(calibration, pressed):
    there, before = dict(os.environ), cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with gelform.stream(ImageSource(pressed), calibration) as stream:
            next(iter(stream))
        assert (cv2.getNumThreads(), dict(os.environ)) == (3, there)
    finally:
        cv2.setNumThreads(before)


def test_a_slow_consumer_gets_the_newest_frame(calibration, at_rest):
    """The frame that is being reconstructed and one on its way; not those that came while the consumer slept."""
    with gelform.stream(ImageSource(at_rest, rate_hz=20), calibration) as stream:
        indices = []
        for result in stream:
            indices.append(result.index)
            if len(indices) == 4:
                break
            time.sleep(0.5)
            newest = stream.newest().index
            assert newest - result.index >= 3  # capture went on
        assert np.diff(indices).min() >= 3
    assert stream.stats.results > len(indices)


def test_a_loop_or_a_with_block_closes_the_stream_and_a_forgotten_one_ends(calibration, at_rest):
    for _result in gelform.stream(ImageSource(at_rest), calibration):
        break
    stream = gelform.stream(ImageSource(at_rest), calibration)
    assert stream.newest(timeout_s=10) is not None
    del stream
    gc.collect()
    with gelform.stream(ImageSource(at_rest), calibration) as stream:
        first = next(iter(stream)).index
        assert stream.newest(after_index=first, timeout_s=5).index > first
        assert stream.stats.state == "running"
    assert stream.stats.state == "closed"
    stream.close()


def test_threads_that_share_a_loop_share_its_results(calibration, at_rest):
    with gelform.stream(ImageSource(at_rest, live=False, count=30), calibration) as stream:
        for of in (iter(stream), stream.pairs()):
            got, failed = [], []

            def read(of=of, got=got, failed=failed):
                try:
                    got.extend(one.index for one in islice(of, 5))
                except ValueError as problem:
                    failed.append(problem)

            threads = [threading.Thread(target=read) for _ in range(3)]
            for one in threads:
                one.start()
            for one in threads:
                one.join()
            assert not failed
            assert len(set(got)) == 15


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_a_fork_of_an_open_stream_is_told_so(calibration, at_rest):
    with gelform.stream(ImageSource(at_rest), calibration) as stream:
        stream.newest()
        child = os.fork()
        if child == 0:
            signal.alarm(20)
            try:
                next(iter(stream))
            except SensorError as problem:
                os._exit(7 if "before a fork" in str(problem) else 1)
            finally:
                os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 7


def test_an_error_of_the_source_or_a_stage_reaches_every_consumer(calibration, at_rest):
    broken = ImageSource(at_rest, count=2, fails=SensorError("the cable is out"))
    odd = ImageSource([at_rest[0], at_rest[0][:-2]])  # another size: no frame of this sensor's
    for source, error, said in (
        (broken, SensorError, "the cable is out"),
        (odd, ValueError, r"frames of 132x176 px.*got 130x176. Set the camera's width"),
    ):
        with gelform.stream(source, calibration) as stream:
            for read in (list, lambda stream: stream.latest(0.0)):
                with pytest.raises(error, match=said):
                    read(stream)
            assert stream.stats.state == "failed"
            assert re.search(said, stream.stats.reason)


def test_images_of_the_calibrated_size_pass_beside_frames_of_the_view(calibration, at_rest):
    height, width = calibration.image_shape
    wide = View((2 * height, 2 * width), image_shape=(height, width))
    frame = cv2.resize(at_rest[0], (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
    for given in (at_rest[0], frame):
        with gelform.stream(ImageSource([given]), replace(calibration, view=wide)) as stream:
            assert next(iter(stream)).depth_mm.shape == calibration.image_shape


def test_latest_is_never_older_than_asked(calibration, at_rest):
    with (
        Grabber(lambda: ImageSource(at_rest, count=3)) as grabber,
        gelform.stream(grabber, calibration) as stream,
    ):
        result = stream.latest(5.0)
        assert time.monotonic() - result.time_s < 5
        time.sleep(0.3)
        with pytest.raises(StaleError, match=r"at most 0.05 s old, the newest is .* s old"):
            stream.latest(0.05)
        assert stream.latest(60).index == 2
        assert stream.stats.age_s > 0.25


def test_images_are_held_for_the_last_results(calibration, at_rest):
    source = ImageSource(at_rest, live=False, count=10)
    with gelform.stream(source, calibration) as stream:
        pairs = list(stream.pairs())
        assert stream.image_of(pairs[-1].result) is pairs[-1].image
        np.testing.assert_array_equal(pairs[-1].image, at_rest[9])
        with pytest.raises(LookupError, match="frame 0"):
            stream.image_of(pairs[0].result)


def test_several_sensors_at_once_and_one_for_several_streams(calibration, at_rest, pressed):
    rest, press = (ImageSource(images) for images in (at_rest, pressed))
    with gelform.stream(rest, calibration) as left, gelform.stream(press, calibration) as right:
        assert left.latest(30).peak_mm < 0.1 < right.latest(30).peak_mm
    with (
        Grabber(lambda: ImageSource(at_rest)) as grabber,
        gelform.stream(grabber, calibration) as page,
        gelform.stream(grabber, calibration) as robot,
    ):
        assert page.latest(30).index >= 0
        page.close()
        index = robot.newest().index
        assert robot.newest(after_index=index, timeout_s=10) is not None


def test_one_sensor_for_a_stream_and_a_recorder(calibration, at_rest, tmp_path):
    """The stream takes the newest frame, the recorder misses none."""
    held = 20 * KEPT_FRAMES  # of a busy machine too
    with Grabber(lambda: ImageSource(at_rest, rate_hz=50), keep=held) as grabber:
        with gelform.stream(grabber, calibration) as stream:
            recording = new_recording(tmp_path / "session.mcap", grabber)
            written = record_frames(grabber, recording, frames=30)
            recording.close()
            assert stream.newest(timeout_s=30).result.known.all()
        assert grabber.state == "running"
    taken = list(gelform.open_source(tmp_path / "session.mcap"))
    assert written.missing == 0
    assert np.diff([frame.index for frame in taken]).tolist() == [1] * 29


def test_a_frame_that_is_not_of_this_gel_is_a_finding(calibration, at_rest):
    """A gel that was taken off: no exception, nothing known, and the next frame is as any other."""
    off = np.full_like(at_rest[0], 90)
    off[:, ::2] = 30
    source = ImageSource([at_rest[0], off, at_rest[1]], live=False, count=3)
    before, odd, after = gelform.stream(source, calibration)
    assert odd.health
    assert not odd.known.any() or odd.depth_sigma_mm.min() > 0.5
    assert after.known.all()
    assert before.known.all()


SPOILT = {
    "dark": np.zeros_like,
    "saturated": lambda image: np.full_like(image, 255),
    "torn": lambda image: np.vstack([image[:66], np.full_like(image[66:], 128)]),
    "frozen": lambda image: image,
}


@pytest.mark.parametrize(("name", "spoil"), SPOILT.items())
def test_a_frame_that_shows_nothing_is_a_result_with_the_reason(calibration, at_rest, spoil, name):
    """Eight at 10 Hz, so that one which hangs is seen to."""
    source = ImageSource([spoil(at_rest[0])], live=False, count=8, rate_hz=10.0)
    last = list(gelform.stream(source, calibration))[-1]
    assert name in [finding.name for finding in last.health]
    assert np.isfinite([last.depth_mm, last.depth_sigma_mm]).all()
    unknown = ~last.known
    assert unknown.mean() > 0.3
    assert last.depth_sigma_mm[unknown].min() > 0.5


def test_a_folder_gives_every_frame_in_order(at_rest, tmp_path):
    for number, image in enumerate(at_rest[:4]):
        cv2.imwrite(str(tmp_path / f"{number}.png"), image[..., ::-1])
    feed = feed_from_source(tmp_path)
    assert feed.every
    frames = [feed.next(-1) for _ in range(4)]
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    np.testing.assert_array_equal(frames[0].image, at_rest[0])
    assert feed.state == "running"
    assert feed.next(3) is None
    assert (feed.state, feed.reason) == ("ended", "the source has no more frames")


def test_a_live_source_is_opened_once_and_a_shared_one_goes_on(at_rest):
    """A camera cannot be opened twice."""
    opened = []

    def open_it():
        opened.append(ImageSource(at_rest))
        return opened[-1]

    feed = feed_from_source(open_it)
    assert not feed.every
    first = feed.next(-1)
    assert feed.next(first.index).index > first.index
    assert feed.state == "running"
    feed.close()
    assert feed.state == "ended"
    assert [one.closed for one in opened] == [True]
    with Grabber(open_it) as grabber:
        feed_from_source(grabber).close()
        assert grabber.newest(-1, 5) is not None
        assert grabber.state == "running"


def test_what_is_no_source():
    with pytest.raises(TypeError, match=r"Expected a source.*float"):
        feed_from_source(7.0)
    with pytest.raises(DataError, match="nowhere"):
        feed_from_source("nowhere.mp4")


class OddSource(ImageSource):
    """Its third frame is none."""

    def __init__(self, images, odd, **settings):
        super().__init__(images, **settings)
        self.odd = odd

    def __iter__(self):
        for frame in super().__iter__():
            yield self.odd(frame) if frame.index == 2 else frame


def unlike(**values):
    """What has the fields of a frame, except these; a Frame itself refuses them."""
    return lambda frame: SimpleNamespace(**{**vars(frame), **values})


@pytest.mark.parametrize("live", [False, True])
@pytest.mark.parametrize(
    ("odd", "said"),
    [
        (unlike(time_s=float("nan")), "Expected time_s in seconds in frame 2 of images, got nan"),
        (unlike(time_s=None), "Expected time_s in seconds in frame 2"),
        (unlike(index=1), "whose index grows, got 1 after 1"),
        (unlike(image=None), r"an image \(H, W, 3\) from images, got NoneType"),
        (lambda frame: replace(frame, image=frame.image[:, :-8]), "Expected frames of"),
    ],
)
def test_a_frame_that_is_none_is_named_and_those_before_it_are_there(calibration, at_rest, odd, said, live):
    results, source = [], OddSource(at_rest, odd, live=live, rate_hz=20, count=6)
    with (
        pytest.raises((SensorError, ValueError), match=said),
        gelform.stream(source, calibration, smoothing=0.1) as stream,
    ):
        results.extend(stream)
    assert all(np.isfinite(result.depth).all() for result in results)
    assert live or [result.index for result in results] == [0, 1]


@pytest.mark.slow
def test_whoever_takes_a_background_may_wait_for_the_outcome(calibration, at_rest, pressed):
    with gelform.stream(ImageSource(at_rest), calibration) as stream:
        before = stream.newest().result.depth
        assert stream.take_background(60.0) == ()
        until(lambda: not np.array_equal(stream.newest().result.depth, before))
    with gelform.stream(ImageSource(pressed), calibration) as stream:
        assert [one.name for one in stream.take_background(60.0)] == ["background_refused"]
        assert [one.name for one in stream.take_background(60.0)] == ["background_touched"]
    with gelform.stream(ImageSource(at_rest, rate_hz=2), calibration) as stream:
        assert stream.take_background() == ()
        with pytest.raises(
            StaleError, match=r"a second of frames within 0\.1 s. The stream is (starting|running)"
        ):
            stream.take_background(0.1)
