"""Pictures as ROS 2 messages: the bytes by hand, there and back, torn."""

import pytest

from gelform.sensors.recordings.messages import message_from_picture, picture_from_message

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


@pytest.mark.parametrize("frame_id", ["", "a", "camera", "Kamera ü"])
@pytest.mark.parametrize("kind", ["png", "jpeg"])
def test_there_and_back(frame_id, kind):
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
