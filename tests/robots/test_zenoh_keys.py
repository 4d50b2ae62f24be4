"""Keys and tokens against those that rmw_zenoh's own documentation and other implementations of it publish."""

import struct

from gelform.robots.zenoh_keys import Node, attachment, dds_type, gid_from_token

IMAGE = "sensor_msgs/msg/Image"
HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"


def test_the_key_of_a_topic():
    key = Node(7, "a1b2", "n").topic_key("/left/image_raw", IMAGE, HASH)
    assert key == f"7/left/image_raw/sensor_msgs::msg::dds_::Image_/{HASH}"
    assert "//" not in key


def test_tokens_have_the_thirteen_parts_that_rmw_zenoh_reads():
    node = Node(0, "a1b2", "gelform_left")
    assert node.token.split("/") == ["@ros2_lv", "0", "a1b2", "0", "0", "NN", "%", "%", "gelform_left"]
    parts = node.publisher_token(3, "/left/image_raw", IMAGE, HASH).split("/")
    assert parts[:9] == ["@ros2_lv", "0", "a1b2", "0", "3", "MP", "%", "%", "gelform_left"]
    assert parts[9:12] == ["%left%image_raw", dds_type(IMAGE), HASH]
    reliability, durability, history, *others = parts[12].split(":")
    assert (reliability, durability, history) == ("", "", ",10")  # rmw_zenoh's default, but for the depth
    assert others == [",", ",", ",,"]


def test_an_attachment_is_number_time_and_gid_little_endian():
    gid = gid_from_token("some token")
    made = attachment(1, 2**40, gid)
    assert struct.unpack("<qqB", made[:17]) == (1, 2**40, 16)
    assert made[17:] == gid
    assert len(gid) == 16
    assert gid != gid_from_token("another token")
