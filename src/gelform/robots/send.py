"""Results of a source for ROS 2: into a bag, complete or not at all, or live by rclpy or over zenoh (experimental).

The names of topics and publishers in zenoh are as in rmw_zenoh of Jazzy and later. Source: the design document of rmw_zenoh
(https://github.com/ros2/rmw_zenoh, docs/design.md) and its liveliness tokens. Humble omits type hashes, so its nodes do not
receive these topics.
"""

from __future__ import annotations

import json
import os
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from hashlib import blake2b
from importlib import import_module
from importlib.util import find_spec
from itertools import count
from os import PathLike
from typing import Any

from numpy.typing import ArrayLike

from gelform import DataError, Frame, Reconstruction, Stream, open_source, stream
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import FrameTally, GelformError, Progress, cannot, needed, no_progress
from gelform.exchange.exporters.press_folder import written_whole
from gelform.foundations.checks import check_path, check_positive
from gelform.robots.ros_messages import RosMessages
from gelform.robots.topics import (
    MAX_DOMAIN,
    MIDDLEWARES,
    NEEDS_SCALE,
    ROUTER,
    TOPICS,
    USUAL,
    check_topics,
    sensor_name_from,
)
from gelform.sensors.playback import Closing, Every
from gelform.sensors.streams.memory import LOOK_S, StreamFrame


