"""A source through a calibration to ROS 2, live over zenoh; experimental."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike

from numpy.typing import ArrayLike

from gelform.calibration_file import Calibration, as_calibration
from gelform.checks import check_positive
from gelform.progress import Progress, no_progress
from gelform.robots.stamped import SentStats, StampedResults
from gelform.robots.topics import NEEDS_SCALE, ROUTER, TOPICS, check_topics, sensor_name_from
from gelform.robots.zenoh_node import ZenohNode
from gelform.sensors.source import open_source
from gelform.streams.stream import stream


def publish(
    source: str | PathLike[str],
    calibration: Calibration | str | PathLike[str],
    *,
    topics: Iterable[str] = tuple(TOPICS),
    sensor: str | None = None,
    router: str = ROUTER,
    domain: int = 0,
    seconds: float | None = None,
    background: ArrayLike | None = None,
    progress: Progress = no_progress,
) -> SentStats:
    """Reconstruct what a source gives, and publish the newest results as topics of ROS 2 until it ends.

    Nodes whose middleware is rmw_zenoh (Jazzy and later) receive them. Recordings, videos and folders are played at
    their own pace. An interrupt (Ctrl-C) ends it as the source's end does.

    Parameters
    ----------
    source : what `open_source` takes
    calibration : of the sensor, or the path of its file
    topics : names of TOPICS
    sensor : a name of ROS that topics and frames begin with; by default made of the calibration's sensor name
    router : address of the zenoh router
    domain : the number ROS_DOMAIN_ID of those who listen
    seconds : how long; without end where None
    background : (H, W, 3), 0-255, the untouched image of today; the calibration's own by default
    progress : is told frames

    Raises
    ------
    GelformError
        No router answers.
    SensorError, DataError
        The source cannot be opened or gives no frame, or frames of another size; the extra `zenoh` is not installed.
    CalibrationError
        The calibration cannot be read or is of another sensor, or it has no scale: indentation and points are metres.
    ValueError
        An unknown topic, no name of ROS, no such domain, no address, or seconds that are no time.
    """
    calibration, topics = as_calibration(calibration), check_topics(topics)
    if set(topics) & set(NEEDS_SCALE):
        _ = calibration.known_mm_per_px
    limit_s = None if seconds is None else check_positive(seconds, "seconds")
    name = sensor_name_from(calibration.sensor_name) if sensor is None else sensor
    hardware_id = calibration.serial or ""
    with (
        ZenohNode(name, topics=topics, router=router, domain=domain, hardware_id=hardware_id) as node,
        stream(lambda: open_source(source, paced=True), calibration, background=background) as running,
    ):
        results = StampedResults(running, source, limit_s)
        try:
            for count, (seen, stamp_ns) in enumerate(results, 1):
                node.publish(seen.frame, seen.result, stamp_ns)
                progress(count, count, "publishing frames")
        except KeyboardInterrupt:  # the usual end
            pass
        return results.stats(name)
