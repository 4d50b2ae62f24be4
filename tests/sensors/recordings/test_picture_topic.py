"""Which topic of a bag is the sensor's: the only one of pictures; else a sentence that says what to do."""

import numpy as np
import pytest

from gelform.errors import DataError
from gelform.sensors.recordings.picture_topic import LOOKED_AT, PictureTopic, picture_topic_of
from made.ros_images import image_file, raw_message

pytest.importorskip("mcap.writer", reason="the extra mcap is not installed")
PIXELS = np.zeros((4, 6, 3), np.uint8)
COLOR, UNSAID = raw_message(PIXELS), raw_message(PIXELS, "8UC3")
DEPTH = raw_message(np.zeros((4, 6, 4), np.uint8), "32FC1")


def refusal(path):
    with pytest.raises(DataError) as refused:
        picture_topic_of(path)
    return str(refused.value)


def test_the_colored_one_beside_depth(tmp_path):
    path = image_file(tmp_path / "a.mcap", {"/s/indentation": DEPTH, "/s/image_raw": COLOR})
    assert picture_topic_of(path)[1] == PictureTopic("/s/image_raw", raw=True)


def test_pictures_that_come_late_are_waited_for(tmp_path):
    path = image_file(tmp_path / "a.mcap", {"/image": COLOR}, before=3 * LOOKED_AT)
    assert picture_topic_of(path)[1].name == "/image"


def test_wrong_encodings_are_named(tmp_path):
    said = refusal(image_file(tmp_path / "a.mcap", {"/image": UNSAID, "/depth": DEPTH}))
    assert "/image (8UC3), /depth (32FC1)" in said
    assert "set the camera driver's encoding to rgb8 or bgr8" in said


def test_several_are_not_guessed_among(tmp_path):
    said = refusal(image_file(tmp_path / "a.mcap", {"/left": COLOR, "/right": COLOR}))
    assert "got /left, /right" in said
    assert "mcap filter a.mcap -y /left" in said


def test_no_pictures_at_all(tmp_path):
    assert "beside /joints" in refusal(image_file(tmp_path / "a.mcap", {}, before=3))
    empty = image_file(tmp_path / "b.mcap", {"/image": []})
    assert "beside /image, /joints" in refusal(empty)


def test_compressed_depth_is_no_picture(tmp_path):
    topics = {"/camera/compressedDepth": b"\0\1\0\0"}
    path = image_file(tmp_path / "a.mcap", topics, schema="sensor_msgs/msg/CompressedImage")
    assert "not compressed depth" in refusal(path)


def test_messages_compressed_by_rosbag2_say_so(tmp_path):
    path = image_file(tmp_path / "a.mcap", {"/image": b"\x28\xb5\x2f\xfd" + bytes(40)})
    assert "ros2 bag convert" in refusal(path)
