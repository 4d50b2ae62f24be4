"""A bag decoded by an independent reader: every value, stamp, frame and type; what cannot become one."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, DataError
from gelform.exporters.surface import points_from_result
from gelform.robots.bag import save_bag
from made.recorded import frames

pytest.importorskip("rosbags", reason="the extra ros is not installed")
pytest.importorskip("mcap", reason="the extra mcap is not installed")
START_NS, RATE_HZ, FRAMES = 1_700_000_000_123_456_789, 50, 4


@pytest.fixture(scope="module")
def truth(recording, calibration):
    """The same frames and results, in order, without a bag."""
    with gelform.stream(recording, calibration) as running:
        return [(seen.frame, seen.result) for seen in running.pairs()]


def of_topic(messages, topic):
    return [message for name, _, message in messages if name == topic]


def floats(message, *shape):
    return np.frombuffer(bytes(message.data), "<f4").reshape(*shape)


def test_the_topics_and_how_often(messages):
    counts = {}
    for topic, _, _ in messages:
        counts[topic] = counts.get(topic, 0) + 1
    assert counts.pop("/diagnostics") == 2  # at the start, and when the torn frame came
    assert counts == {f"/left_finger/{name}": FRAMES for name in ("image_raw", "indentation", "points")}


def test_stamps_are_when_the_frames_were_taken(messages):
    for name in ("image_raw", "indentation", "points"):
        taken = [
            (log, one.header.stamp.sec * 10**9 + one.header.stamp.nanosec)
            for topic, log, one in messages
            if topic == f"/left_finger/{name}"
        ]
        assert taken == [(START_NS + k * 10**9 // RATE_HZ,) * 2 for k in range(FRAMES)]


def test_images_are_the_frames(messages, truth):
    for message, (frame, _) in zip(of_topic(messages, "/left_finger/image_raw"), truth, strict=True):
        height, width = frame.image.shape[:2]
        assert (message.encoding, message.step, message.is_bigendian) == ("rgb8", 3 * width, 0)
        assert message.header.frame_id == "left_finger_camera_optical_frame"
        decoded = np.frombuffer(bytes(message.data), np.uint8).reshape(height, width, 3)
        np.testing.assert_array_equal(decoded, frame.image)


def test_indentation_is_metres_and_nan_where_unknown(messages, truth):
    for message, (_, result) in zip(of_topic(messages, "/left_finger/indentation"), truth, strict=True):
        assert (message.encoding, message.step) == ("32FC1", 4 * result.shape[1])
        assert (message.height, message.width) == result.shape
        assert message.header.frame_id == "left_finger_gel_optical_frame"
        metres = floats(message, *result.shape)
        np.testing.assert_array_equal(np.isnan(metres), ~result.known)
        wanted = np.where(result.known, result.depth_mm * np.float32(1e-3), np.float32("nan"))
        np.testing.assert_array_equal(metres, wanted)
    pressed = floats(of_topic(messages, "/left_finger/indentation")[2], *truth[0][1].shape)
    assert 3e-4 < np.nanmax(pressed) < 6e-4  # a press of 0.5 mm


def test_points_are_in_the_optical_frame(messages, truth):
    for message, (_, result) in zip(of_topic(messages, "/left_finger/points"), truth, strict=True):
        height, width = result.shape
        assert (message.height, message.width, message.point_step, message.row_step) == (
            height,
            width,
            12,
            12 * width,
        )
        assert [(f.name, f.offset, f.datatype, f.count) for f in message.fields] == [
            ("x", 0, 7, 1),
            ("y", 4, 7, 1),
            ("z", 8, 7, 1),
        ]
        assert message.is_dense == bool(result.known.all())
        points = floats(message, height * width, 3)
        known = result.known.ravel()
        np.testing.assert_array_equal(points[known], points_from_result(result)[known] * np.float32(1e-3))
        assert np.isnan(points[~known]).all()
    pressed = floats(of_topic(messages, "/left_finger/points")[2], height, width, 3)
    assert pressed[0, -1, 0] > 0 > pressed[0, 0, 0]  # x to the right
    assert pressed[-1, 0, 1] > 0 > pressed[0, 0, 1]  # y down
    assert np.nanmin(pressed[..., 2]) < -3e-4  # towards the camera, which is at -z


def test_findings_are_diagnostics(messages, truth):
    first, torn = of_topic(messages, "/diagnostics")
    assert truth[3][1].health
    for message, result in ((first, truth[0][1]), (torn, truth[3][1])):
        (status,) = message.status
        assert status.name == "gelform: left_finger"
        assert [pair.key for pair in status.values] == [finding.name for finding in result.health]
        for pair, finding in zip(status.values, result.health, strict=True):
            assert pair.value == f"{finding.figure:g}: {finding.message}"
    assert (first.status[0].level, torn.status[0].level) == (0, 1)  # OK, WARN


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
    with pytest.raises(CalibrationError, match="scale"):
        save_bag(recording, replace(calibration, mm_per_px=None), tmp_path / "bag")
    with pytest.raises(DataError, match="No video file"):
        save_bag(tmp_path / "missing.mp4", calibration, tmp_path / "bag")
    small = tmp_path / "small"
    small.mkdir()
    cv2.imwrite(str(small / "0.png"), frames(1)[0].image)
    with pytest.raises(DataError, match=r"small: .*Expected"):
        save_bag(small, calibration, tmp_path / "bag")
    assert {path.name for path in tmp_path.iterdir()} == {"small"}
