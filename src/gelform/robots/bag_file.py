"""Writing a ROS 2 bag, under a temporary name until it is complete."""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack
from os import PathLike
from pathlib import Path
from types import TracebackType
from typing import Any

from gelform.errors import DataError
from gelform.foundations.checks import check_path
from gelform.foundations.npz_files import locked_folder, sweep
from gelform.image.frame import Frame
from gelform.result import Reconstruction
from gelform.robots.ros_messages import RosMessages
from gelform.robots.topics import TOPICS, USUAL, check_sensor_name, check_topics

METADATA_VERSION = 9  # of rosbag2 in Jazzy and later; Humble plays the .mcap inside
QUEUE = 10  # queue of the publishers of `ros2 bag play`: ROS's default


class BagFile:
    """A rosbag2 folder (metadata.yaml and one MCAP file), written frame by frame; a context manager.

    The folder gets its name when it is closed. An exception discards it, except an interrupt (Ctrl-C), which keeps the
    frames written so far.

    Parameters
    ----------
    path : a new folder
    sensor : a ROS name, the prefix of topics and coordinate frames
    topics : names of TOPICS to write
    hardware_id : of the diagnostics, such as the serial number

    Raises
    ------
    DataError
        The path exists or cannot be written, or the extra `ros` is not installed.
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
    ) -> None:
        self.path = check_path(path)
        self._messages = RosMessages(check_sensor_name(sensor), hardware_id)
        self._topics = check_topics(topics)
        if os.path.lexists(self.path):
            raise DataError(f"{self.path} is there already. Choose another name, or remove it.")
        self._unfinished = self.path.with_name(f".{self.path.name}.partial-{os.getpid()}")
        self._lock = ExitStack()
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            sweep(self.path.parent, self.path.name)
            self._unfinished.mkdir()
            self._lock.enter_context(locked_folder(self._unfinished))
            self._writer = _writer(self._unfinished / self.path.name)
            self._connections = {name: self._connection(name) for name in self._topics}
        except OSError as problem:
            raise self._unwritable(problem) from problem

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
        try:
            for name, message in self._messages.due(self._topics, frame, result, stamp_ns):
                self._writer.write(self._connections[name], stamp_ns, message)
        except OSError as problem:
            raise self._unwritable(problem) from problem

    def close(self) -> None:
        """Write the index, and give the folder its name."""
        try:
            self._writer.close()
            (self._unfinished / self.path.name).rename(self.path)
            self._unfinished.rmdir()
            self._lock.close()
        except OSError as problem:
            raise self._unwritable(problem) from problem

    def discard(self) -> None:
        """Leave nothing."""
        self._writer.abort()
        shutil.rmtree(self._unfinished, ignore_errors=True)
        self._lock.close()

    def __enter__(self) -> BagFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None or issubclass(kind, KeyboardInterrupt):
            self.close()
        else:
            self.discard()

    def _connection(self, name: str) -> Any:
        topic = TOPICS[name]
        return self._writer.add_connection(
            topic.of(self._messages.sensor),
            topic.type,
            typestore=self._messages.store,
            offered_qos_profiles=[_offered()],
        )

    def _unwritable(self, problem: OSError) -> DataError:
        shutil.rmtree(self._unfinished, ignore_errors=True)
        self._lock.close()
        return DataError(f"Cannot write {self.path}: {problem.strerror or problem}. Nothing was kept.")


def _writer(path: Path) -> Any:
    from rosbags.rosbag2 import StoragePlugin, Writer

    writer = Writer(path, version=METADATA_VERSION, storage_plugin=StoragePlugin.MCAP)
    writer.open()
    return writer


def _offered() -> Any:
    """Reliable, volatile, keep the last ten: a player with these settings serves subscribers of either reliability."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    unlimited = QosTime(9223372036, 854775807)  # rosbag2's value for no limit
    return Qos(
        QosHistory.KEEP_LAST,
        QUEUE,
        QosReliability.RELIABLE,
        QosDurability.VOLATILE,
        unlimited,
        unlimited,
        QosLiveliness.AUTOMATIC,
        unlimited,
        False,
    )
