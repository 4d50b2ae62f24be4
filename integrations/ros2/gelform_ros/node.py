"""A source through a calibration to topics of ROS 2, by rclpy."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from threading import Event, Thread
from typing import Any

import cv2
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.duration import Duration
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.task import Future
from sensor_msgs.msg import CompressedImage, Image, PointCloud2
from std_srvs.srv import Trigger

import gelform
from gelform.robots.ros_messages import RosMessages
from gelform.robots.send import heard_of
from gelform.robots.topics import TOPICS, USUAL, sensor_name_from
from gelform.sensors import read_background
from gelform.sensors.playback import Every
from gelform.sensors.streams.memory import LOOK_S
from gelform_ros import interruptible

TYPES = {
    "sensor_msgs/msg/Image": Image,
    "sensor_msgs/msg/CompressedImage": CompressedImage,
    "sensor_msgs/msg/PointCloud2": PointCloud2,
    "geometry_msgs/msg/WrenchStamped": WrenchStamped,
    "diagnostic_msgs/msg/DiagnosticArray": DiagnosticArray,
    "geometry_msgs/msg/PoseWithCovarianceStamped": PoseWithCovarianceStamped,
}
QUEUE = 10
SILENT_S = 1.0  # without a frame, until diagnostics say so; they repeat as often
BACKGROUND_S = 3.0  # longest wait for the second of frames that makes a background
OF_ROS = (rclpy_implementation.RCLError, rclpy_implementation.InvalidHandle)
LOG = "gelform_ros"  # not the node's own, which needs the context to the end
MISTAKES = (gelform.GelformError, ValueError, TypeError, ParameterException)


class GelformNode(Node):
    """Publishes the newest results of a stream until the source ends or the node is closed."""

    def __init__(self) -> None:
        super().__init__("gelform")
        calibration, self._source, name, topics, background, camera_frame, gel_frame = (
            # Text also where it looks like a number: `-p source:=0`, or a serial number of digits.
            str(self._parameter(key, default, dynamic_typing=True))
            for key, default in (
                ("calibration", ""),
                ("source", "simulated"),
                ("name", ""),
                ("topics", ",".join(USUAL)),
                ("background", ""),
                ("camera_frame", ""),
                ("gel_frame", ""),
            )
        )
        rate_hz = self._parameter("rate", 0.0, dynamic_typing=True)  # 30 as well as 30.0
        depth_only = self._parameter("depth_only", False)
        if isinstance(rate_hz, (bool, str)) or not 0 <= rate_hz < float("inf"):
            raise ValueError(f"Expected `rate` in results a second, or 0 for all of them, got {rate_hz!r}.")
        if not calibration:
            raise ValueError("Expected the path of a calibration in the parameter `calibration`, got none.")
        loaded = gelform.load_calibration(calibration)
        if depth_only:
            topics = "indentation,diagnostics"
        self._due = Every(1 / rate_hz if rate_hz else 0.0)
        self._messages = RosMessages(
            name or sensor_name_from(loaded.sensor_name),
            loaded.serial or "",
            topics.split(","),
            loaded.settings.place_error,
            SILENT_S if depth_only else LOOK_S,
        )
        if {"indentation", "points", "pose"} & set(self._messages.topics):
            _ = loaded.known_mm_per_px
        self._messages.camera_frame = camera_frame or self._messages.camera_frame
        self._messages.gel_frame = gel_frame or self._messages.gel_frame
        rest = None
        if background:
            rest = gelform.image_from_frame(read_background(Path(background)), loaded.view)
        self._to = {
            topic: self.create_publisher(
                TYPES[TOPICS[topic].type], TOPICS[topic].of(self._messages.sensor), QUEUE
            )
            for topic in self._messages.topics
        }
        self._stream = gelform.stream(
            lambda: gelform.open_source(self._source, paced=True), loaded, background=rest
        )
        self.frames, self.status = 0, 0
        self._stop, self.ended = Event(), Future()
        self.create_service(Trigger, "~/take_background", self._take_background)
        self.create_service(Trigger, "~/reset_pose", self._reset_pose)
        self._thread = Thread(target=self._publish_all, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Give the sensor back, and stop publishing."""
        self._stop.set()
        self._stream.close()
        self._thread.join(2 * SILENT_S)

    def _parameter(self, name: str, default: Any, **how: Any) -> Any:
        return self.declare_parameter(name, default, ParameterDescriptor(**how)).value

    def _take_background(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        try:
            found = self._stream.take_background(BACKGROUND_S)
        except gelform.StaleError as problem:
            answer.success, answer.message = False, one_line(problem)
        else:
            answer.success = all(one.name != "background_refused" for one in found)
            answer.message = one_line(" ".join(one.message for one in found) or "The background was taken.")
        return answer

    def _reset_pose(self, _: Trigger.Request, answer: Trigger.Response) -> Trigger.Response:
        answer.success = "pose" in self._messages.topics
        if answer.success:
            self._messages.reset_pose()
            answer.message = "The next contact is the origin."
        else:
            answer.message = "No pose is published: name `pose` in the parameter `topics`."
        return answer

    def _send(self, topic: str, message: memoryview) -> None:
        self._to[topic].publish(bytes(message))  # rclpy publishes bytes as they are: CDR

    def _publish_all(self) -> None:
        """Publish until the end; then the node ends too, with the status 1 after an error."""
        try:
            self._publish_results()
        except (*MISTAKES, *OF_ROS) as problem:
            # After Ctrl-C or a shutdown from outside, between two messages, nothing can be published.
            if self.context.ok() or not isinstance(problem, OF_ROS):
                self.status = 1
                get_logger(LOG).fatal(f"{self._source}: {one_line(problem)}")
        self.ended.set_result(self.status)

    def _publish_results(self) -> None:
        index, start = -1, (0, 0.0)
        while not self._stop.is_set():
            one = self._stream.newest(index, SILENT_S)
            if one is None:
                stats = self._stream.stats
                if stats.state == "closed":
                    return
                if stats.state == "ended":
                    for publisher in self._to.values():
                        publisher.wait_for_all_acked(Duration(seconds=SILENT_S))
                    return
                if "diagnostics" in self._to:
                    why = stats.reason or "no frame came"
                    self._send("diagnostics", self._messages.silence(stats.state, why, time.time_ns()))
                continue
            start = start if self.frames else (time.time_ns(), one.time_s)
            index = one.index
            if not self._due(one.time_s):
                continue
            # A video has no times of capture: its frames are as far from the first as the source says.
            stamp_ns = one.frame.wall_time_ns or start[0] + round((one.time_s - start[1]) * 1e9)
            self.frames += 1
            heard = heard_of(self._to)
            for topic, message in self._messages.due(one.frame, one.result, stamp_ns, heard.__contains__):
                self._send(topic, message)


def one_line(problem: object) -> str:
    """The text of an error as one line."""
    return " ".join(str(problem).split())


def run(arguments: Any = None) -> int:
    """Run the node until it is interrupted or its source ends; 1 after an error, which is logged as one line."""
    log, node = get_logger(LOG), None
    cv2.setNumThreads(1)  # every stage of a stream has a thread
    try:
        rclpy.init(args=arguments)
    except KeyboardInterrupt:
        return 0
    except OF_ROS as problem:
        log.fatal(one_line(problem))
        return 1
    try:
        node = GelformNode()
        rclpy.spin_until_future_complete(node, node.ended)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (*MISTAKES, *OF_ROS) as problem:
        if rclpy.ok():  # else it is shut down, and that is why
            log.fatal(one_line(problem))
            rclpy.try_shutdown()
            return 1
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # `ros2 launch` and the terminal may both send it
    if node is not None:
        node.close()
    rclpy.try_shutdown()
    status, frames = (0, 0) if node is None else (node.status, node.frames)
    if not status:
        log.info(f"Ended after {frames} frames.")
    return status


def main(arguments: Any = None) -> None:
    """Run the node, and end with its status."""
    raise SystemExit(run(arguments))


interruptible(early=False)
if __name__ == "__main__":
    main()
