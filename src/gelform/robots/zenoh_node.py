"""The names of ROS 2 topics and publishers in zenoh, as in rmw_zenoh of Jazzy and later.

Source: the design document of rmw_zenoh (https://github.com/ros2/rmw_zenoh, docs/design.md) and its liveliness tokens.
Humble omits type hashes, so its nodes do not receive these topics.
"""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import blake2b
from itertools import count
from typing import Any

from gelform import Frame, Reconstruction
from gelform.errors import GelformError, needed
from gelform.robots.ros_messages import RosMessages
from gelform.robots.topics import MAX_DOMAIN, ROUTER, TOPICS, USUAL


@dataclass(frozen=True)
class Node:
    """A node of ROS 2 in a zenoh session: ROS_DOMAIN_ID, the session's id in hexadecimal, and the node's name."""

    domain: int
    session: str
    name: str

    @property
    def token(self) -> str:
        """The token that announces the node."""
        return self._token(0, "NN")

    def publisher_token(self, number: int, topic: str, kind: str, type_hash: str) -> str:
        """The token that announces a topic's publisher, numbered from 1; a topic is such as /left/points."""
        # Reliable, volatile, keep the last 10; only differences from rmw_zenoh's default are stated.
        mangled, qos = topic.replace("/", "%"), "::,10:,:,:,,"
        return f"{self._token(number, 'MP')}/{mangled}/{dds_type(kind)}/{type_hash}/{qos}"

    def topic_key(self, topic: str, kind: str, type_hash: str) -> str:
        """The key for a topic's messages."""
        return f"{self.domain}/{topic.strip('/')}/{dds_type(kind)}/{type_hash}"

    def _token(self, number: int, entity: str) -> str:
        # The node's number is 0; "%" is a slash: no enclave, no namespace.
        return f"@ros2_lv/{self.domain}/{self.session}/0/{number}/{entity}/%/%/{self.name}"


def dds_type(kind: str) -> str:
    """The name of a type in DDS: "sensor_msgs/msg/Image" is "sensor_msgs::msg::dds_::Image_"."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def gid_from_token(token: str) -> bytes:
    """16 bytes that identify a publisher."""
    return blake2b(token.encode(), digest_size=16).digest()


def attachment(number: int, sent_ns: int, gid: bytes) -> bytes:
    """The attachment of a message: its number from 1, sending time (UTC, ns), and the publisher's gid."""
    return struct.pack("<qqB", number, sent_ns, len(gid)) + gid


class ZenohNode:
    """Publishes frames and results as ROS 2 topics; a context manager.

    Messages for a subscriber that is too slow are dropped, because only the newest matters.

    Parameters
    ----------
    sensor : a ROS name, the prefix of topics; the node is `gelform_<sensor>`
    topics : names of TOPICS to publish
    router : address of the zenoh router, such as "tcp/localhost:7447"
    domain : the subscribers' ROS_DOMAIN_ID
    hardware_id : of the diagnostics, such as the serial number

    Raises
    ------
    GelformError
        No router answers at the address.
    DataError
        The extra `ros` is not installed.
    ValueError
        The sensor is no ROS name, a topic is unknown, or the domain or the address is invalid.
    """

    def __init__(
        self,
        sensor: str,
        *,
        topics: tuple[str, ...] = USUAL,
        router: str = ROUTER,
        domain: int = 0,
        hardware_id: str = "",
    ) -> None:
        if not 0 <= domain <= MAX_DOMAIN:
            raise ValueError(f"Expected a ROS domain from 0 to {MAX_DOMAIN}, got {domain}.")
        for module in ("zenoh", "rosbags.typesys"):
            needed(module, "ros", "Publishing for ROS 2")
        self._messages = RosMessages(sensor, hardware_id, topics)
        self._session = _session(router)
        self.node = Node(domain, str(self._session.zid()), f"gelform_{sensor}")
        declare = self._session.liveliness().declare_token
        self._tokens, self._put = [declare(self.node.token)], {}
        for number, name in enumerate(self._messages.topics, 1):
            topic = TOPICS[name]
            names = topic.of(sensor), topic.type, self._messages.store.hash_rihs01(topic.type)
            token = self.node.publisher_token(number, *names)
            self._tokens.append(declare(token))
            self._put[name] = _publisher(self._session, self.node.topic_key(*names), gid_from_token(token))

    def publish(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> None:
        """Send a frame and its result to the subscribers.

        Parameters
        ----------
        frame : from the camera
        result : of the frame, in mm if indentation or points are published
        stamp_ns : capture time, UTC, ns
        """
        for name, message in self._messages.due(frame, result, stamp_ns):
            self._put[name](bytes(message))

    def close(self) -> None:
        """Leave the network."""
        self._session.close()

    def __enter__(self) -> ZenohNode:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _publisher(session: Any, key: str, gid: bytes) -> Callable[[bytes], None]:
    """The function that publishes messages of one topic, which are numbered."""
    import zenoh

    publisher = session.declare_publisher(key, congestion_control=zenoh.CongestionControl.DROP)
    numbers = count(1)
    return lambda message: publisher.put(message, attachment=attachment(next(numbers), time.time_ns(), gid))


def _session(router: str) -> Any:
    """A session with rmw_zenoh's settings: it finds its peers through the router and sends to them directly."""
    import zenoh

    config = zenoh.Config()
    settings: dict[str, Any] = {
        "mode": "peer",
        "connect/timeout_ms": 3000,  # until a router that does not answer is an error
        "connect/exit_on_failure": True,
        "listen/endpoints": ["tcp/localhost:0"],
        "scouting/multicast/enabled": False,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        config.insert_json5("connect/endpoints", json.dumps([router]))
    except zenoh.ZError as problem:
        raise ValueError(
            f"Expected the address of a zenoh router such as {ROUTER}, got {router!r}."
        ) from problem
    try:
        return zenoh.open(config)
    except zenoh.ZError as problem:
        raise GelformError(
            f"No zenoh router answers at {router}. Start one, with ROS by `ros2 run rmw_zenoh_cpp rmw_zenohd`, without by "
            "`zenohd`, or give its address by --router."
        ) from problem
