"""Pictures as ROS 2 messages: the bytes by hand, there and back, torn."""

import numpy as np
import pytest

from gelform.sensors.recordings.messages import (
    message_from_picture,
    picture_from_message,
    pixels_from_raw,
    raw_image_from_message,
)
from made.ros_images import raw_message

WHEN_NS = 5 * 10**9 + 7


def test_the_bytes_are_those_of_cdr():
    message = message_from_picture(b"\xaa\xbb\xcc", "png", WHEN_NS, "cam")
    by_hand = (
        b"\x00\x01\x00\x00"  # little-endian CDR
        + b"\x05\x00\x00\x00\x07\x00\x00\x00"  # sec, nanosec
        + b"\x04\x00\x00\x00cam\x00"
        + b"\x04\x00\x00\x00png\x00"
        + b"\x03\x00\x00\x00\xaa\xbb\xcc"
    )
    assert message == by_hand


def test_there_and_back():
    for frame_id in ("", "a", "camera", "Kamera ü"):
        for kind in ("png", "jpeg"):
            content = bytes(range(256))
            message = message_from_picture(content, kind, WHEN_NS, frame_id)
            assert picture_from_message(message) == (content, WHEN_NS)


def test_torn_and_foreign_messages_are_refused():
    message = message_from_picture(b"\xaa" * 50, "png", WHEN_NS, "cam")
    for end in (0, 3, 10, 20, len(message) - 1):
        with pytest.raises(ValueError, match="Expected"):
            picture_from_message(message[:end])
    with pytest.raises(ValueError, match="little-endian"):
        picture_from_message(b"\x00\x00" + message[2:])


PIXELS = np.arange(2 * 3 * 3, dtype=np.uint8).reshape(2, 3, 3)


def test_raw_pictures_with_padded_rows():
    for frame_id in ("", "a", "cam", "camera"):
        for padding in (0, 3):
            message = raw_message(PIXELS, "rgb8", wall_time_ns=WHEN_NS, padding=padding, frame_id=frame_id)
            image = raw_image_from_message(message)
            assert (image.wall_time_ns, image.shape, image.encoding) == (WHEN_NS, (2, 3), "rgb8")
            np.testing.assert_array_equal(pixels_from_raw(image), PIXELS)


def test_bgr_is_turned_round():
    image = raw_image_from_message(raw_message(PIXELS, "bgr8"))
    np.testing.assert_array_equal(pixels_from_raw(image), PIXELS[..., ::-1])


def test_raw_pictures_that_are_none_are_refused():
    message = raw_message(PIXELS)
    for end in range(len(message)):
        with pytest.raises(ValueError, match="Expected"):
            raw_image_from_message(message[:end])
    with pytest.raises(ValueError, match="rgb8 or bgr8, got 8UC3"):
        pixels_from_raw(raw_image_from_message(raw_message(PIXELS, "8UC3")))
    image = raw_image_from_message(message)
    for wrong in ({"step": 8}, {"shape": (3, 3)}, {"shape": (0, 3)}, {"data": b""}):
        with pytest.raises(ValueError, match="rows of"):
            pixels_from_raw(image._replace(**wrong))


def test_messages_compressed_one_by_one_say_so():
    with pytest.raises(ValueError, match="ros2 bag convert"):
        raw_image_from_message(b"\x28\xb5\x2f\xfd" + bytes(40))
