"""Facts of a recording about its camera; lossless pictures; ROS 2 messages, byte by byte in both directions."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.facts import (
    RecordingFacts,
    encoded_from_frame,
    image_from_encoded,
    reduction_in,
)
from gelform.sensors.recordings.messages import (
    message_from_picture,
    picture_from_message,
    pixels_from_raw,
    raw_image_from_message,
)
from made.recorded import frames
from made.ros_images import raw_message


def test_facts_of_the_first_format_are_read_for_ever_and_damaged_ones_say_so():
    text = (
        '{"name": "DIGIT D1", "serial": "D1", "settings": {"gain": 3.0}, "rate_hz": 60.0, "calibration_digest": "abc", '
        '"library_version": "0.1.0", "format_version": 1}'
    )
    facts = RecordingFacts("DIGIT D1", "D1", {"gain": 3.0}, 60.0, "abc", "0.1.0")
    assert RecordingFacts.from_json(text, "x") == facts
    assert RecordingFacts.from_json(facts.to_json(), "x") == facts
    for text in ("", "[]", '{"format_version": 1, "color": 3}', '{"name": "x"}'):
        with pytest.raises(DataError, match="x is damaged"):
            RecordingFacts.from_json(text, "x")
    newer = RecordingFacts("a", library_version="9.1").to_json().replace('_version": 1', '_version": 2')
    with pytest.raises(DataError, match=r"gelform 9\.1"):
        RecordingFacts.from_json(newer, "x")


def test_pixels_are_kept_without_loss_and_damaged_pictures_say_which():
    frame = frames(1)[0]
    kind, content = encoded_from_frame(frame)
    assert kind == "png"
    np.testing.assert_array_equal(image_from_encoded(content, 1, "x"), frame.image)
    frame = frames(1, encoded=True)[0]
    assert encoded_from_frame(frame) == ("jpeg", frame.encoded)
    image = image_from_encoded(frame.encoded, 2, "x")
    assert image.shape == (24, 32, 3)
    np.testing.assert_allclose(image[5, 5], (200, 0, 5), atol=4)
    assert (reduction_in({}), reduction_in({"reduced": 4})) == (1, 4)
    for content in (b"", b"\x89PNG but torn", frames(1, encoded=True)[0].encoded[:-40]):
        with pytest.raises(DataError, match="frame 7 is damaged"):
            image_from_encoded(content, 1, "frame 7")


def test_noise_is_written_smaller_than_by_repetitions():
    """A smooth image with a camera's noise, against the fastest level of zlib."""
    rows, columns = np.mgrid[:120, :160]
    smooth = np.stack([90 + rows / 4, 80 + columns / 4, 100 - rows / 5], axis=-1)
    image = smooth + np.random.default_rng(0).normal(0, 1.5, smooth.shape)
    frame = replace(frames(1)[0], image=np.rint(image).astype(np.uint8))
    content = encoded_from_frame(frame)[1]
    usual = cv2.imencode(".png", frame.image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 1])[1]
    assert len(content) < 0.85 * len(usual)
    np.testing.assert_array_equal(image_from_encoded(content, 1, "x"), frame.image)


WHEN_NS = 5 * 10**9 + 7


def test_there_and_back_and_torn_or_foreign_ones_refused():
    content = bytes(range(256))
    for frame_id in ("", "a", "camera", "Kamera ü"):
        for kind in ("png", "jpeg"):
            message = message_from_picture(content, kind, WHEN_NS, frame_id)
            assert picture_from_message(message) == (content, WHEN_NS)
    message = message_from_picture(b"\xaa" * 50, "png", WHEN_NS, "cam")
    for end in (0, 3, 10, 20, len(message) - 1):
        with pytest.raises(ValueError, match="Expected"):
            picture_from_message(message[:end])
    with pytest.raises(ValueError, match="Expected"):
        picture_from_message(b"\x00\x00" + message[2:])  # of big numbers first, which these are not


PIXELS = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)


def test_raw_pictures_with_padded_rows():
    for frame_id in ("", "a", "cam", "camera"):
        for padding in (0, 3):
            message = raw_message(PIXELS, "rgb8", wall_time_ns=WHEN_NS, padding=padding, frame_id=frame_id)
            image = raw_image_from_message(message)
            assert (image.wall_time_ns, image.shape, image.encoding) == (WHEN_NS, (2, 3), "rgb8")
            np.testing.assert_array_equal(pixels_from_raw(image), PIXELS)
    image = raw_image_from_message(raw_message(PIXELS, "bgr8"))
    np.testing.assert_array_equal(pixels_from_raw(image), PIXELS[..., ::-1])


def test_raw_pictures_that_are_none_are_refused():
    message = raw_message(PIXELS)
    for end in range(len(message)):
        with pytest.raises(ValueError, match="Expected"):
            raw_image_from_message(message[:end])
    with pytest.raises(ValueError, match=r"rgb8 or bgr8 .*got 8UC3"):
        pixels_from_raw(raw_image_from_message(raw_message(PIXELS, "8UC3")))
    image = raw_image_from_message(message)
    for wrong in ({"step": 8}, {"shape": (3, 3)}, {"shape": (0, 3)}, {"data": np.empty(0, np.uint8)}):
        with pytest.raises(ValueError, match="rows of"):
            pixels_from_raw(image._replace(**wrong))
    with pytest.raises(ValueError, match="ros2 bag convert"):
        raw_image_from_message(b"\x28\xb5\x2f\xfd" + bytes(40))


def test_encodings_of_other_drivers_become_rgb():
    """YUY2 and UYVY of a uniform color, by BT.601 with its limited range: 235 - 16 levels of luma."""
    alpha = np.full((*PIXELS.shape[:2], 1), 9, np.uint8)
    for encoding, stored in (
        ("rgba8", np.concatenate([PIXELS, alpha], axis=2)),
        ("bgra8", np.concatenate([PIXELS[..., ::-1], alpha], axis=2)),
    ):
        message = raw_message(stored, encoding, padding=3)
        np.testing.assert_array_equal(pixels_from_raw(raw_image_from_message(message)), PIXELS)
    luma, u, v = 120, 100, 170
    scaled = 1.164 * (luma - 16)
    wanted = scaled + np.array([1.596 * (v - 128), -0.392 * (u - 128) - 0.813 * (v - 128), 2.017 * (u - 128)])
    for encoding, pair in (("yuv422_yuy2", (luma, u, luma, v)), ("yuv422", (u, luma, v, luma))):
        rows = np.tile(np.array(pair, np.uint8).reshape(1, 2, 2), (4, 3, 1))
        image = pixels_from_raw(raw_image_from_message(raw_message(rows, encoding)))
        assert image.shape == (4, 6, 3)
        assert np.abs(image - wanted).max() < 2
    for encoding, said in (
        ("bayer_rggb8", "image_proc"),
        ("mono8", "in color"),
        ("8UC3", "which channel is red"),
    ):
        with pytest.raises(ValueError, match=f"Expected pictures in rgb8 or .*{said}"):
            pixels_from_raw(raw_image_from_message(raw_message(PIXELS, encoding)))
