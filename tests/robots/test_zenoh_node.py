"""Keys and tokens equal rmw_zenoh's; a node, a router and a subscriber talk over zenoh's own sockets."""

import queue
import struct
import threading
from dataclasses import replace

import numpy as np
import pytest

from gelform import Frame, GelformError, Reconstruction
from gelform.errors import Finding
from gelform.robots.zenoh_node import Node, ZenohNode, attachment, dds_type, gid_from_token
from gelform.sensors.mcap import typestore

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


def result_of(depth_mm):
    maps, yes = np.full(SHAPE, depth_mm, np.float32), np.ones(SHAPE, bool)
    return Reconstruction(maps, None, np.zeros((*SHAPE, 2), np.float32), None, maps, yes, yes, 0.1)


def published(node, count):
    """Publish deeper and deeper, two findings alternating; what was published."""
    pairs = []
    for k in range(count):
        frame = Frame(np.full((*SHAPE, 3), k, np.uint8), k / 10, STAMP_NS + k, k)
        found = (Finding("torn" if k % 2 else "dust", "Look.", 0.5),)
        pairs.append((frame, replace(result_of(0.1 * k), health=found)))
        node.publish(*pairs[-1], STAMP_NS + k)
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
