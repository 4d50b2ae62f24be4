"""Records in their order: channels once, messages with their topic, the rest as it is."""

import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.mcap_records import Channel, Placed, mcap_records
from made.ros_images import image_file

pytest.importorskip("mcap.writer", reason="the extra mcap is not installed")


def test_channels_once_and_messages_with_their_topic(tmp_path):
    found = list(mcap_records(image_file(tmp_path / "a.mcap", {"/image": [b"a", b"b"]}, before=1)))
    channels = [one for one in found if isinstance(one, Channel)]
    assert channels == [
        Channel("/joints", "sensor_msgs/msg/JointState", "cdr"),
        Channel("/image", "sensor_msgs/msg/Image", "cdr"),
    ]
    placed = [(one.topic, one.message.data) for one in found if isinstance(one, Placed)]
    assert placed == [("/joints", b"\0\1\0\0"), ("/image", b"a"), ("/image", b"b")]
    assert type(found[-1]).__name__ == "Footer"


def test_cut_short_it_ends_without_a_footer(tmp_path):
    path = image_file(tmp_path / "a.mcap", {"/image": b"a"})
    path.write_bytes(path.read_bytes()[:-20])
    assert type(list(mcap_records(path))[-1]).__name__ != "Footer"


def test_what_is_no_mcap_file(tmp_path):
    with pytest.raises(DataError, match="No recording"):
        list(mcap_records(tmp_path / "missing.mcap"))
    text = tmp_path / "a.mcap"
    text.write_text("this is text, and long enough to be looked at")
    with pytest.raises(DataError, match="no MCAP file"):
        list(mcap_records(text))
