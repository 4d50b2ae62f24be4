"""Sending a stream: stamps, counts and ends; an independent reader decodes every value of a bag.

Keys and tokens equal rmw_zenoh's; a node, a router and a subscriber talk over zenoh's own sockets.

A bag is complete or absent: interrupted, failing, killed, on a full disk.
"""

import queue
import signal
import struct
import subprocess
import sys
import threading
import time
from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

import gelform
from gelform import Frame, GelformError, Reconstruction, open_source
from gelform.errors import CalibrationError, DataError, Finding
from gelform.exchange.exporters.surface import points_from_result
from gelform.robots import send
from gelform.robots.send import (
    BagFile,
    Node,
    ZenohNode,
    attachment,
    dds_type,
    gid_from_token,
    publish,
    save_bag,
    send_results,
)
from gelform.sensors.mcap import typestore
from made.small_gel import save
from made.sources import ImageSource

Reader = pytest.importorskip("rosbags.rosbag2", reason="the extra ros is not installed").Reader
START_NS, RATE_HZ, FRAMES = 1_700_000_000_123_456_789, 50, 4


def sent(source, calibration, seconds=None, **how):
    """The stamps of what was sent, and the figures."""
    stamps = []
    with gelform.stream(source, calibration) as running:
        stats = send_results(running, "here", "left", lambda *given: stamps.append(given[2]), seconds, **how)
    return stamps, stats


