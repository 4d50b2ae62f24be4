"""Names of a sensor in ROS 2: its topics, their types, its coordinate frames."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

ROUTER = "tcp/localhost:7447"  # of zenoh; sessions of rmw_zenoh search there
MIDDLEWARES = ("auto", "rclpy", "zenoh")
MAX_DOMAIN = 232  # largest ROS_DOMAIN_ID of ROS 2


@dataclass(frozen=True)
class Topic:
    """A topic: its name below the sensor's (absolute if it starts with /), the type of its messages, and if it is usual."""

    name: str
    type: str
    usual: bool = True

    def of(self, sensor: str) -> str:
        """Its full name for a sensor."""
        return self.name if self.name.startswith("/") else f"/{sensor}/{self.name}"


# In the order in which they are sent: the last ones of a frame take the longest to make.
TOPICS = {
    "image": Topic("image_raw", "sensor_msgs/msg/Image"),
    "indentation": Topic("indentation", "sensor_msgs/msg/Image"),
    "points": Topic("points", "sensor_msgs/msg/PointCloud2"),
    "wrench": Topic("wrench", "geometry_msgs/msg/WrenchStamped"),
    "pose": Topic("object_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", usual=False),
    "diagnostics": Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    "compressed": Topic("image_raw/compressed", "sensor_msgs/msg/CompressedImage", usual=False),
}
USUAL = tuple(name for name, topic in TOPICS.items() if topic.usual)
NEEDS_SCALE = ("indentation", "points", "pose")
_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")


def check_topics(topics: Iterable[str]) -> tuple[str, ...]:
    """Return names of TOPICS, in the order of the table, each once; ValueError for none or an unknown one."""
    wanted = [topics] if isinstance(topics, str) else list(topics)
    unknown = [one for one in wanted if one not in TOPICS]
    if unknown or not wanted:
        raise ValueError(f"Expected topics among {', '.join(TOPICS)}, got {', '.join(unknown) or 'none'}.")
    return tuple(name for name in TOPICS if name in wanted)


def check_sensor_name(name: str) -> str:
    """Return a name if topics and frames can start with it; else ValueError."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"Expected a name of ROS: small letters, digits and single underscores, a letter first, got {name!r}."
        )
    return name


def sensor_name_from(text: str) -> str:
    """A ROS name from a sensor's usual name: "GelSight Mini" becomes "gelsight_mini"."""
    name = re.sub(r"[^a-z0-9]+", "_", text.lower()).strip("_")
    return name if _NAME.fullmatch(name) else f"sensor_{name}".rstrip("_")
