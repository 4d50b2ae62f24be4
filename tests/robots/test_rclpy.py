"""The node of ROS 2 with the real rclpy, in a process of its own; every message decoded by ROS's own types.

Skipped where rclpy cannot be imported; `.ci/run` makes an environment from ROS's wheels.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

import gelform
from gelform.depth.force import ForceModel, ForcePart
from gelform.exchange.exporters.surface import points_from_result
from gelform.motion.track import Follower
from gelform.robots.ros_messages import optical_pose
from live_waiting import until
from made import small_gel
from made.sources import MjpegServer, part, recorded

rclpy = pytest.importorskip("rclpy", reason="no rclpy: ROS 2 is not in this environment")
pytest.importorskip("rosbags", reason="the extra ros is not installed")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.qos import QoSProfile, ReliabilityPolicy  # noqa: E402
from sensor_msgs.msg import CompressedImage, Image, PointCloud2  # noqa: E402
from std_srvs.srv import Trigger  # noqa: E402

pytestmark = pytest.mark.slow
INTEGRATION = Path(__file__).parents[2] / "integrations" / "ros2"
RUN = "from gelform_ros.node import main; main()"
FORCE = ForceModel(
    ForcePart(((2.0,),), (0.001, 9.0), 0.2, 0.1, 9), None, None, ((0.0, 0.0),), ("ball",), "", ""
)
DOMAIN = os.getpid() % 100  # so that tests that run at once do not hear each other
WAIT_S = 60.0  # what has not come by then never will
CALM = {"ROS_DOMAIN_ID": str(DOMAIN), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


@pytest.fixture
def started():
    """Starts processes of nodes with given parameters; none outlives the test."""
    running = []

    def start(*parameters, program=RUN, name="gelform"):
        running.append(process_of(*parameters, program=program, name=name))
        return running[-1]

    yield start
    for one in running:
        one.kill()
        one.communicate()


def process_of(*parameters, program, name):
    named = ["--ros-args", "-r", f"__node:={name}"]
    given = [word for one in parameters for word in ("-p", one)]
    paths = os.pathsep.join([str(INTEGRATION), *filter(None, sys.path)])
    return subprocess.Popen(
        [sys.executable, "-c", program, *named, *given],
        env={**os.environ, **CALM, "PYTHONPATH": paths},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def ended(process, how=signal.SIGINT):
    """What the process said, and its status, after a signal."""
    process.send_signal(how)
    return process.communicate(timeout=WAIT_S)[0].splitlines(), process.returncode


class Listener:
    """Subscriptions of one node: `got[name]` are a topic's messages."""

    def __init__(self):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.node = rclpy.create_node("listener", context=self.context)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)
        self.got = {}

    def hear(self, topic, kind, reliability=ReliabilityPolicy.RELIABLE, name=None):
        got = self.got[name or topic] = []
        self.node.create_subscription(kind, topic, got.append, QoSProfile(depth=100, reliability=reliability))
        return got

    def until(self, true):
        def heard():
            for _ in range(100):  # what has come; each call takes one message
                self._executor.spin_once(timeout_sec=0)
            return true()

        return until(heard, WAIT_S)

    def call(self, service):
        client = self.node.create_client(Trigger, service)
        self.until(client.service_is_ready)
        future = client.call_async(Trigger.Request())
        self.until(future.done)
        return future.result()


@pytest.fixture
def listener(monkeypatch):
    for name, value in CALM.items():
        monkeypatch.setenv(name, value)
    one = Listener()
    yield one
    rclpy.shutdown(context=one.context)


@pytest.fixture
def calibration(tmp_path):
    """The path of a known gel's calibration, which converts touches to newtons."""
    known = small_gel.calibration()
    replace(known, force=replace(FORCE, calibration_digest=known.digest)).save(tmp_path / "cal.npz")
    return tmp_path / "cal.npz"


def stamp_of(message):
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec


def floats(message, *shape):
    return np.frombuffer(bytes(message.data), "<f4").reshape(*shape)


