"""gelform ros: a source through a calibration to ROS 2, live over zenoh."""

from __future__ import annotations

from typing import Annotated

import typer

from gelform.cli.commands.robots.bag import checked_names
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
from gelform.robots.topics import MAX_DOMAIN, ROUTER, TOPICS


def ros(
    calibration: CalibrationFile,
    source: Annotated[
        str,
        typer.Argument(metavar="[SOURCE]", help="Serial, name, URL, recording, video, folder, or simulated."),
    ] = "simulated",
    topics: Topics = ALL_TOPICS,
    name: TopicsOf = None,
    router: Annotated[str, typer.Option(metavar="ADDRESS", help="Of the zenoh router.")] = ROUTER,
    domain: Annotated[
        int,
        typer.Option(envvar="ROS_DOMAIN_ID", min=0, max=MAX_DOMAIN, help="That of those who listen."),
    ] = 0,
    seconds: Seconds = None,
    background: Background = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Publish images, indentation, points and findings to ROS 2 over zenoh, without ROS here. Experimental.

    For nodes whose middleware is rmw_zenoh, Jazzy and later; topics and messages are those of gelform bag. A zenoh
    router has to run, as rmw_zenoh wants: `ros2 run rmw_zenoh_cpp rmw_zenohd`. Extra `zenoh`.

    \b
    Examples:
      gelform ros -c cal.npz
      gelform ros 2BKRXXXX -c cal.npz --name left_finger --topics indentation,diagnostics
      gelform ros session.mcap -c cal.npz --router tcp/192.168.1.5:7447 --domain 7
    """
    from gelform.calibration_file import load_calibration
    from gelform.cli.failures import mistakes_in
    from gelform.cli.sensor_images import background_in
    from gelform.robots.publish import publish

    wanted = checked_names(topics, name)
    loaded = load_calibration(calibration)
    with mistakes_in("ros"), progress_shown(quiet) as progress:
        stats = publish(
            source,
            loaded,
            topics=wanted,
            sensor=name,
            router=router,
            domain=domain,
            seconds=seconds,
            background=background_in(background, loaded),
            progress=progress,
        )
    said = f"Published {stats.frames} frames in {stats.duration_s:.1f} s, {stats.drops} dropped."
    say(said, quiet)
    if as_json:
        print_json({**vars(stats), "topics": [TOPICS[one].of(stats.sensor) for one in wanted]})
