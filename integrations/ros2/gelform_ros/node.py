"""A source through a calibration to topics of ROS 2, by rclpy. Not run by us yet."""

from __future__ import annotations

from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, WrenchStamped
from rclpy.node import Node
from sensor_msgs.msg import Image, PointCloud2

import gelform
from gelform.robots.ros_messages import RosMessages
from gelform.robots.send import send_results
from gelform.robots.topics import TOPICS, USUAL, sensor_name_from

TYPES = {
    "sensor_msgs/msg/Image": Image,
    "sensor_msgs/msg/PointCloud2": PointCloud2,
    "geometry_msgs/msg/WrenchStamped": WrenchStamped,
    "diagnostic_msgs/msg/DiagnosticArray": DiagnosticArray,
    "geometry_msgs/msg/PoseWithCovarianceStamped": PoseWithCovarianceStamped,
}
QUEUE = 10


class GelformNode(Node):
    """Publishes the newest results of a stream until the source ends or the node is destroyed."""

    def __init__(self) -> None:
        super().__init__("gelform")
        calibration = gelform.load_calibration(self._parameter("calibration", ""))
        self._source = self._parameter("source", "simulated")
        name = self._parameter("name", "") or sensor_name_from(calibration.sensor_name)
        topics = self._parameter("topics", ",".join(USUAL)).split(",")
        self._messages = RosMessages(name, calibration.serial or "", topics)
        self._to = {
            topic: self.create_publisher(TYPES[TOPICS[topic].type], TOPICS[topic].of(name), QUEUE)
            for topic in self._messages.topics
        }
        self._stream = gelform.stream(self._source, calibration)
        Thread(target=self._publish_all, daemon=True).start()

    def destroy_node(self) -> None:
        """Give the sensor back."""
        self._stream.close()
        super().destroy_node()

    def _parameter(self, name: str, default: str) -> str:
        return self.declare_parameter(name, default).get_parameter_value().string_value

    def _publish(self, frame: gelform.Frame, result: gelform.Reconstruction, stamp_ns: int) -> None:
        for topic, message in self._messages.due(frame, result, stamp_ns):
            self._to[topic].publish(bytes(message))  # rclpy publishes bytes as they are: CDR

    def _publish_all(self) -> None:
        try:
            send_results(self._stream, self._source, self._messages.sensor, self._publish)
        except (gelform.GelformError, ValueError) as problem:
            self.get_logger().fatal(str(problem))


def main(arguments: Any = None) -> None:
    """Run the node until it is interrupted."""
    rclpy.init(args=arguments)
    node = GelformNode()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
