"""Names of ROS: made of what people call a sensor, checked where they are given."""

import re

import pytest

from gelform.robots.topics import TOPICS, check_sensor_name, check_topics, sensor_name_from


def test_a_name_is_made_of_any_text():
    for text, name in [
        ("GelSight Mini", "gelsight_mini"),
        ("digit", "digit"),
        ("-- R1.5/b --", "r1_5_b"),
        ("3rd gel", "sensor_3rd_gel"),
        ("", "sensor"),
        ("ゲル", "sensor"),
    ]:
        assert sensor_name_from(text) == name
        assert check_sensor_name(name) == name


def test_what_ros_refuses_is_refused():
    for name in ["", "Left", "a__b", "_a", "a_", "3a", "a-b", "a/b", "a b", "a\n"]:
        with pytest.raises(ValueError, match="name of ROS"):
            check_sensor_name(name)


def test_whole_topic_names():
    names = [topic.of("left") for topic in TOPICS.values()]
    assert names == ["/left/image_raw", "/left/indentation", "/left/points", "/diagnostics"]
    assert all(re.fullmatch(r"\w+_msgs/msg/\w+", topic.type) for topic in TOPICS.values())


def test_topics_come_in_the_tables_order_once():
    assert check_topics(["points", "image", "points"]) == ("image", "points")
    assert check_topics("points") == ("points",)
    for wrong in ([], ["depth"], ["image", "camera_info"]):
        with pytest.raises(ValueError, match="Expected topics among image, indentation"):
            check_topics(wrong)
