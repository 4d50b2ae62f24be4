"""zenoh: a router, a publisher and a subscriber in three processes, as in a ROS 2 with rmw_zenoh; ages and rates.

The age of a message counts from just before the publisher starts to make the frame's messages, until the subscriber
has decoded it. Type hashes are compared with those of ROS (`ros2 topic info --verbose`; the message packages' JSON files).
"""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

HZ = 60
PUBLISHED_HASHES = {
    "sensor_msgs/msg/Image": "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
    "sensor_msgs/msg/PointCloud2": "RIHS01_9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
}
NO_POINTS = "image,indentation,diagnostics"
WARMING = 30  # frames before counting starts


def measure(quick: bool) -> dict[str, Any]:
    """Rates and ages with and without points, and the number of type hashes equal to those of ROS."""
    seconds = 2 if quick else 10
    return {
        "all_topics": through("image,indentation,points,diagnostics", seconds),
        "without_points": through(NO_POINTS, seconds),
        "hashes_equal": _hashes_equal(),
    }


def rows(figures: dict[str, Any]) -> list[tuple[str, Any, Any]]:
    """(figure, required, measured)."""
    whole, fewer, hashes = figures["all_topics"], figures["without_points"], figures["hashes_equal"]
    return [
        ("zenoh, without points: frames a second", HZ, fewer["rate_hz"]),
        (
            "zenoh, without points: age of indentation, ms, median",
            3,
            fewer["age_ms"]["indentation"]["median"],
        ),
        ("zenoh, all topics: frames a second", HZ, whole["rate_hz"]),
        ("zenoh, all topics: age of indentation, ms, median", 3, whole["age_ms"]["indentation"]["median"]),
        ("zenoh, all topics: age of points, ms, median", "-", whole["age_ms"]["points"]["median"]),
        ("type hashes equal to those of ROS", len(PUBLISHED_HASHES), hashes),
    ]


def through(topics: str, seconds: float) -> dict[str, Any]:
    """The figures of a subscriber over that many seconds at 60 Hz."""
    address, count = f"tcp/127.0.0.1:{_free_port()}", round(seconds * HZ)
    with _beside("route", address) as router:
        assert router.stdout is not None
        assert router.stdout.readline(), "the router did not start"
        listener = Listener(address)
        with _beside("publish", address, topics, str(count + WARMING)) as publisher:
            publisher.wait(120)
        time.sleep(0.5)
        listener.close()
        router.terminate()
    return {
        "frames_published": count,
        "frames_received": len(listener.ages_ms["indentation"]),
        "rate_hz": (len(listener.times_s) - 1) / (listener.times_s[-1] - listener.times_s[0]),
        "age_ms": {
            name: {"median": median(ages), "95%": float(np.percentile(ages, 95))}
            for name, ages in listener.ages_ms.items()
        },
        "load_average": os.getloadavg()[0],
    }


class Listener:
    """Decodes the published messages; records ages in ms of each topic, and arrival times of indentation."""

    def __init__(self, address: str) -> None:
        from gelform.sensors.mcap import typestore

        self._store = typestore()
        self.ages_ms: dict[str, list[float]] = defaultdict(list)
        self.times_s: list[float] = []
        self._session = _session("peer", connect=address)
        self._subscription = self._session.declare_subscriber("0/gel/**", self._take)
        time.sleep(0.5)

    def close(self) -> None:
        """Stop."""
        self._session.close()

    def _take(self, sample: Any) -> None:
        *_, name, kind, _ = str(sample.key_expr).split("/")
        message = self._store.deserialize_cdr(sample.payload.to_bytes(), _ros_type(kind))
        stamp = message.header.stamp
        age_ms = (time.time_ns() - stamp.sec * 10**9 - stamp.nanosec) / 1e6
        if int.from_bytes(sample.attachment.to_bytes()[:8], "little") > WARMING:
            self.ages_ms[name].append(age_ms)
            if name == "indentation":
                self.times_s.append(time.perf_counter())


def publish(address: str, topics: str, count: str) -> None:
    """Publish prepared results at 60 Hz, in a separate process."""
    from gelform.robots.send import ZenohNode
    from gelform.sensors.playback import Pace
    from robots.bag import frames_and_results, reconstructor

    pairs = frames_and_results(reconstructor())
    with ZenohNode("gel", topics=tuple(topics.split(",")), router=address) as node:
        time.sleep(1)  # the router announces the node to the subscriber
        pace = Pace(HZ)
        for k in range(int(count)):
            pace.wait_for(k)
            node.publish(*pairs[k % len(pairs)], time.time_ns())
        time.sleep(0.5)


def route(address: str) -> None:
    """Run a router until it is ended, in a separate process."""
    session = _session("router", listen=address)
    print("ready", flush=True)
    while True:
        time.sleep(60)
        assert session


def _session(mode: str, **endpoints: str) -> Any:
    import zenoh

    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5("scouting/multicast/enabled", "false")
    for name, address in endpoints.items():
        config.insert_json5(f"{name}/endpoints", json.dumps([address]))
    return zenoh.open(config)


def _beside(*arguments: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "robots.zenoh_link", *arguments]
    return subprocess.Popen(command, cwd=Path(__file__).parents[1], stdout=subprocess.PIPE, text=True)


def _ros_type(kind: str) -> str:
    """ "sensor_msgs::msg::dds_::Image_" is "sensor_msgs/msg/Image"."""
    return kind.replace("dds_::", "").replace("::", "/").removesuffix("_")


def _hashes_equal() -> int:
    from gelform.sensors.mcap import typestore

    store = typestore()
    return sum(store.hash_rihs01(kind) == known for kind, known in PUBLISHED_HASHES.items())


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        return int(one.getsockname()[1])


if __name__ == "__main__":
    {"publish": publish, "route": route}[sys.argv[1]](*sys.argv[2:])
