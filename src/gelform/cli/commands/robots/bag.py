"""gelform bag: a source through a calibration into a bag of ROS 2."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from gelform.cli.console import print_json, progress_shown, say
from gelform.cli.options import (
    ALL_TOPICS,
    Background,
    CalibrationFile,
    Json,
    Quiet,
    Seconds,
    Topics,
    TopicsOf,
)
from gelform.robots.topics import TOPICS, check_sensor_name, check_topics


def bag(
    source: Annotated[
        str,
        typer.Argument(metavar="INPUT", help="Recording, video, folder, serial, name, URL, or simulated."),
    ],
    calibration: CalibrationFile,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="A new folder: the bag of ROS 2.")
    ],
    topics: Topics = ALL_TOPICS,
    name: TopicsOf = None,
    seconds: Seconds = None,
    background: Background = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Write images, indentation, points and findings as a bag of ROS 2 (rosbag2, MCAP); needs no ROS.

    Every frame of a recording, the newest ones of a camera. Topics: /NAME/image_raw (rgb8), /NAME/indentation (32FC1,
    metres, positive where pressed), /NAME/points (metres, in NAME_gel_optical_frame), /diagnostics. Extra `ros`.

    \b
    Examples:
      gelform bag session.mcap -c cal.npz -o press_bag
      gelform bag simulated -c cal.npz -o press_bag --seconds 5 --name left_finger
      gelform bag video.mp4 -c cal.npz -o press_bag --topics indentation,diagnostics
    """
    from gelform.calibration_file import load_calibration
    from gelform.cli.sensor_images import background_in
    from gelform.robots.bag import save_bag

    wanted = checked_names(topics, name)
    loaded = load_calibration(calibration)
    with progress_shown(quiet) as progress:
        stats = save_bag(
            source,
            loaded,
            output,
            topics=wanted,
            sensor=name,
            seconds=seconds,
            background=background_in(background, loaded),
            progress=progress,
        )
    say(f"Wrote {output}: {stats.frames} frames in {stats.duration_s:.1f} s, {stats.drops} dropped.", quiet)
    if not stats.stamped:
        say("The frames do not say when they were taken: their stamps begin now.", quiet)
    if as_json:
        print_json({"bag": output, **vars(stats), "topics": [TOPICS[one].of(stats.sensor) for one in wanted]})


def checked_names(topics: str, name: str | None) -> tuple[str, ...]:
    """Topics and a name of ROS from the command line, or what is wrong with them."""
    try:
        wanted = check_topics(one.strip() for one in topics.split(",") if one.strip())
    except ValueError as problem:
        raise typer.BadParameter(str(problem), param_hint="--topics") from problem
    try:
        if name is not None:
            check_sensor_name(name)
    except ValueError as problem:
        raise typer.BadParameter(str(problem), param_hint="--name") from problem
    return wanted
