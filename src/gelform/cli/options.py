"""Options that several commands share, and the parsers of their values."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from gelform.cli.tables import listed
from gelform.robots.topics import TOPICS
from gelform.sensors.profiles import PROFILES


def positive(text: str) -> float:
    """A finite number > 0 that was given as an option."""
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise typer.BadParameter(f"expected a number > 0, got {text!r}.")
    return number


def numbers(text: str, form: str, option: str) -> tuple[float, ...]:
    """Numbers parted by commas, as many as the form (such as "X1,Y1,X2,Y2,MM") has parts."""
    try:
        found = tuple(float(part) for part in text.split(","))
    except ValueError:
        found = ()
    if len(found) != form.count(",") + 1 or not all(map(math.isfinite, found)):
        raise typer.BadParameter(f"expected {form}, got {text!r}.", param_hint=option)
    return found


def one_of(name: str, names: tuple[str, ...], option: str) -> str:
    """The name, where it is one of those known."""
    if name not in names:
        raise typer.BadParameter(f"expected {listed(names)}, got {name!r}.", param_hint=option)
    return name


Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Show neither progress nor tables.")]
Json = Annotated[bool, typer.Option("--json", help="Print the numbers as JSON on standard output.")]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results that are already there.")]
Images = Annotated[list[Path], typer.Argument(metavar="IMAGE...", help="Image files of the sensor.")]
PictureFolder = Annotated[
    Path | None,
    typer.Option("--output", "-o", metavar="DIR", help="Folder for a picture of each image."),
]
CalibrationFile = Annotated[
    Path, typer.Option("--calibration", "-c", metavar="CAL.npz", help="The sensor's calibration.")
]
Sensor = Annotated[
    str | None,
    typer.Option(metavar="PROFILE", help=f"Sensor profile: {listed(tuple(PROFILES))}; crop and scale."),
]
MmPerPx = Annotated[
    float | None, typer.Option(metavar="F", parser=positive, help="Width of an image pixel on the gel, mm.")
]
BallDiameter = Annotated[
    float | None,
    typer.Option(
        metavar="F",
        parser=positive,
        help="Diameter of the ball, mm, for a video or a folder without presses.csv.",
    ),
]
Background = Annotated[
    Path | None,
    typer.Option(metavar="IMG|DIR", help="Untouched gel: an image, or a folder of several to average."),
]
ALL_TOPICS = ",".join(TOPICS)
Topics = Annotated[str, typer.Option(metavar="A,B", help=f"Which topics, of {ALL_TOPICS}.")]
TopicsOf = Annotated[
    str | None,
    typer.Option(metavar="NAME", help="What topics and frames begin with; else the calibration's sensor."),
]
Seconds = Annotated[
    float | None, typer.Option(metavar="F", parser=positive, help="How long; else to the end or Ctrl-C.")
]
