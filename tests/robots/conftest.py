"""A small recording of a simulated sensor, the bag of it, and an independent reader of bags."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from gelform.image.view import Frame
from gelform.robots.send import save_bag
from gelform.sensors.playback import RecordingFacts
from gelform.simulate import Ball, Pose, simulate_pose
from live_waiting import free_port
from made.sources import recorded

START_NS, RATE_HZ = 1_700_000_000_123_456_789, 50


@pytest.fixture(scope="session")
def recording(sensor, made_once):
    """A recording of four frames: a gel at rest, then pressed; one of them torn."""
    return made_once("bag_recording", lambda path: _recorded(path, sensor))


def _recorded(path, sensor):
    rng, given = np.random.default_rng(7), []
    for k, depth_mm in enumerate((0.0, 0.3, 0.5, 0.5)):
        image = simulate_pose(sensor, Ball(3.0), Pose(depth_mm), rng=rng).image
        if k == 3:
            image[80:] = 0  # a torn frame: its lower part never came
        given.append(Frame(image, k / RATE_HZ, START_NS + k * 10**9 // RATE_HZ, k))
    return recorded(path.with_suffix(".mcap"), given, RecordingFacts("a gel", rate_hz=50.0))


@pytest.fixture(scope="session")
def bag(recording, calibration, tmp_path_factory):
    """The bag of that recording."""
    pytest.importorskip("rosbags", reason="the extra ros is not installed")
    path = tmp_path_factory.mktemp("bags") / "press"
    save_bag(recording, calibration, path, sensor="left_finger")
    return path


@pytest.fixture(scope="session")
def messages(bag):
    """(topic, log time, message) of all, decoded by mcap-ros2-support, which shares no code with the writer."""
    reader = pytest.importorskip("mcap_ros2.reader", reason="mcap-ros2-support is not installed")
    return [
        (one.channel.topic, one.log_time_ns, one.ros_msg)
        for one in reader.read_ros2_messages(str(bag / "press.mcap"))
    ]


@pytest.fixture(scope="session")
def router():
    """A zenoh router: its address, its session, and `opened`, which opens others."""
    zenoh = pytest.importorskip("zenoh", reason="the extra ros is not installed")
    pytest.importorskip("rosbags", reason="the extra ros is not installed")

    def opened(**settings):
        config = zenoh.Config()
        for key, value in {"scouting/multicast/enabled": False, **settings}.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    address = f"tcp/127.0.0.1:{free_port()}"
    session = opened(mode="router", **{"listen/endpoints": [address]})
    yield SimpleNamespace(address=address, session=session, opened=opened)
    session.close()