def test_every_topic_by_ros_s_own_types_equals_the_result(listener, started, calibration, tmp_path):
    """Both reliabilities; the recording rests for longer than a stream remembers, until the subscribers are found."""
    start_ns, frames = 1_700_000_000_123_456_789, []
    for k in range(16):
        touch = small_gel.Touch(x_px=38 + k / 4, seed=k) if k > 1 else None
        time_s = 0.06 * k + 6.0 * (k > 0)
        frames.append(gelform.Frame(small_gel.image_of(touch), time_s, start_ns + round(time_s * 1e9), k))
    recording = recorded(tmp_path / "press.mcap", frames)
    with gelform.stream(recording, calibration) as running:
        truth = {one.frame.wall_time_ns: (one.frame.image, one.result) for one in running.pairs()}
    best = ReliabilityPolicy.BEST_EFFORT
    images = listener.hear("/left/image_raw", Image)
    packed = listener.hear("/left/image_raw/compressed", CompressedImage)
    depths = listener.hear("/left/indentation", Image)
    unsure = listener.hear("/left/indentation", Image, best, "best effort")
    clouds = listener.hear("/left/points", PointCloud2)
    wrenches = listener.hear("/left/wrench", WrenchStamped)
    listener.hear("/left/object_pose", PoseWithCovarianceStamped, best)
    said = listener.hear("/diagnostics", DiagnosticArray)
    topics = "image,compressed,indentation,points,wrench,pose,diagnostics"
    node = started(f"calibration:={calibration}", f"source:={recording}", "name:=left", f"topics:={topics}")
    listener.until(lambda: node.poll() is not None)  # a recording ends, and the node with it
    everything = (
        images,
        packed,
        depths,
        clouds,
        wrenches,
    )  # of the first frame, those whose subscribers were found
    listener.until(lambda: len({stamp_of(one[-1]) for one in everything}) == 1)
    assert node.returncode == 0, node.communicate()[0]
    assert len(images) > 4  # of 16, on a busy machine
    heard = {kind: {stamp_of(one): one for one in given} for kind, given in listener.got.items()}
    follow, places = Follower(), 0
    for stamp in (stamp_of(one) for one in images):
        image, result = truth[stamp]
        assert (image.shape[:2], "rgb8") == ((images[0].height, images[0].width), images[0].encoding)
        raw = heard["/left/image_raw"][stamp]
        if stamp == start_ns:
            continue
        np.testing.assert_array_equal(np.frombuffer(bytes(raw.data), np.uint8), image.ravel())
        assert raw.header.frame_id == "left_camera_optical_frame"
        wanted = np.where(result.known, result.depth_mm * np.float32(1e-3), np.float32("nan"))
        for name in ("/left/indentation", "best effort"):
            if name == "best effort" and stamp not in heard[name]:
                continue
            np.testing.assert_array_equal(floats(heard[name][stamp], *result.shape), wanted)
            assert heard[name][stamp].header.frame_id == "left_gel_optical_frame"
        points = floats(heard["/left/points"][stamp], wanted.size, 3)
        known = result.known.ravel()
        np.testing.assert_array_equal(points[known], points_from_result(result)[known] * np.float32(1e-3))
        picture = heard["/left/image_raw/compressed"][stamp]
        assert picture.format == "png"
        decoded = cv2.imdecode(np.frombuffer(bytes(picture.data), np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_array_equal(decoded[..., ::-1], image)
        force = heard["/left/wrench"][stamp].wrench.force
        np.testing.assert_array_equal([force.x, force.y, force.z], result.force.vector_n)
        motion = follow(result).motion
        if motion.pose is not None and (message := heard["/left/object_pose"].get(stamp)):
            place, turn, covariance = optical_pose(motion.pose, motion.covariance, motion.center_mm)
            at, towards = message.pose.pose.position, message.pose.pose.orientation
            np.testing.assert_array_equal([at.x, at.y, at.z], place)
            np.testing.assert_array_equal([towards.x, towards.y, towards.z, towards.w], turn)
            np.testing.assert_array_equal(message.pose.covariance, covariance.ravel())
            places += 1
    assert places > 2
    assert len(unsure) > 2
    assert all(one.wrench.force.z < 0 for one in wrenches[-5:])  # toward the camera
    findings = {name.message for one in said for name in one.status}
    assert findings - {"no_frame"} <= {
        ", ".join(one.name for one in result.health) or "OK" for _, result in truth.values()
    }
    assert "no_frame" in findings  # between the first frame and the second


REST = small_gel.Touch(depth_mm=0.0)


class Camera:
    """Pieces for a server: pictures of a touch, each with other noise, while the camera is there; else nothing."""

    def __init__(self, touch):
        self.there = True
        self.show(touch)

    def show(self, touch):
        images = [small_gel.image_of(replace(touch, seed=seed)) for seed in range(8)]
        self.contents = [
            cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
            for image in images
        ]

    def __iter__(self):
        number = 0
        while self.there:
            yield part(self.contents[number % len(self.contents)])
            yield 0.04
            number += 1
        yield None


@contextmanager
def camera_of(touch):
    """A camera that a server has, at `url`."""
    camera = Camera(touch)
    with MjpegServer(camera) as server:
        camera.url = server.url
        try:
            yield camera
        finally:
            camera.there = False


def test_a_sensor_goes_and_comes_back_and_services_say_why_not(listener, started, calibration):
    said = listener.hear("/diagnostics", DiagnosticArray)
    packed = listener.hear("/gel/image_raw/compressed", CompressedImage)

    def says(message):
        said.clear()
        listener.until(lambda: any(message in one.status[0].message for one in said))
        return next(one.status[0] for one in said if message in one.status[0].message)

    with camera_of(REST) as camera:
        given = [f"calibration:={calibration}", f"source:={camera.url}", "name:=gel"]
        node = started(*given, "topics:=compressed,diagnostics", "camera_frame:=wrist", name="gel_node")
        listener.until(lambda: packed)
        assert bytes(packed[0].data) in camera.contents  # the camera's own bytes
        assert (packed[0].format, packed[0].header.frame_id) == ("jpeg", "wrist")
        assert listener.call("/gel_node/take_background").success
        refused = listener.call("/gel_node/reset_pose")
        assert (refused.success, refused.message[:21]) == (False, "No pose is published:")
        camera.show(small_gel.Touch())
        listener.until(lambda: bytes(packed[-1].data) in camera.contents)
        refused = listener.call("/gel_node/take_background")
        assert not refused.success
        assert "The background was not taken." in refused.message
        assert says("background_refused").level == b"\x01"
        camera.there = False
        gone = says("no_frame")
        assert gone.level == b"\x02"
        assert gone.values[0].value.startswith("reconnecting: ")
        refused = listener.call("/gel_node/take_background")
        assert not refused.success
        assert "The stream is reconnecting" in refused.message
        camera.there = True
        packed.clear()
        listener.until(lambda: packed)
        lines, status = ended(node)
    assert status == 0, lines
    assert len(lines) == 1, lines


def test_two_nodes_of_two_sensors_and_a_late_subscriber(listener, started, calibration):
    with camera_of(REST) as one, camera_of(small_gel.Touch()) as two:
        left = started(f"calibration:={calibration}", f"source:={one.url}", "name:=left", name="gelform_left")
        right = started(
            f"calibration:={calibration}",
            f"source:={two.url}",
            *("name:=right", "gel_frame:=right_pad", "depth_only:=true", "rate:=5"),
            name="gelform_right",
        )
        flat = listener.hear("/left/indentation", Image)
        deep = listener.hear("/right/indentation", Image)
        listener.until(lambda: len(flat) > 20 and len(deep) > 5)
        late = listener.hear("/right/indentation", Image, ReliabilityPolicy.BEST_EFFORT, "late")
        listener.until(lambda: len(late) > 2)
        topics = dict(listener.node.get_topic_names_and_types())
        assert np.nanmax(floats(flat[-1], -1)) < 1e-4 < 3e-4 < np.nanmax(floats(deep[-1], -1))
        assert (flat[0].header.frame_id, deep[0].header.frame_id) == ("left_gel_optical_frame", "right_pad")
        assert {"/left/points", "/left/image_raw", "/right/indentation"} <= set(topics)
        assert "/right/points" not in topics
        stamps = np.diff([stamp_of(message) for message in deep]) / 1e9
        assert np.median(stamps) == pytest.approx(0.2, abs=0.045)  # frames are 0.04 s apart
        assert [ended(node)[1] for node in (left, right)] == [0, 0]


WRONG = {
    "calibration:=none.npz": "No file none.npz",
    "name:=left": "path of a calibration",
    "source:=no_such_camera": "No camera 'no_such_camera'",
    "topics:=depth": "Expected topics among image",
    "rate:=fast": "Expected `rate`",
    "rate:=-1": "Expected `rate`",
    "depth_only:=3": "expecting type 'BOOL'",
    "background:=none.png": "No file none.png",
    "name:=Left": "Expected a name of ROS",
    "calibration": "Couldn't parse",
}
EACH = """
import sys
from gelform_ros.node import run
for one in sys.argv[4:][1::2]:
    print("status", run(one.split("|")), flush=True)
"""


def test_what_is_wrong_ends_with_one_line_of_ros_s_log_and_status_1(started, calibration):
    good = f"|-p|calibration:={calibration}"
    cases = [f"--ros-args{good if k > 1 else ''}|-p|{wrong}" for k, wrong in enumerate(WRONG)]
    lines = started(*cases, program=EACH).communicate(timeout=WAIT_S)[0].splitlines()
    lines = [
        line for line in lines if "[rcl]" not in line
    ]  # its own line about arguments that it cannot read
    for (wrong, said), line, status in zip(WRONG.items(), lines[::2], lines[1::2], strict=True):
        assert line.startswith("[FATAL]"), (wrong, lines)
        assert said in line, wrong
        assert status == "status 1", wrong


def test_frames_of_another_size_end_the_node_with_status_1(started, calibration, tmp_path):
    small_gel.save(tmp_path / "wrong" / "0.png", np.zeros((10, 20, 3), np.uint8))
    node = started(f"calibration:={calibration}", f"source:={tmp_path / 'wrong'}")
    (line,) = node.communicate(timeout=WAIT_S)[0].splitlines()
    assert "Expected frames of 64x80 px" in line
    assert node.returncode == 1


FROM_OUTSIDE = """
import threading, rclpy
from gelform_ros import node
class Node(node.GelformNode):
    sent = 0
    def _send(self, *given):
        super()._send(*given)
        self.sent += 1
        if self.sent == 20:
            threading.Thread(target=rclpy.shutdown).start()
node.GelformNode = Node
node.main()
"""


@pytest.mark.parametrize("how", ["SIGINT", "SIGTERM", "shutdown"])
def test_an_end_while_publishing_is_one_line_and_status_0(listener, started, calibration, how):
    with camera_of(REST) as camera:
        given = [f"calibration:={calibration}", f"source:={camera.url}", "name:=gel"]
        node = started(*given, program=FROM_OUTSIDE if how == "shutdown" else RUN)
        depths = listener.hear("/gel/indentation", Image)
        if how == "shutdown":
            listener.until(lambda: node.poll() is not None)  # what nobody hears is not sent
            lines, status = node.communicate(timeout=WAIT_S)[0].splitlines(), node.returncode
        else:
            listener.until(lambda: len(depths) > 3)
            lines, status = ended(node, getattr(signal, how))
    assert status == 0, lines
    assert len(lines) == 1, lines
    assert "[INFO]" in lines[0]


@pytest.mark.parametrize("after_s", [0.5, 1.0, 1.5, 2.0])
def test_ctrl_c_while_it_starts_is_at_most_one_line(started, calibration, after_s):
    """Its imports take a second or two."""
    with camera_of(REST) as camera:
        node = started(f"calibration:={calibration}", f"source:={camera.url}", "name:=gel")
        time.sleep(after_s)
        lines, status = ended(node)
    assert status in (0, 130), lines
    assert len(lines) <= 1, lines
    assert not any("Traceback" in line for line in lines)


def test_the_launch_file_gives_parameters_that_the_node_has():
    """There is no wheel of ROS's launch: read as XML, and each parameter found in the node's own source."""
    declared = (INTEGRATION / "gelform_ros" / "node.py").read_text(encoding="utf-8")
    root = ElementTree.parse(INTEGRATION / "launch" / "two_fingers.launch.xml").getroot()
    nodes = {one.get("name"): one for one in root.iter("node")}
    assert set(nodes) == {"gelform_left", "gelform_right", "left_gel", "right_gel"}
    for side in ("left", "right"):
        given = {one.get("name"): one.get("value") for one in nodes[f"gelform_{side}"].iter("param")}
        assert set(given) == {"source", "calibration", "name"}
        assert all(f'"{name}"' in declared for name in given)
        assert given["name"] + "_gel_optical_frame" in nodes[f"{side}_gel"].get("args")


COMMAND = "from gelform.cli import main; main()"


def test_the_command_publishes_by_rclpy_and_ends_by_ctrl_c(listener, calibration):
    depths = listener.hear("/left/indentation", Image)
    with camera_of(small_gel.Touch()) as camera:
        words = ["ros", camera.url, "-c", str(calibration), "--name", "left", "--accept-doubtful"]
        paths = os.pathsep.join(filter(None, sys.path))
        command = subprocess.Popen(
            [sys.executable, "-c", COMMAND, *words],
            env={**os.environ, "PYTHONPATH": paths},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            listener.until(lambda: len(depths) > 3)
        finally:
            lines, status = ended(command)
    assert status == 0, lines
    assert any("Published" in line for line in lines), lines
    assert not any("Traceback" in line for line in lines), lines
    assert 3e-4 < np.nanmax(floats(depths[-1], -1)) < 5e-4
