"""gelform bag, ros and track: results of a source as a ROS 2 bag, live, or as the path of the object."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from typer import Option

import gelform
from gelform import robots
from gelform.cli import options
from gelform.cli.console import DOUBT, ShownOption, mistakes_in, say, status_of
from gelform.cli.files import FilmInputs, check_output, save_by_name
from gelform.cli.options import argument, option, usage_errors
from gelform.errors import counted
from gelform.robots.topics import (
    MAX_DOMAIN,
    MIDDLEWARES,
    ROUTER,
    TOPICS,
    USUAL,
    check_sensor_name,
    check_topics,
)

PRIOR = "MM,DEG"


@dataclass(frozen=True)
class Sent:
    """Topics of a source, their prefix, and the duration."""

    topics: Annotated[str, option("A,B", f"Topics, of {','.join(TOPICS)}.")] = ",".join(USUAL)
    name: Annotated[
        str | None, option("NAME", "Prefix of topics and frames; else the calibration's sensor.")
    ] = None
    seconds: options.Seconds = None
    accept_doubtful: options.AcceptDoubtful = False

    def settings(self) -> dict[str, Any]:
        """Keywords of `save_bag` and `publish`; raises a usage error for an unknown topic or an invalid name."""
        with usage_errors("--topics"):
            topics = check_topics(options.names_from(self.topics))
        with usage_errors("--name"):
            if self.name is not None:
                check_sensor_name(self.name)
        return {"topics": topics, "sensor": self.name, "seconds": self.seconds}

    def end(
        self, stats: robots.SentStats, topics: tuple[str, ...], shown: ShownOption, **made: Path
    ) -> NoReturn:
        """Say the figures, and end with the frames' status."""
        shown.json({**made, **asdict(stats), "topics": [TOPICS[one].of(stats.sensor) for one in topics]})
        status = status_of(stats.tally, accept_doubtful=self.accept_doubtful, quiet=shown.silent)
        if stats.problem:
            say(f"The last frame: {stats.problem}")
        raise typer.Exit(status)


def bag(
    *,
    source: Annotated[str, argument("INPUT", "Recording, video, folder, serial, name, URL, or simulated.")],
    given: FilmInputs,
    output: Annotated[Path, options.output("DIR", "A new folder: the bag of ROS 2.")],
    sent: Sent,
    shown: ShownOption,
) -> None:
    """Write results as a ROS 2 bag; needs no ROS.

    Writes images, indentation, points and findings as rosbag2 (MCAP).

    It takes every frame of a recording, and the newest frames of a camera. Topics: /NAME/image_raw (rgb8), /NAME/indentation
    (32FC1, meters, positive where pressed), /NAME/points (meters, in NAME_gel_optical_frame), /diagnostics; and
    /NAME/object_pose, if --topics names it. Needs the extra `ros`.

    \b
    Examples:
      gelform bag session.mcap -c cal.npz -o press_bag
      gelform bag simulated -c cal.npz -o press_bag --seconds 5 --name left_finger
      gelform bag video.mp4 --sensor digit --background rest.png -o press_bag
      gelform bag video.mp4 -c cal.npz -o press_bag --topics indentation,diagnostics
    """
    settings = sent.settings()
    loaded = given.calibration_of(source, shown.quiet)
    background = given.background_for(loaded)
    with shown.progress() as progress:
        stats = robots.save_bag(
            source, loaded, output, background=background, **given.reading, **settings, progress=progress
        )
    shown.say(
        f"Wrote {output}: {counted(stats.frames, 'frame')} in {stats.duration_s:.1f} s, {stats.drops} dropped."
    )
    if not stats.stamped:
        shown.say("The frames have no capture time, so their stamps begin now.")
    sent.end(stats, settings["topics"], shown, bag=output)


def ros(
    *,
    given: FilmInputs,
    source: Annotated[
        str, argument("[SOURCE]", "Serial, name, URL, recording, video, folder, or simulated.")
    ] = "simulated",
    sent: Sent,
    middleware: Annotated[str, option("NAME", f"Of {', '.join(MIDDLEWARES)}: rclpy where it is.")] = "auto",
    router: Annotated[str, option("ADDRESS", "Address of the zenoh router.")] = ROUTER,
    domain: Annotated[
        int, Option(envvar="ROS_DOMAIN_ID", min=0, max=MAX_DOMAIN, help="ROS domain of the subscribers.")
    ] = 0,
    shown: ShownOption,
) -> None:
    """Publish results to ROS 2: rclpy, or zenoh (experimental).

    Publishes images, indentation, points and findings, by rclpy where it is installed.

    Else it needs no ROS: then the subscribers must use the middleware rmw_zenoh (ROS 2 Jazzy and later), and a zenoh router
    must run: `ros2 run rmw_zenoh_cpp rmw_zenohd`. Topics and messages are those of gelform bag. Needs the extra `ros`.

    \b
    Examples:
      gelform ros -c cal.npz
      gelform ros 2BKRXXXX -c cal.npz --name left_finger --topics indentation,diagnostics
      gelform ros session.mcap -c cal.npz --router tcp/192.168.1.5:7447 --domain 7
    """
    options.one_of(middleware, MIDDLEWARES, "--middleware")
    link = {"router": router, "domain": domain, "middleware": middleware}
    settings = {**sent.settings(), **link, **given.reading}
    loaded = given.calibration_of(source, shown.quiet)
    background = given.background_for(loaded)
    with mistakes_in("ros"), shown.progress() as progress:
        stats = robots.publish(source, loaded, background=background, **settings, progress=progress)
    shown.say(
        f"Published {counted(stats.frames, 'frame')} in {stats.duration_s:.1f} s, {stats.drops} dropped."
    )
    sent.end(stats, settings["topics"], shown)


