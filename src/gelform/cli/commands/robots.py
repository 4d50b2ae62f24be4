"""gelform bag and gelform ros: results of a source as a ROS 2 bag, or live over zenoh."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from typer import Argument, Option

from gelform.cli.console import say
from gelform.cli.options import (
    ALL_TOPICS,
    AcceptDoubtful,
    Background,
    CalibrationOptions,
    ShownOption,
    number,
    usage_errors,
)
from gelform.cli.process import mistakes_in
from gelform.cli.sensor_images import background_in, calibration_given
from gelform.robots.topics import MAX_DOMAIN, ROUTER, TOPICS, check_sensor_name, check_topics

if TYPE_CHECKING:
    from gelform.calibration_file import Calibration
    from gelform.robots.send import SentStats


@dataclass(frozen=True)
class Sent:
    """Topics of a source, their prefix, the duration, and the background image."""

    topics: Annotated[str, Option(metavar="A,B", help=f"Topics, of {ALL_TOPICS}.")] = ALL_TOPICS
    name: Annotated[
        str | None,
        Option(metavar="NAME", help="Prefix of topics and frames; else the calibration's sensor."),
    ] = None
    seconds: Annotated[float | None, number("Duration in seconds; else to the end or Ctrl-C.")] = None
    background: Background = None
    accept_doubtful: AcceptDoubtful = False

    def wanted(self) -> tuple[str, ...]:
        """The topics by name; raises a usage error for an unknown topic or an invalid name."""
        with usage_errors("--topics"):
            wanted = check_topics(one.strip() for one in self.topics.split(",") if one.strip())
        with usage_errors("--name"):
            if self.name is not None:
                check_sensor_name(self.name)
        return wanted

    def settings(self, calibration: Calibration) -> dict[str, Any]:
        """Keywords of `save_bag` and `publish`."""
        background = background_in(self.background, calibration)
        named = {"topics": self.wanted(), "sensor": self.name, "seconds": self.seconds}
        return {**named, "background": background}


def bag(
    *,
    source: Annotated[
        str, Argument(metavar="INPUT", help="Recording, video, folder, serial, name, URL, or simulated.")
    ],
    given: CalibrationOptions,
    output: Annotated[Path, Option("--output", "-o", metavar="DIR", help="A new folder: the bag of ROS 2.")],
    sent: Sent,
    shown: ShownOption,
) -> None:
    """Write results as a ROS 2 bag; needs no ROS.

    Writes images, indentation, points and findings as rosbag2 (MCAP).

    It takes every frame of a recording, and the newest frames of a camera. Topics: /NAME/image_raw (rgb8), /NAME/indentation
    (32FC1, meters, positive where pressed), /NAME/points (meters, in NAME_gel_optical_frame), /diagnostics. Needs the extra
    `ros`.

    \b
    Examples:
      gelform bag session.mcap -c cal.npz -o press_bag
      gelform bag simulated -c cal.npz -o press_bag --seconds 5 --name left_finger
      gelform bag video.mp4 --sensor digit --background rest.png -o press_bag
      gelform bag video.mp4 -c cal.npz -o press_bag --topics indentation,diagnostics
    """
    from gelform.calibration.library.choose import unit_of
    from gelform.robots.send import save_bag

    wanted = sent.wanted()
    loaded = calibration_given(given, sent.background, lambda: unit_of(source), shown.quiet)
    with shown.progress() as progress:
        stats = save_bag(source, loaded, output, **sent.settings(loaded), progress=progress)
    shown.say(f"Wrote {output}: {stats.frames} frames in {stats.duration_s:.1f} s, {stats.drops} dropped.")
    if not stats.stamped:
        shown.say("The frames have no capture time, so their stamps begin now.")
    shown.json({"bag": output, **asdict(stats), "topics": [TOPICS[one].of(stats.sensor) for one in wanted]})
    _end(stats, sent, shown)


def ros(
    *,
    given: CalibrationOptions,
    source: Annotated[
        str, Argument(metavar="[SOURCE]", help="Serial, name, URL, recording, video, folder, or simulated.")
    ] = "simulated",
    sent: Sent,
    router: Annotated[str, Option(metavar="ADDRESS", help="Address of the zenoh router.")] = ROUTER,
    domain: Annotated[
        int, Option(envvar="ROS_DOMAIN_ID", min=0, max=MAX_DOMAIN, help="ROS domain of the subscribers.")
    ] = 0,
    shown: ShownOption,
) -> None:
    """Publish results to ROS 2 over zenoh (experimental).

    Publishes images, indentation, points and findings; this machine needs no ROS.

    The subscribers must use the middleware rmw_zenoh (ROS 2 Jazzy and later). Topics and messages are those of gelform
    bag. A zenoh router must run: `ros2 run rmw_zenoh_cpp rmw_zenohd`. Needs the extra `ros`.

    \b
    Examples:
      gelform ros -c cal.npz
      gelform ros 2BKRXXXX -c cal.npz --name left_finger --topics indentation,diagnostics
      gelform ros session.mcap -c cal.npz --router tcp/192.168.1.5:7447 --domain 7
    """
    from gelform.calibration.library.choose import unit_of
    from gelform.robots.send import publish

    wanted = sent.wanted()
    loaded = calibration_given(given, sent.background, lambda: unit_of(source), shown.quiet)
    with mistakes_in("ros"), shown.progress() as progress:
        settings = {**sent.settings(loaded), "router": router, "domain": domain}
        stats = publish(source, loaded, **settings, progress=progress)
    shown.say(f"Published {stats.frames} frames in {stats.duration_s:.1f} s, {stats.drops} dropped.")
    shown.json({**asdict(stats), "topics": [TOPICS[one].of(stats.sensor) for one in wanted]})
    _end(stats, sent, shown)


def _end(stats: SentStats, sent: Sent, shown: ShownOption) -> NoReturn:
    from gelform.cli.tally import status_of

    status = status_of(stats.tally, accept_doubtful=sent.accept_doubtful, quiet=shown.silent)
    if stats.problem:
        say(f"The last frame: {stats.problem}")
    raise typer.Exit(status)