class BagFile:
    """A rosbag2 folder (metadata.yaml and one MCAP file), written frame by frame; a context manager.

    The folder gets its name at the end of the context. An exception discards it, except an interrupt (Ctrl-C), which keeps
    the frames written so far.

    Parameters
    ----------
    path : a new folder
    sensor : a ROS name, the prefix of topics and coordinate frames
    topics : names of TOPICS to write
    hardware_id : of the diagnostics, such as the serial number
    place_error : of the calibration, for the covariance of the pose; None: that of a Mini

    Raises
    ------
    DataError
        The path exists, or the extra `ros` is not installed; or the path cannot be written, also at the end of the context.
    ValueError
        The sensor is no ROS name, or a topic is unknown.
    """

    def __init__(
        self,
        path: str | PathLike[str],
        sensor: str,
        *,
        topics: tuple[str, ...] = USUAL,
        hardware_id: str = "",
        place_error: float | None = None,
    ) -> None:
        self.path = check_path(path)
        self._messages = RosMessages(sensor, hardware_id, topics, place_error)
        from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
        from rosbags.rosbag2 import StoragePlugin, Writer  # of the extra, which the messages needed

        if os.path.lexists(self.path):
            raise DataError(f"{self.path} is there already. Choose another name, or remove it.")
        # Reliable, volatile, keep the last ten, as publishers of `ros2 bag play` do by default: a player with these settings
        # serves subscribers of either reliability.
        unlimited = QosTime(9223372036, 854775807)  # rosbag2's value for no limit
        kept, reliable, volatile = QosHistory.KEEP_LAST, QosReliability.RELIABLE, QosDurability.VOLATILE
        lives = QosLiveliness.AUTOMATIC
        offered = Qos(kept, 10, reliable, volatile, unlimited, unlimited, lives, unlimited, False)
        with ExitStack() as opened:
            self._folder = opened.enter_context(written_whole(self.path))
            # Version 9 is that of Jazzy and later; Humble plays the .mcap inside.
            inside = self._folder / self.path.name  # which names the .mcap
            self._writer = Writer(inside, version=9, storage_plugin=StoragePlugin.MCAP)
            self._writer.open()
            how = {"typestore": self._messages.store, "offered_qos_profiles": [offered]}
            self._connections = {
                name: self._writer.add_connection(TOPICS[name].of(sensor), TOPICS[name].type, **how)
                for name in self._messages.topics
            }
            self._open = opened.pop_all()

    def write(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> None:
        """Add a frame and its result.

        Parameters
        ----------
        frame : from the camera
        result : of the frame, in mm if indentation or points are written
        stamp_ns : capture time, UTC, ns

        Raises
        ------
        DataError
            The disk is full; nothing is kept.
        """
        with cannot(f"write {self.path}", "Nothing of it was kept."):
            for name, message in self._messages.due(frame, result, stamp_ns):
                self._writer.write(self._connections[name], stamp_ns, message)

    def __enter__(self) -> BagFile:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with suppress(GeneratorExit), self._open:
            if kind is not None and not issubclass(kind, KeyboardInterrupt):
                with suppress(OSError):  # on a full disk, what is still to be written does not fit either
                    self._writer.abort()
                raise GeneratorExit  # discards the folder; the exception of the context may be an OSError of another file
            self._writer.close()
            inside = self._folder / self.path.name
            for path in inside.iterdir():
                path.rename(self._folder / path.name)
            inside.rmdir()


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


class ZenohNode(Closing):
    """Publishes frames and results as ROS 2 topics; a context manager.

    Messages for a subscriber that is too slow are dropped, because only the newest matters.

    Parameters
    ----------
    sensor : a ROS name, the prefix of topics; the node is `gelform_<sensor>`
    topics : names of TOPICS to publish
    router : address of the zenoh router, such as "tcp/localhost:7447"
    domain : the subscribers' ROS_DOMAIN_ID
    hardware_id : of the diagnostics, such as the serial number
    place_error : of the calibration, for the covariance of the pose; None: that of a Mini

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
        place_error: float | None = None,
    ) -> None:
        if not 0 <= domain <= MAX_DOMAIN:
            raise ValueError(f"Expected a ROS domain from 0 to {MAX_DOMAIN}, got {domain}.")
        for module in ("zenoh", "rosbags.typesys"):
            needed(module, "ros", "Publishing for ROS 2")
        self._messages = RosMessages(sensor, hardware_id, topics, place_error, LOOK_S)
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


class RclpyNode:
    """Publishes frames and results as ROS 2 topics by rclpy, with any of its middlewares; a context manager.

    Raises
    ------
    DataError
        rclpy, a message package or the extra `ros` is not installed.
    ValueError
        The sensor is no ROS name, or a topic is unknown.
    """

    def __init__(
        self,
        sensor: str,
        *,
        topics: tuple[str, ...] = USUAL,
        domain: int = 0,
        hardware_id: str = "",
        place_error: float | None = None,
    ) -> None:
        self._messages = RosMessages(sensor, hardware_id, topics, place_error, LOOK_S)
        kinds = {name: TOPICS[name].type.split("/msg/") for name in self._messages.topics}
        try:
            import rclpy

            types = {name: getattr(import_module(f"{of}.msg"), kind) for name, (of, kind) in kinds.items()}
        except ModuleNotFoundError as problem:
            raise DataError(
                f"Publishing by rclpy needs {problem.name}. Run it where ROS 2 is set up, install ROS's Python packages "
                "(ros-rclpy and those of docs/ros.md), or take --middleware zenoh."
            ) from problem
        self._context = rclpy.Context()  # not the default one, so that rclpy leaves Ctrl-C to Python
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node(f"gelform_{sensor}", context=self._context)
        self._to = {
            name: self._node.create_publisher(types[name], TOPICS[name].of(sensor), 10) for name in types
        }

    def publish(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> None:
        """As `ZenohNode.publish`; topics without a subscriber cost nothing."""
        heard = heard_of(self._to)
        for name, message in self._messages.due(frame, result, stamp_ns, heard.__contains__):
            self._to[name].publish(bytes(message))  # rclpy publishes bytes as they are: CDR

    def __enter__(self) -> RclpyNode:
        return self

    def __exit__(self, *_: object) -> None:
        self._node.destroy_node()
        self._context.try_shutdown()


def heard_of(publishers: Mapping[str, Any]) -> set[str]:
    """The topics of rclpy's publishers that have a subscriber."""
    return {name for name, publisher in publishers.items() if publisher.get_subscription_count()}


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


@dataclass(frozen=True)
class SentStats:
    """Figures of a bag or of a publication.

    Attributes
    ----------
    sensor : prefix of its topics
    frames, duration_s : number of frames, and s from the first to the last
    drops : frames of the source without a result
    stamped : whether frames had capture times; else stamps start at the time of sending the first frame
    tally : findings of the frames, of live ones eight a second
    problem : the findings of the last frame as text, if depth was known in no pixel of any frame; else ""
    """

    sensor: str
    frames: int
    duration_s: float
    drops: int
    stamped: bool
    tally: FrameTally
    problem: str = ""


def results_of(running: Stream, source: object, use: str) -> Iterator[StreamFrame]:
    """The results of a running stream with their frames; `source` is the user's name for it, `use` a verb, for messages.

    DataError: the source gives no frame, or frames of another size than calibrated.
    """
    one = None
    try:
        for one in running.pairs():
            yield one
    except (ValueError, TypeError) as problem:
        raise DataError(f"{source}: {problem}") from problem
    if one is None:
        raise DataError(f"No frame arrived from {source}: there is nothing to {use}.")


def send_results(
    running: Stream,
    source: object,
    sensor: str,
    send: Callable[[Frame, Reconstruction, int], None],
    seconds: float | None = None,
    progress: Progress = no_progress,
    doing: str = "sending frames",
    look_s: float = 0.0,
) -> SentStats:
    """Send each result of a source, with its frame and its stamp (capture time, UTC, ns); return the figures.

    It ends after `seconds` by the frames' times, and at an interrupt (Ctrl-C), the usual end with a camera. `progress` gets
    the number of frames so far, and `doing`. The tally has a frame every `look_s`, s; 0: each. Raises the errors of
    `results_of`.
    """
    stamped, start_ns, first_s, last_s, frames = True, 0, 0.0, 0.0, 0
    looks = Every(look_s)
    tally, problem = FrameTally(), ""
    try:
        for one in results_of(running, source, "send"):
            frame, time_s = one.frame, one.time_s
            if not start_ns:
                start_ns, first_s, last_s = time.time_ns(), time_s, time_s
                stamped = frame.wall_time_ns > 0
            if seconds is not None and time_s - first_s >= seconds:
                break
            last_s = time_s
            # Frames without a capture time are as far from the first as the source says.
            later_ns = start_ns + round((time_s - first_s) * 1e9)
            send(frame, one.result, frame.wall_time_ns if stamped else later_ns)
            frames += 1
            if looks(time_s):
                health = one.result.health
                tally.add((finding.name for finding in health), known=bool(one.result.known.any()))
                problem = " ".join(finding.message for finding in health)
            progress(frames, frames, doing)
    except KeyboardInterrupt:
        pass
    problem = problem if tally.is_useless else ""
    return SentStats(sensor, frames, last_s - first_s, running.stats.drops, stamped, tally, problem)


def save_bag(
    source: str | PathLike[str],
    calibration: Calibration | str | PathLike[str],
    path: str | PathLike[str],
    *,
    topics: Iterable[str] = USUAL,
    sensor: str | None = None,
    seconds: float | None = None,
    background: ArrayLike | None = None,
    bgr: bool = False,
    dataset: str = "",
    progress: Progress = no_progress,
) -> SentStats:
    """Reconstruct the frames of a source, and write frames and results as a rosbag2 folder.

    A recording, a video or a folder gives every frame; a camera gives the newest ones, for `seconds`. An interrupt (Ctrl-C)
    ends the bag normally.

    Parameters
    ----------
    source : argument of `open_source`
    calibration : of the sensor, or the path of its file
    path : a new folder
    topics : names of TOPICS; `pose` only if it is named
    sensor : a ROS name, the prefix of topics and frames; by default made from the calibration's sensor name
    seconds : duration; None: no limit
    background : (H, W, 3), 0-255, a current background image; by default the calibration's own
    bgr, dataset : as in `open_source`
    progress : called with the number of frames so far

    Raises
    ------
    SensorError, DataError
        The source cannot be opened, or gives no frame or frames of another size; the path exists or cannot be written; the
        extra `ros` is not installed.
    CalibrationError
        The calibration cannot be read or is of another sensor; or it has no scale, which indentation and points need.
    ValueError
        A topic is unknown, the sensor is no ROS name, or `seconds` is no time.
    """
    calibration, topics, name = _checked(calibration, topics, sensor, seconds)
    with (
        BagFile(path, name, topics=topics, **_of_unit(calibration)) as bag,
        stream(
            lambda: open_source(source, bgr=bgr, dataset=dataset), calibration, background=background
        ) as running,
    ):
        return send_results(running, source, name, bag.write, seconds, progress, "writing frames")


def publish(
    source: str | PathLike[str],
    calibration: Calibration | str | PathLike[str],
    *,
    topics: Iterable[str] = USUAL,
    sensor: str | None = None,
    router: str = ROUTER,
    domain: int = 0,
    middleware: str = "auto",
    seconds: float | None = None,
    background: ArrayLike | None = None,
    bgr: bool = False,
    dataset: str = "",
    progress: Progress = no_progress,
) -> SentStats:
    """Reconstruct the frames of a source, and publish the newest results as ROS 2 topics until it ends.

    By rclpy every node receives them, by zenoh those with the middleware rmw_zenoh (Jazzy and later). Recordings, videos and
    folders play at their own pace. An interrupt (Ctrl-C) ends it normally; see `save_bag` for the arguments and errors that
    are not here.

    Parameters
    ----------
    router : address of the zenoh router
    domain : the subscribers' ROS_DOMAIN_ID
    middleware : "rclpy", "zenoh", or "auto": rclpy where it is installed and no other router is named, else zenoh

    Raises
    ------
    GelformError
        No router answers.
    DataError
        rclpy was asked for, and is not installed.
    ValueError
        The domain, the address or the middleware is invalid.
    """
    if middleware not in MIDDLEWARES:
        raise ValueError(f"Expected a middleware among {', '.join(MIDDLEWARES)}, got {middleware!r}.")
    if middleware == "auto":
        middleware = "rclpy" if router == ROUTER and find_spec("rclpy") is not None else "zenoh"
    calibration, topics, name = _checked(calibration, topics, sensor, seconds)
    how: Any = {"topics": topics, "domain": domain, **_of_unit(calibration)}
    with (
        RclpyNode(name, **how) if middleware == "rclpy" else ZenohNode(name, router=router, **how) as node,
        stream(
            lambda: open_source(source, paced=True, bgr=bgr, dataset=dataset),
            calibration,
            background=background,
        ) as running,
    ):
        return send_results(
            running, source, name, node.publish, seconds, progress, "publishing frames", LOOK_S
        )


def _of_unit(calibration: Calibration) -> dict[str, Any]:
    return {"hardware_id": calibration.serial or "", "place_error": calibration.settings.place_error}


def _checked(
    calibration: Calibration | str | PathLike[str],
    topics: Iterable[str],
    sensor: str | None,
    seconds: float | None,
) -> tuple[Calibration, tuple[str, ...], str]:
    """The parts of a calibration to send: the topics, and the sensor's ROS name."""
    calibration, topics = as_calibration(calibration), check_topics(topics)
    if set(topics) & set(NEEDS_SCALE):
        _ = calibration.known_mm_per_px
    if seconds is not None:
        check_positive(seconds, "seconds")
    return calibration, topics, sensor_name_from(calibration.sensor_name) if sensor is None else sensor
