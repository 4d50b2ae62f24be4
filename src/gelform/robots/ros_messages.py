"""A frame and its result as ROS 2 messages, encoded as CDR: standard types, meters, optical frames.

REP-103: a frame whose name ends in `_optical_frame` has x to the right, y down and z away from the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gelform import Frame, Reconstruction
from gelform.errors import needed
from gelform.exchange.exporters.surface import M_PER_MM, points_from_result
from gelform.motion.between import about_other_center
from gelform.motion.track import Follower
from gelform.robots.topics import TOPICS, USUAL, check_sensor_name, check_topics
from gelform.sensors.mcap import NS_PER_S, header_of, typestore
from gelform.sensors.playback import Every, encoded_from_frame


def indentation_m(result: Reconstruction) -> NDArray[np.float32]:
    """Depth (H, W) in meters, positive where pressed, NaN where unknown, in little-endian numbers."""
    meters = (result.depth_mm * M_PER_MM).astype("<f4", copy=False)
    if not result.known.all():
        meters[~result.known] = np.nan
    return meters


class RosMessages:
    """Messages of one sensor, named as in ROS; `hardware_id` of the diagnostics is such as the serial number.

    `place_error` is a calibration's, for the covariance of the pose; see `motion_between`. To find out whether the findings
    have changed takes half of a frame's time: it is done every `look_s`, s; 0: for each frame.

    DataError: the extra `ros` is not installed. ValueError: the sensor is no ROS name, or a topic is unknown.
    """

    def __init__(
        self,
        sensor: str,
        hardware_id: str = "",
        topics: Iterable[str] = USUAL,
        place_error: float | None = None,
        look_s: float = 0.0,
    ) -> None:
        self.sensor, self.hardware_id = check_sensor_name(sensor), hardware_id
        self.topics = check_topics(topics)
        needed("rosbags.typesys", "ros", "A message of ROS 2")
        self.store = typestore()
        self.camera_frame, self.gel_frame = f"{sensor}_camera_optical_frame", f"{sensor}_gel_optical_frame"
        self._said: tuple[tuple[str, ...] | None, int] = (None, 0)
        self._looks = Every(look_s)
        self._place_error = place_error
        self.reset_pose()

    def due(
        self,
        frame: Frame,
        result: Reconstruction,
        stamp_ns: int,
        wanted: Callable[[str], bool] = lambda topic: True,
    ) -> Iterator[tuple[str, memoryview]]:
        """(topic, message) pairs of a frame taken at UTC ns.

        What is not `wanted` is not made, but for the pose, which follows the object from frame to frame. Diagnostics come
        once a second, as ROS's own do, and when the findings have changed.
        """
        for name in self.topics:
            if not (name == "pose" or wanted(name)) or (
                name == "diagnostics" and not self._is_news(result, stamp_ns)
            ):
                continue
            message = getattr(self, name)(frame, result, stamp_ns)
            if message is not None:
                yield name, message

    def _is_news(self, result: Reconstruction, stamp_ns: int) -> bool:
        """Whether diagnostics are due."""
        before, said_ns = self._said
        recent = abs(stamp_ns - said_ns) < NS_PER_S
        if not self._looks(stamp_ns / NS_PER_S) and recent:
            return False
        names = tuple(finding.name for finding in result.health)
        if recent and before == names:
            return False
        self._said = (names, stamp_ns)
        return True

    def image(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview:
        """The frame from the camera: sensor_msgs/Image, rgb8."""
        return self._image("image", frame.image, "rgb8", stamp_ns, self.camera_frame)

    def compressed(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview:
        """The camera's own JPEG, else the frame as PNG: sensor_msgs/CompressedImage."""
        form, content = encoded_from_frame(frame)
        data = np.frombuffer(content, np.uint8)
        return self._message("compressed", stamp_ns, self.camera_frame, format=form, data=data)

    def indentation(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview:
        """Depth in meters, positive where pressed, NaN where unknown: sensor_msgs/Image, 32FC1."""
        return self._image("indentation", indentation_m(result), "32FC1", stamp_ns, self.gel_frame)

    def points(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview:
        """The surface, row by row: (x, y, -depth), meters; NaN where unknown: sensor_msgs/PointCloud2."""
        height, width = result.shape
        points = points_from_result(result)
        points *= M_PER_MM
        points, is_dense = points.astype("<f4", copy=False), bool(result.known.all())
        if not is_dense:
            points[~result.known.ravel()] = np.nan
        field = self._type("sensor_msgs/msg/PointField")
        # 7 is float32.
        fields = [field(name=n, offset=4 * k, datatype=7, count=1) for k, n in enumerate("xyz")]
        form = {"fields": fields, "is_bigendian": False, "point_step": 12, "row_step": 12 * width}
        data = points.view(np.uint8).ravel()
        size = {"height": height, "width": width}
        return self._message("points", stamp_ns, self.gel_frame, **size, **form, data=data, is_dense=is_dense)

    def wrench(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview | None:
        """The force on the gel, N, and its torsion, N m; NaN where unknown: geometry_msgs/WrenchStamped.

        What presses into the gel pushes toward the camera, which is -z. Torques about x and y are not known. None without
        known loads.
        """
        if result.force_model is None:
            return None
        vector, nan = self._type("geometry_msgs/msg/Vector3"), float("nan")
        torsion = nan if (about_z := result.force.torsion_n_mm) is None else about_z * M_PER_MM
        wrench = self._type("geometry_msgs/msg/Wrench")(
            force=vector(**dict(zip("xyz", result.force.vector_n.tolist()))),
            torque=vector(x=nan, y=nan, z=torsion),
        )
        return self._message("wrench", stamp_ns, self.gel_frame, wrench=wrench)

    def diagnostics(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview:
        """The findings of `health`, each as a value, and why a force is unknown: diagnostic_msgs/DiagnosticArray.

        The level is OK (0) without findings, WARN (1) with findings, ERROR (2) if depth is known in no pixel.
        """
        findings = result.health
        values = {one.name: f"{one.figure:g}: {one.message}" for one in findings}
        if result.force_model is not None and (why := result.force.reason):
            values["no_force"] = why
        level = (1 if result.known.any() else 2) if findings else 0
        return self._status(level, ", ".join(finding.name for finding in findings) or "OK", values, stamp_ns)

    def silence(self, state: str, reason: str, stamp_ns: int) -> memoryview:
        """Diagnostics of the level ERROR while no frame comes: the state of the stream, and why."""
        self._said = (None, 0)  # the next frame's come at once
        return self._status(2, "no_frame", {"no_frame": f"{state}: {reason}"}, stamp_ns)

    def reset_pose(self) -> None:
        """Begin the path of the pose again: the next contact is its origin."""
        self._follow = Follower(place_error=self._place_error)

    def _status(self, level: int, message: str, values: dict[str, str], stamp_ns: int) -> memoryview:
        pair = self._type("diagnostic_msgs/msg/KeyValue")
        status = self._type("diagnostic_msgs/msg/DiagnosticStatus")(
            level=level,
            name=f"gelform: {self.sensor}",
            message=message,
            hardware_id=self.hardware_id,
            values=[pair(key=key, value=value) for key, value in values.items()],
        )
        return self._message("diagnostics", stamp_ns, "", status=[status])

    def pose(self, frame: Frame, result: Reconstruction, stamp_ns: int) -> memoryview | None:
        """Where the object is that touched first, in the frame of the gel: geometry_msgs/PoseWithCovarianceStamped.

        Its own frame is that of the gel at the first contact. None where it is lost.
        """
        motion = self._follow(result).motion
        if motion.pose is None or motion.covariance is None or motion.center_mm is None:
            return None
        place, turn, covariance = optical_pose(motion.pose, motion.covariance, motion.center_mm)
        point, quaternion = (self._type(f"geometry_msgs/msg/{name}") for name in ("Point", "Quaternion"))
        at = self._type("geometry_msgs/msg/Pose")(
            position=point(*place.tolist()), orientation=quaternion(*turn.tolist())
        )
        known = self._type("geometry_msgs/msg/PoseWithCovariance")(pose=at, covariance=covariance.ravel())
        return self._message("pose", stamp_ns, self.gel_frame, pose=known)

    def _image(
        self, topic: str, pixels: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str
    ) -> memoryview:
        height, width = pixels.shape[:2]
        data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
        size = {"height": height, "width": width, "step": data.size // height}
        return self._message(topic, stamp_ns, frame_id, **size, encoding=encoding, is_bigendian=0, data=data)

    def _message(self, topic: str, stamp_ns: int, frame_id: str, **fields: Any) -> memoryview:
        """The message of a topic with a header and these fields, encoded."""
        kind = TOPICS[topic].type
        header = header_of(self.store, stamp_ns, frame_id)
        encoded: memoryview = self.store.serialize_cdr(self._type(kind)(header=header, **fields), kind)
        return encoded

    def _type(self, name: str) -> Any:
        return self.store.types[name]


def optical_pose(
    pose: NDArray[np.float64], covariance: NDArray[np.float64], center_mm: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Position (m), quaternion (x, y, z, w) and covariance (6, 6) (m, rad) of a motion, with z away from the camera.

    The covariance is moved from the contact's middle to the position, where ROS has it. With z turned round, the frame is
    right-handed, and turns change their sign about x and y.
    """
    away = np.diag([1.0, 1.0, -1.0])
    change = np.diag([M_PER_MM, M_PER_MM, -M_PER_MM, -1.0, -1.0, 1.0]) @ about_other_center(
        pose[:3, 3] - center_mm
    )
    turn = Rotation.from_matrix(away @ pose[:3, :3] @ away).as_quat()
    return away @ pose[:3, 3] * M_PER_MM, turn, change @ covariance @ change.T
