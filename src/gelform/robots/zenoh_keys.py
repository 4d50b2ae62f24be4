"""What ROS 2 calls its topics and publishers in zenoh, as rmw_zenoh of Jazzy and later has it.

Source: the design document of rmw_zenoh (https://github.com/ros2/rmw_zenoh, docs/design.md) and its liveliness tokens.
Humble leaves type hashes out: its nodes do not see these topics.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from hashlib import blake2b

GRAPH = "@ros2_lv"  # where tokens are that say which nodes and publishers there are
NO_NAMESPACE = NO_ENCLAVE = "%"  # a slash, which stands for a level in zenoh
NODE, NODE_ID = "NN", 0
PUBLISHER = "MP"
QOS = "::,10:,:,:,,"  # reliable, volatile, keep the last 10: what differs from rmw_zenoh's default is said
GID_BYTES = 16


@dataclass(frozen=True)
class Node:
    """A node of ROS 2 in a zenoh session.

    Parameters
    ----------
    domain : the number ROS_DOMAIN_ID
    session : the session's id, hexadecimal
    name : of the node
    """

    domain: int
    session: str
    name: str

    @property
    def token(self) -> str:
        """What says that there is such a node."""
        return self._token(NODE_ID, NODE)

    def publisher_token(self, number: int, topic: str, kind: str, type_hash: str) -> str:
        """What says that the node publishes a topic.

        Parameters
        ----------
        number : of the publisher in the node, from 1
        topic : its whole name, such as "/left/points"
        kind : the type of its messages, such as "sensor_msgs/msg/Image"
        type_hash : of that type, "RIHS01_..."
        """
        mangled = topic.replace("/", "%")
        return f"{self._token(number, PUBLISHER)}/{mangled}/{dds_type(kind)}/{type_hash}/{QOS}"

    def topic_key(self, topic: str, kind: str, type_hash: str) -> str:
        """The key that messages of a topic are put to."""
        return f"{self.domain}/{topic.strip('/')}/{dds_type(kind)}/{type_hash}"

    def _token(self, number: int, entity: str) -> str:
        where = f"{GRAPH}/{self.domain}/{self.session}/{NODE_ID}/{number}/{entity}"
        return f"{where}/{NO_ENCLAVE}/{NO_NAMESPACE}/{self.name}"


def dds_type(kind: str) -> str:
    """The name of a type in DDS: "sensor_msgs/msg/Image" is "sensor_msgs::msg::dds_::Image_"."""
    package, _, name = kind.split("/")
    return f"{package}::msg::dds_::{name}_"


def gid_from_token(token: str) -> bytes:
    """16 bytes that tell a publisher from others."""
    return blake2b(token.encode(), digest_size=GID_BYTES).digest()


def attachment(number: int, sent_ns: int, gid: bytes) -> bytes:
    """What goes with each message: its number from 1, when it was sent (UTC, ns), the publisher's gid."""
    return struct.pack("<qqB", number, sent_ns, len(gid)) + gid
