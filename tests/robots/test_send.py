"""Sending a stream: stamps, counts and ends; an independent reader decodes every value of a bag."""

import threading
import time
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, DataError
from gelform.exchange.exporters.surface import points_from_result
from gelform.robots.send import publish, save_bag, send_results
from gelform.sensors.mcap import typestore
from made.small_gel import save
from made.sources import ImageSource

START_NS, RATE_HZ, FRAMES = 1_700_000_000_123_456_789, 50, 4


def sent(source, calibration, seconds=None):
    """The stamps of what was sent, and the figures."""
    stamps = []
    with gelform.stream(source, calibration) as running:
        stats = send_results(running, "here", "left", lambda *given: stamps.append(given[2]), seconds)
    return stamps, stats


def test_stamps_are_those_of_the_frames_and_seconds_end_it(recording, calibration):
    stamps, stats = sent(recording, calibration)
    assert stamps == [START_NS + k * 10**9 // RATE_HZ for k in range(4)]
    assert (stats.sensor, stats.frames, stats.drops, stats.stamped) == ("left", 4, 0, True)
    assert stats.duration_s == pytest.approx(3 / RATE_HZ)
    stamps, stats = sent(recording, calibration, 1.5 / RATE_HZ)
    assert len(stamps) == stats.frames == 2


def test_frames_without_a_time_are_stamped_from_now_on(recording, calibration, tmp_path):
    for frame in islice(gelform.open_source(recording), 2):
        save(tmp_path / f"{frame.index}.png", frame.image)
    before = time.time_ns()
    (first, second), stats = sent(tmp_path, calibration)
    assert before <= first <= time.time_ns()
    assert second - first == 10**9 // 25
    assert not stats.stamped


def test_an_empty_source_is_an_error(calibration):
    with pytest.raises(DataError, match="arrived from here: there is nothing to send"):
        sent(ImageSource([], live=False, count=0), calibration)


@pytest.fixture(scope="module")
def truth(recording, calibration):
    """The same frames and results, in order, without a bag."""
    with gelform.stream(recording, calibration) as running:
        return [(seen.frame, seen.result) for seen in running.pairs()]


def of_topic(messages, name):
    return [message for topic, _, message in messages if topic in (name, f"/left_finger/{name}")]


def floats(message, *shape):
    return np.frombuffer(bytes(message.data), "<f4").reshape(*shape)


def test_the_topics_how_often_and_when_the_frames_were_taken(messages):
    assert len(of_topic(messages, "/diagnostics")) == 2  # at the start, and when the torn frame came
    topics = [f"/left_finger/{name}" for name in ("image_raw", "indentation", "points")]
    assert {topic for topic, _, _ in messages} == {*topics, "/diagnostics"}
    for wanted in topics:
        of = [(log, one.header.stamp) for topic, log, one in messages if topic == wanted]
        taken = [(log, stamp.sec * 10**9 + stamp.nanosec) for log, stamp in of]
        assert taken == [(START_NS + k * 10**9 // RATE_HZ,) * 2 for k in range(FRAMES)]


def test_images_are_the_frames_and_indentation_is_meters_and_nan_where_unknown(messages, truth):
    images, depths = (of_topic(messages, name) for name in ("image_raw", "indentation"))
    for image, depth, (frame, result) in zip(images, depths, truth, strict=True):
        assert (image.encoding, image.step, image.is_bigendian) == ("rgb8", 3 * result.shape[1], 0)
        assert (depth.encoding, depth.step) == ("32FC1", 4 * result.shape[1])
        for message, kind in ((image, "camera"), (depth, "gel")):
            assert (message.height, message.width) == result.shape
            assert message.header.frame_id == f"left_finger_{kind}_optical_frame"
        decoded = np.frombuffer(bytes(image.data), np.uint8).reshape(frame.image.shape)
        np.testing.assert_array_equal(decoded, frame.image)
        wanted = np.where(result.known, result.depth_mm * np.float32(1e-3), np.float32("nan"))
        np.testing.assert_array_equal(floats(depth, *result.shape), wanted)


def test_points_are_in_the_optical_frame(messages, truth):
    clouds = of_topic(messages, "points")
    for message, (_, result) in zip(clouds, truth, strict=True):
        height, width = result.shape
        assert (message.height, message.width) == (height, width)
        assert (message.point_step, message.row_step) == (12, 12 * width)
        fields = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
        assert fields == [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1)]
        assert message.is_dense == bool(result.known.all())
        points = floats(message, height * width, 3)
        known = result.known.ravel()
        np.testing.assert_array_equal(points[known], points_from_result(result)[known] * np.float32(1e-3))
        assert np.isnan(points[~known]).all()
    pressed = floats(clouds[-2], height, width, 3)
    assert pressed[0, -1, 0] > 0 > pressed[0, 0, 0]  # x to the right
    assert pressed[-1, 0, 1] > 0 > pressed[0, 0, 1]  # y down
    assert -6e-4 < np.nanmin(pressed[..., 2]) < -3e-4  # toward the camera, which is at -z; a press of 0.5 mm


def test_a_bag_is_a_source_that_gives_the_same_results(bag, truth, calibration):
    with gelform.stream(bag, calibration) as running:
        again = list(running.pairs())
    assert len(again) == FRAMES
    for seen, (frame, result) in zip(again, truth, strict=True):
        np.testing.assert_array_equal(seen.frame.image, frame.image)
        np.testing.assert_array_equal(seen.result.depth_mm, result.depth_mm)
        assert (seen.frame.index, seen.frame.wall_time_ns) == (frame.index, frame.wall_time_ns)
        assert seen.time_s == pytest.approx(frame.time_s, abs=1e-6)


def test_what_cannot_become_a_bag_is_said_and_leaves_nothing(recording, calibration, tmp_path):
    for source, cal, error, said in (
        (recording, replace(calibration, mm_per_px=None), CalibrationError, "scale"),
        (tmp_path / "missing.mp4", calibration, DataError, "No video file"),
    ):
        with pytest.raises(error, match=said):
            save_bag(source, cal, tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_results_of_a_recording_are_published(router, recording, calibration):
    got, came = {}, threading.Event()
    subscription = router.session.declare_subscriber(
        "4/left/indentation/**", lambda sample: (got.update({len(got): sample}), came.set())
    )
    with gelform.stream(recording, calibration) as running:
        wanted = [result.depth_mm * np.float32(1e-3) for result in running]
    how = {"topics": ["indentation"], "sensor": "left", "router": router.address, "domain": 4}
    for _ in range(20):  # a subscription takes a moment to spread, and the recording lasts 0.06 s
        stats = publish(recording, calibration, **how)
        if came.wait(0.5):
            break
    subscription.undeclare()
    assert stats.stamped
    assert stats.frames >= 1
    message = typestore().deserialize_cdr(got[0].payload.to_bytes(), "sensor_msgs/msg/Image")
    meters = np.nan_to_num(message.data.view("<f4").reshape(message.height, message.width))
    assert min(np.abs(meters - np.nan_to_num(one)).max() for one in wanted) < 1e-5


def test_what_cannot_be_published_is_said(router, recording, calibration, tmp_path):
    with pytest.raises(CalibrationError, match="scale"):
        publish(recording, replace(calibration, mm_per_px=None), router=router.address)
    with pytest.raises(DataError, match="No video file"):
        publish(tmp_path / "missing.mp4", calibration, router=router.address)
