"""A source through a calibration into a bag of ROS 2."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from os import PathLike

from numpy.typing import ArrayLike

from gelform.calibration_file import Calibration, as_calibration
from gelform.checks import check_positive
from gelform.errors import DataError
from gelform.frames import Frame
from gelform.progress import Progress, no_progress
from gelform.robots.bag_file import BagFile
from gelform.robots.topics import NEEDS_SCALE, TOPICS, check_topics, sensor_name_from
from gelform.streams.pipeline import StreamFrame
from gelform.streams.stream import stream


@dataclass(frozen=True)
class BagStats:
    """What a bag holds.

    Attributes
    ----------
    sensor : the name that its topics begin with
    frames, duration_s : how many, and s from the first to the last
    drops : frames of the source that never became a result
    stamped : whether frames said when they were taken; else stamps begin when the bag was written
    """

    sensor: str
    frames: int
    duration_s: float
    drops: int
    stamped: bool


def save_bag(
    source: str | PathLike[str],
    calibration: Calibration | str | PathLike[str],
    path: str | PathLike[str],
    *,
    topics: Iterable[str] = tuple(TOPICS),
    sensor: str | None = None,
    seconds: float | None = None,
    background: ArrayLike | None = None,
    progress: Progress = no_progress,
) -> BagStats:
    """Reconstruct what a source gives, and write frames and results as a rosbag2 folder.

    Of a recording, a video or a folder every frame; of a camera the newest ones, until `seconds` have gone. An
    interrupt (Ctrl-C) ends the bag as the source's end does.

    Parameters
    ----------
    source : what `open_source` takes
    calibration : of the sensor, or the path of its file
    path : a new folder
    topics : names of TOPICS
    sensor : a name of ROS that topics and frames begin with; by default made of the calibration's sensor name
    seconds : how long; without end where None
    background : (H, W, 3), 0-255, the untouched image of today; the calibration's own by default
    progress : is told frames

    Raises
    ------
    SensorError, DataError
        The source cannot be opened or gives no frame, or frames of another size; the path is there already or cannot
        be written; the extra `ros` is not installed.
    CalibrationError
        The calibration cannot be read or is of another sensor, or it has no scale: indentation and points are metres.
    ValueError
        An unknown topic, no name of ROS, or seconds that are no time.
    """
    calibration, topics = as_calibration(calibration), check_topics(topics)
    if set(topics) & set(NEEDS_SCALE):
        _ = calibration.known_mm_per_px
    limit_s = None if seconds is None else check_positive(seconds, "seconds")
    name = sensor_name_from(calibration.sensor_name) if sensor is None else sensor
    with (
        BagFile(path, name, topics=topics, hardware_id=calibration.serial or "") as bag,
        stream(source, calibration, background=background) as running,
    ):
        seen = _from_first(running.pairs(), source)
        stamps, count, last_s = _Stamps(), 0, 0.0
        try:
            for one in seen:
                stamp_ns = stamps(one.frame)
                if limit_s is not None and one.time_s - stamps.first_s >= limit_s:
                    break
                bag.write(one.frame, one.result, stamp_ns)
                count, last_s = count + 1, one.time_s
                progress(count, count, "writing frames")
        except KeyboardInterrupt:  # the usual end of a camera's bag
            pass
        drops = running.stats.drops
    return BagStats(name, count, last_s - stamps.first_s, drops, stamps.known)


class _Stamps:
    """When frames were taken, UTC, ns; where they do not say, from now on, as far apart as they were."""

    def __init__(self) -> None:
        self.known, self.first_s = True, 0.0
        self._start_ns = 0

    def __call__(self, frame: Frame) -> int:
        if not self._start_ns:
            self._start_ns, self.first_s, self.known = time.time_ns(), frame.time_s, frame.wall_time_ns > 0
        if self.known:
            return frame.wall_time_ns
        return self._start_ns + round((frame.time_s - self.first_s) * 1e9)


def _from_first(pairs: Iterator[StreamFrame], source: object) -> Iterator[StreamFrame]:
    """All of them; DataError where there is none, or where they are not of the calibrated size."""
    try:
        first = next(pairs, None)
    except (ValueError, TypeError) as problem:
        raise DataError(f"{source}: {problem}") from problem
    if first is None:
        raise DataError(f"No frame came from {source}: there is nothing to write.")
    return chain([first], pairs)