def test_stamps_are_those_of_the_frames_and_seconds_end_it(recording, calibration):
    stamps, stats = sent(recording, calibration)
    assert stamps == [START_NS + k * 10**9 // RATE_HZ for k in range(4)]
    assert (stats.sensor, stats.frames, stats.drops, stats.stamped) == ("left", 4, 0, True)
    assert stats.duration_s == pytest.approx(3 / RATE_HZ)
    stamps, stats = sent(recording, calibration, 1.5 / RATE_HZ)
    assert len(stamps) == stats.frames == stats.tally.frames == 2


def test_findings_are_tallied_as_often_as_asked(recording, calibration):
    stamps, stats = sent(recording, calibration, look_s=2.5 / RATE_HZ)
    assert (len(stamps), stats.frames, stats.tally.frames) == (4, 4, 2)


def test_frames_without_a_time_are_stamped_from_now_on(recording, calibration, tmp_path):
    for frame in islice(gelform.open_source(recording), 2):
        save(tmp_path / f"{frame.index}.png", frame.image)
    before = time.time_ns()
    (first, second), stats = sent(tmp_path, calibration)
    assert before <= first <= time.time_ns()
    assert second - first == 10**9 // 25
    assert not stats.stamped


def test_an_empty_source_is_an_error(calibration):
    with pytest.raises(DataError, match="arrived from here: there is nothing to send"):
        sent(ImageSource([], live=False, count=0), calibration)


@pytest.fixture(scope="module")
def truth(recording, calibration):
    """The same frames and results, in order, without a bag."""
    with gelform.stream(recording, calibration) as running:
        return [(seen.frame, seen.result) for seen in running.pairs()]


def of_topic(messages, name):
    return [message for topic, _, message in messages if topic in (name, f"/left_finger/{name}")]


def floats(message, *shape):
    return np.frombuffer(bytes(message.data), "<f4").reshape(*shape)


def test_the_topics_how_often_and_when_the_frames_were_taken(messages):
    assert len(of_topic(messages, "/diagnostics")) == 2  # at the start, and when the torn frame came
    topics = [f"/left_finger/{name}" for name in ("image_raw", "indentation", "points")]
    assert {topic for topic, _, _ in messages} == {*topics, "/diagnostics"}
    for wanted in topics:
        of = [(log, one.header.stamp) for topic, log, one in messages if topic == wanted]
        taken = [(log, stamp.sec * 10**9 + stamp.nanosec) for log, stamp in of]
        assert taken == [(START_NS + k * 10**9 // RATE_HZ,) * 2 for k in range(FRAMES)]


def test_images_are_the_frames_and_indentation_is_meters_and_nan_where_unknown(messages, truth):
    images, depths = (of_topic(messages, name) for name in ("image_raw", "indentation"))
    for image, depth, (frame, result) in zip(images, depths, truth, strict=True):
        assert (image.encoding, image.step, image.is_bigendian) == ("rgb8", 3 * result.shape[1], 0)
        assert (depth.encoding, depth.step) == ("32FC1", 4 * result.shape[1])
        for message, kind in ((image, "camera"), (depth, "gel")):
            assert (message.height, message.width) == result.shape
            assert message.header.frame_id == f"left_finger_{kind}_optical_frame"
        decoded = np.frombuffer(bytes(image.data), np.uint8).reshape(frame.image.shape)
        np.testing.assert_array_equal(decoded, frame.image)
        wanted = np.where(result.known, result.depth_mm * np.float32(1e-3), np.float32("nan"))
        np.testing.assert_array_equal(floats(depth, *result.shape), wanted)


def test_points_are_in_the_optical_frame(messages, truth):
    clouds = of_topic(messages, "points")
    for message, (_, result) in zip(clouds, truth, strict=True):
        height, width = result.shape
        assert (message.height, message.width) == (height, width)
        assert (message.point_step, message.row_step) == (12, 12 * width)
        fields = [(f.name, f.offset, f.datatype, f.count) for f in message.fields]
        assert fields == [("x", 0, 7, 1), ("y", 4, 7, 1), ("z", 8, 7, 1)]
        assert message.is_dense == bool(result.known.all())
        points = floats(message, height * width, 3)
        known = result.known.ravel()
        np.testing.assert_array_equal(points[known], points_from_result(result)[known] * np.float32(1e-3))
        assert np.isnan(points[~known]).all()
    pressed = floats(clouds[-2], height, width, 3)
    assert pressed[0, -1, 0] > 0 > pressed[0, 0, 0]  # x to the right
    assert pressed[-1, 0, 1] > 0 > pressed[0, 0, 1]  # y down
    assert -6e-4 < np.nanmin(pressed[..., 2]) < -3e-4  # toward the camera, which is at -z; a press of 0.5 mm


def test_a_bag_is_a_source_that_gives_the_same_results(bag, truth, calibration):
    with gelform.stream(bag, calibration) as running:
        again = list(running.pairs())
    assert len(again) == FRAMES
    for seen, (frame, result) in zip(again, truth, strict=True):
        np.testing.assert_array_equal(seen.frame.image, frame.image)
        np.testing.assert_array_equal(seen.result.depth_mm, result.depth_mm)
        assert (seen.frame.index, seen.frame.wall_time_ns) == (frame.index, frame.wall_time_ns)
        assert seen.time_s == pytest.approx(frame.time_s, abs=1e-6)


def test_the_pose_is_as_unsure_as_the_calibration_s_places(recording, calibration, tmp_path, monkeypatch):
    made = []

    class Noted(send.RosMessages):
        def __init__(self, *given):
            super().__init__(*given)
            made.append(given)

    monkeypatch.setattr(send, "RosMessages", Noted)
    known = replace(calibration, serial="S1", settings=replace(calibration.settings, place_error=0.031))
    save_bag(recording, known, tmp_path / "bag", sensor="left", topics=("diagnostics",))
    assert made == [("left", "S1", ("diagnostics",), 0.031)]


def test_what_cannot_become_a_bag_is_said_and_leaves_nothing(recording, calibration, tmp_path):
    for source, cal, error, said in (
        (recording, replace(calibration, mm_per_px=None), CalibrationError, "scale"),
        (tmp_path / "missing.mp4", calibration, DataError, "No video file"),
    ):
        with pytest.raises(error, match=said):
            save_bag(source, cal, tmp_path / "bag")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_results_of_a_recording_are_published(router, recording, calibration):
    got, came = {}, threading.Event()
    subscription = router.session.declare_subscriber(
        "4/left/indentation/**", lambda sample: (got.update({len(got): sample}), came.set())
    )
    with gelform.stream(recording, calibration) as running:
        wanted = [result.depth_mm * np.float32(1e-3) for result in running]
    how = {"topics": ["indentation"], "sensor": "left", "router": router.address, "domain": 4}
    for _ in range(20):  # a subscription takes a moment to spread, and the recording lasts 0.06 s
        stats = publish(recording, calibration, **how)
        if came.wait(0.5):
            break
    subscription.undeclare()
    assert stats.stamped
    assert stats.frames >= 1
    message = typestore().deserialize_cdr(got[0].payload.to_bytes(), "sensor_msgs/msg/Image")
    meters = np.nan_to_num(message.data.view("<f4").reshape(message.height, message.width))
    assert min(np.abs(meters - np.nan_to_num(one)).max() for one in wanted) < 1e-5


def test_what_cannot_be_published_is_said(router, recording, calibration, tmp_path):
    with pytest.raises(CalibrationError, match="scale"):
        publish(recording, replace(calibration, mm_per_px=None), router=router.address)
    with pytest.raises(DataError, match="No video file"):
        publish(tmp_path / "missing.mp4", calibration, router=router.address)


def test_without_rclpy_it_is_named_and_another_middleware_is_refused(recording, calibration, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    with pytest.raises(DataError, match=r"needs rclpy\. Run it where ROS 2 is set up"):
        publish(recording, calibration, middleware="rclpy")
    with pytest.raises(ValueError, match="Expected a middleware among auto, rclpy, zenoh, got 'dds'"):
        publish(recording, calibration, middleware="dds")


IMAGE = "sensor_msgs/msg/Image"
HASH = "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"


def test_keys_tokens_and_attachments_have_the_parts_that_rmw_zenoh_reads():
    key = Node(7, "a1b2", "n").topic_key("/left/image_raw", IMAGE, HASH)
    assert key == f"7/left/image_raw/sensor_msgs::msg::dds_::Image_/{HASH}"
    node = Node(0, "a1b2", "gelform_left")
    assert node.token.split("/") == ["@ros2_lv", "0", "a1b2", "0", "0", "NN", "%", "%", "gelform_left"]
    parts = node.publisher_token(3, "/left/image_raw", IMAGE, HASH).split("/")
    assert parts[:9] == ["@ros2_lv", "0", "a1b2", "0", "3", "MP", "%", "%", "gelform_left"]
    assert parts[9:12] == ["%left%image_raw", dds_type(IMAGE), HASH]
    assert parts[12] == "::,10:,:,:,,"  # rmw_zenoh's default, but for the depth
    gid = gid_from_token("some token")
    made = attachment(1, 2**40, gid)
    assert struct.unpack("<qqB", made[:17]) == (1, 2**40, 16)
    assert made[17:] == gid
    assert len(gid) == 16
    assert gid != gid_from_token("another token")


SHAPE, STAMP_NS = (6, 8), 1_700_000_000_000_000_009
TYPES = {  # as `ros2 topic info --verbose` prints them, Jazzy
    IMAGE: HASH,
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
WAIT_S = 20


@pytest.fixture(scope="module")
def listener(router):
    session = router.opened(mode="client", **{"connect/endpoints": [router.address]})
    yield session
    session.close()


def result_of(depth_mm, shape=SHAPE):
    maps, yes = np.full(shape, depth_mm, np.float32), np.ones(shape, bool)
    return Reconstruction(maps, None, np.zeros((*shape, 2), np.float32), None, maps, yes, yes, 0.1)


def published(node, count):
    """Publish deeper and deeper, two findings alternating; what was published."""
    pairs = []
    for k in range(count):
        frame = Frame(np.full((*SHAPE, 3), k, np.uint8), k / 10, STAMP_NS + k * 10**9, k)
        found = (Finding("torn" if k % 2 else "dust", "Look.", 0.5),)
        pairs.append((frame, replace(result_of(0.1 * k), health=found)))
        node.publish(*pairs[-1], STAMP_NS + k * 10**9)
    return pairs


def subscribed(listener, node):
    """A subscription that the node is known to serve."""
    got, first = queue.Queue(), threading.Event()
    subscription = listener.declare_subscriber(
        f"{node.node.domain}/**", lambda sample: (first.set(), got.put(sample))
    )
    for _ in range(200):  # a subscription takes a moment to spread; the first message that comes proves it
        node.publish(Frame(np.zeros((*SHAPE, 3), np.uint8), 0.0, 1, 0), result_of(0.0), 1)
        if first.wait(0.1):
            break
    return got, subscription


def collected(got, wanted):
    """Samples by topic, those from before the test left out, until so many came."""
    store, found = typestore(), []
    while len(found) < wanted:
        sample = got.get(timeout=WAIT_S)
        kind = next(kind for kind in TYPES if TYPES[kind] in str(sample.key_expr))
        message = store.deserialize_cdr(sample.payload.to_bytes(), kind)
        stamp = message.header.stamp
        if stamp.sec * 10**9 + stamp.nanosec >= STAMP_NS:
            found.append((str(sample.key_expr), sample.attachment.to_bytes(), message))
    return found


@pytest.mark.slow
def test_a_subscriber_gets_every_value(router, listener):
    with ZenohNode("left", router=router.address, domain=3) as node:
        got, subscription = subscribed(listener, node)
        pairs = published(node, 5)
        found = collected(got, 4 * len(pairs))
        subscription.undeclare()
    of = {}
    for key, attached, message in found:
        of.setdefault(key.split("/", 1)[1].rsplit("/", 2)[0], []).append((attached, message))
    assert set(of) == {"left/image_raw", "left/indentation", "left/points", "diagnostics"}
    for name, messages in of.items():
        numbers = [struct.unpack("<q", attached[:8])[0] for attached, _ in messages]
        assert numbers == list(range(numbers[0], numbers[0] + 5)), name
    for (frame, result), (_, image), (_, depth), (_, said) in zip(
        pairs, of["left/image_raw"], of["left/indentation"], of["diagnostics"], strict=True
    ):
        np.testing.assert_array_equal(image.data.reshape(*SHAPE, 3), frame.image)
        np.testing.assert_array_equal(depth.data.view("<f4"), result.depth_mm.ravel() * np.float32(1e-3))
        assert said.status[0].values[0].key == result.health[0].name


def test_nodes_and_topics_are_in_the_graph_while_it_runs(router, listener):
    def tokens():
        return [str(reply.ok.key_expr) for reply in listener.liveliness().get("@ros2_lv/5/**")]

    with ZenohNode("left", router=router.address, domain=5, topics=("image", "points")) as node:
        for _ in range(100):
            if len(found := tokens()) == 3:
                break
        assert sorted(token.split("/")[5] for token in found) == ["MP", "MP", "NN"]
        assert node.node.token in found
        for kind in ("sensor_msgs/msg/Image", "sensor_msgs/msg/PointCloud2"):
            assert any(token.split("/")[11] == TYPES[kind] for token in found if "/MP/" in token)
    for _ in range(100):
        if not tokens():
            break
    assert tokens() == []


def test_what_cannot_be_is_said(router):
    for name, at, domain, error, said in (
        ("left", "tcp/127.0.0.1:1", 0, GelformError, r"No zenoh router answers at tcp/127\.0\.0\.1:1\."),
        ("left", "7447", 0, ValueError, "address of a zenoh router such as tcp/localhost:7447, got '7447'"),
        ("left", router.address, 233, ValueError, "domain from 0 to 232, got 233"),
        ("Left", router.address, 0, ValueError, "name of ROS"),
    ):
        with pytest.raises(error, match=said):
            ZenohNode(name, router=at, domain=domain)


FULL = result_of(1.0, (60, 80))


def frame_of(index):
    return Frame(np.full((60, 80, 3), index, np.uint8), index / 10, START_NS + index * 10**8, index)


def write(bag, count):
    for index in range(count):
        bag.write(frame_of(index), FULL, START_NS + index * 10**8)


def test_it_has_its_name_only_when_it_is_whole(tmp_path):
    with BagFile(tmp_path / "bag", "left") as bag:
        write(bag, 2)
        assert not (tmp_path / "bag").exists()
    assert {path.name for path in tmp_path.rglob("*")} == {"bag", "bag.mcap", "metadata.yaml"}
    with pytest.raises(DataError, match="is there already"):
        BagFile(tmp_path / "bag", "left")


def test_rosbags_reads_metadata_counts_and_qos(tmp_path):
    with BagFile(tmp_path / "bag", "left") as bag:
        write(bag, 12)
    with Reader(tmp_path / "bag") as reader:
        counts = {one.topic: one.msgcount for one in reader.connections}
        assert counts.pop("/diagnostics") == 2
        assert counts.pop("/left/wrench") == 0  # no known loads
        assert counts == {f"/left/{name}": 12 for name in ("image_raw", "indentation", "points")}
        for one in reader.connections:
            (qos,) = one.ext.offered_qos_profiles
            assert (qos.reliability.name, qos.durability.name, qos.depth) == ("RELIABLE", "VOLATILE", 10)
        assert reader.duration == 11 * 10**8 + 1  # rosbags counts the last nanosecond in


def test_diagnostics_come_once_a_second_and_at_each_change(tmp_path):
    torn = replace(FULL, health=(Finding("torn", "Torn.", 0.5),))
    with BagFile(tmp_path / "bag", "left", topics=("image", "diagnostics")) as bag:
        write(bag, 25)
        for index in (25, 26):
            bag.write(frame_of(index), torn, START_NS + index * 10**8)
    with Reader(tmp_path / "bag") as reader:
        taken = [(t - START_NS) // 10**8 for one, t, _ in reader.messages() if one.topic == "/diagnostics"]
    assert taken == [0, 10, 20, 25]


def test_ctrl_c_keeps_what_was_written_and_an_error_nothing(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        _write_and_raise(tmp_path / "kept", KeyboardInterrupt)
    pytest.importorskip("mcap", reason="the extra mcap is not installed")
    assert len(list(open_source(tmp_path / "kept"))) == 3
    for problem in (RuntimeError, FileNotFoundError):  # such as of another file, and no fault of the bag's
        with pytest.raises(problem):
            _write_and_raise(tmp_path / "lost", problem)
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def _write_and_raise(path, problem):
    with BagFile(path, "left") as bag:
        write(bag, 3)
        raise problem


PROGRAM = f"""
import os, resource, signal, sys
sys.path[:0] = {[__file__.rsplit("/", 2)[0], __file__.rsplit("/", 1)[0]]!r}
from test_send import BagFile, write
with BagFile(sys.argv[1], "left") as bag:
    if sys.argv[2] == "full":
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2 * 2**20, 2 * 2**20))
        write(bag, 60)
    write(bag, 30)
    os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals and limits of POSIX")
@pytest.mark.parametrize("fault", ["killed", "full"])
def test_a_process_that_dies_leaves_no_bag_under_its_name(tmp_path, fault):
    command = [sys.executable, "-c", PROGRAM, str(tmp_path / "bag"), fault]
    run = subprocess.run(command, capture_output=True, text=True)
    left = [path.name for path in tmp_path.iterdir()]
    if fault == "killed":
        assert run.returncode == -signal.SIGKILL, run.stderr
        assert left == [f".bag.partial-{left[0].split('-')[1]}"]
    else:
        assert "DataError: Cannot write" in run.stderr, run.stderr
        assert "File too large. Nothing of it was kept." in run.stderr
        assert left == []