def track(
    *,
    source: Annotated[str, argument("INPUT", "Recording, video, folder, serial, name or URL.")],
    given: FilmInputs,
    output: Annotated[Path, options.output("CSV", "Table of the poses.")],
    surface: Annotated[
        Path | None, option("FILE", "A surface of all keyframes: .npz, .ply, .stl, .tiff, .x3p.")
    ] = None,
    prior: Annotated[
        str | None, option(PRIOR, "Motion between frames: standard deviations in mm and degrees.")
    ] = None,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Follow the object that touches: a pose for each frame.

    The table has the pose of each frame from the first contact: x_mm, y_mm, z_mm and the turn vector in degrees, their
    standard deviations about the contact's middle, what these contacts cannot show (blind), and the state: found, cannot
    tell yet, or lost, with the reason. A lost frame has no pose. Axes: x to the right, y down, z toward the camera.

    \b
    Examples:
      gelform track session.mcap -c cal.npz -o track.csv
      gelform track video.mp4 -c cal.npz -o track.csv --prior 0.1,0.5
      gelform track session.mcap -c cal.npz -o track.csv --surface plate.ply
    """
    from gelform.exchange.exporters.surface import SURFACES
    from gelform.motion.between import LOST, checked_prior
    from gelform.motion.track import Follower
    from gelform.robots.send import results_of
    from gelform.sensors.films import is_film, open_film

    spread = None if prior is None else options.numbers(prior, PRIOR, "--prior")
    in_rad = None if spread is None else (spread[0], math.radians(spread[1]))
    with usage_errors("--prior"):
        checked_prior(in_rad)
    if surface is not None:
        options.one_of(surface.suffix.lower(), (".npz", *SURFACES), "--surface")
        check_output(surface, overwrite=overwrite)
    check_output(output, overwrite=overwrite)
    loaded = given.calibration_of(source, shown.quiet)
    known, follow = given.background_for(loaded), Follower(in_rad, loaded.settings.place_error)
    poses: list[gelform.Tracked] = []
    total = open_film(Path(source), dataset=given.dataset).count if is_film(source) else 0
    # For a surface: of the keyframes, and of the last two frames.
    results: dict[int, gelform.Reconstruction] = {}
    opened = partial(gelform.open_source, source, **given.reading)
    with shown.progress() as progress, gelform.stream(opened, loaded, background=known) as running:
        for number, one in enumerate(results_of(running, source, "follow")):
            poses.append(follow(one.result))
            if surface is not None:
                results[number] = one.result
                if number > 1 and poses[number - 1].keyframe != number - 2:  # it did not become the keyframe
                    del results[number - 2]
            progress(number + 1, max(total, number + 1), "following")
    _write_poses(poses, output, overwrite)
    states = Counter(pose.motion.state for pose in poses)
    shown.say(f"Wrote {output}: {', '.join(f'{count} {state}' for state, count in states.items())}.")
    reasons = Counter(pose.motion.why.partition(":")[0] for pose in poses if pose.motion.state == LOST)
    shown.table("Frames without a pose", ("reason", "frames"), reasons.most_common())
    if surface is not None:
        chosen = [k for k in results if poses[k].motion.pose is not None]
        whole = gelform.mosaic([results[k] for k in chosen], [poses[k] for k in chosen])
        save_by_name(whole, surface, overwrite=overwrite)
        shown.say(f"Wrote {surface}: {counted(len(chosen), 'contact')} as one surface.")
    shown.json(
        {"track": output, "frames": len(poses), "states": dict(states), "lost_by_reason": dict(reasons)}
    )
    if 2 * states[LOST] > len(poses):
        say(
            f"gelform: error: the object was lost in {states[LOST]} of {counted(len(poses), 'frame')}. See the "
            "reasons above, and the "
            "column why of the table."
        )
        raise typer.Exit(DOUBT)


def _write_poses(poses: list[gelform.Tracked], path: Path, overwrite: bool) -> None:
    import numpy as np

    from gelform.foundations.files import table_text, written_file
    from gelform.motion.between import step_of_pose

    axes = ("x_mm", "y_mm", "z_mm", "turn_x_deg", "turn_y_deg", "turn_z_deg")
    sigmas = [f"sigma_{one}" for one in axes]
    rows: list[list[Any]] = [
        ["frame", "time_s", "state", *axes, *sigmas, "shared", "keyframe", "blind", "why"]
    ]
    units = np.repeat([1.0, 180 / np.pi], 3)
    for count, pose in enumerate(poses):
        motion, figures = pose.motion, [""] * 12
        if motion.pose is not None and motion.covariance is not None:
            values = (step_of_pose(motion.pose, np.zeros(3)), np.sqrt(np.diag(motion.covariance)))
            figures = [f"{value:.6g}" for of in values for value in of * units]
        time_s = "" if pose.time_s is None else f"{pose.time_s:.6f}"
        words = "; ".join(one.words for one in motion.blind)
        rows.append(
            [count, time_s, motion.state, *figures, f"{motion.shared:.3f}", pose.keyframe, words, motion.why]
        )
    with written_file(path, overwrite=overwrite) as file:
        file.write(table_text(rows).encode())
