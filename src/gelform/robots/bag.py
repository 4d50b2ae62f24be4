"""A source through a calibration into a bag of ROS 2."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike

from numpy.typing import ArrayLike

from gelform.calibration_file import Calibration, as_calibration
from gelform.checks import check_positive
from gelform.progress import Progress, no_progress
from gelform.robots.bag_file import BagFile
from gelform.robots.stamped import SentStats, StampedResults
from gelform.robots.topics import NEEDS_SCALE, TOPICS, check_topics, sensor_name_from
from gelform.streams.stream import stream


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
) -> SentStats:
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
        results = StampedResults(running, source, limit_s)
        try:
            for count, (seen, stamp_ns) in enumerate(results, 1):
                bag.write(seen.frame, seen.result, stamp_ns)
                progress(count, count, "writing frames")
        except KeyboardInterrupt:  # the usual end of a camera's bag
            pass
        return results.stats(name)
