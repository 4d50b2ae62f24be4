"""A recording through a calibration to a subscriber; what cannot be published."""

import json
import socket
import threading
from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, DataError, GelformError

pytest.importorskip("zenoh", reason="the extra zenoh is not installed")
pytest.importorskip("rosbags", reason="the extra zenoh is not installed")
import zenoh

from gelform.robots.publish import publish
from gelform.robots.ros_messages import typestore


@pytest.fixture(scope="module")
def address():
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        address = f"tcp/127.0.0.1:{one.getsockname()[1]}"
    config = zenoh.Config()
    for key, value in {"mode": "router", "listen/endpoints": [address]}.items():
        config.insert_json5(key, json.dumps(value))
    config.insert_json5("scouting/multicast/enabled", "false")
    router = zenoh.open(config)
    yield address, router
    router.close()


def test_results_of_a_recording_are_published(address, recording, calibration):
    where, router = address
    got, came = {}, threading.Event()
    subscription = router.declare_subscriber(
        "4/left/indentation/**", lambda sample: (got.update({len(got): sample}), came.set())
    )
    with gelform.stream(recording, calibration) as running:
        wanted = [result.depth_mm * np.float32(1e-3) for result in running]
    for _ in range(20):  # a subscription takes a moment to spread, and the recording lasts 0.06 s
        stats = publish(recording, calibration, topics=["indentation"], sensor="left", router=where, domain=4)
        if came.wait(0.5):
            break
    subscription.undeclare()
    assert stats.stamped
    assert stats.frames >= 1
    message = typestore().deserialize_cdr(got[0].payload.to_bytes(), "sensor_msgs/msg/Image")
    metres = np.nan_to_num(message.data.view("<f4").reshape(message.height, message.width))
    assert any(
        np.array_equal(metres, np.nan_to_num(one)) or np.abs(metres - one).max() < 1e-5 for one in wanted
    )


def test_what_cannot_be_published_is_said(address, recording, calibration, tmp_path):
    with pytest.raises(CalibrationError, match="scale"):
        publish(recording, replace(calibration, mm_per_px=None), router=address[0])
    with pytest.raises(DataError, match="No video file"):
        publish(tmp_path / "missing.mp4", calibration, router=address[0])
    with pytest.raises(GelformError, match=r"No zenoh router answers at tcp/127\.0\.0\.1:1\."):
        publish(recording, calibration, router="tcp/127.0.0.1:1")
    with pytest.raises(ValueError, match="topics among"):
        publish(recording, calibration, topics=["depth"], router=address[0])
