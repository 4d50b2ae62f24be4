"""gelform scale: how many mm a pixel is, from something whose size is known."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from gelform.cli.console import print_json, say
from gelform.cli.failures import mistakes_in
from gelform.cli.options import Background, Json, Quiet, Sensor, numbers

if TYPE_CHECKING:
    from gelform.calibration.geometry.files import Setup
    from gelform.calibration.geometry.scale import Scale


def scale(
    place: Annotated[
        Path,
        typer.Argument(metavar="PLACE", help="Press folder, its sensor.toml, or an imported calibration."),
    ],
    points: Annotated[
        str | None,
        typer.Option(
            metavar="X1,Y1,X2,Y2,MM", help="Two marked points of the image, px, and their distance."
        ),
    ] = None,
    punch: Annotated[
        str | None, typer.Option(metavar="IMG,MM", help="Press of a flat, round punch and its diameter.")
    ] = None,
    thread: Annotated[
        str | None, typer.Option(metavar="IMG,MM", help="Press of a screw's thread and its pitch.")
    ] = None,
    stage: Annotated[
        str | None, typer.Option(metavar="A,B,MM", help="One thing pressed twice, a stage's step apart.")
    ] = None,
    sensor: Sensor = None,
    background: Background = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure mm per pixel and write it where `calibrate` reads it: into the folder's sensor.toml.

    Images are camera frames, read through the [view] that is there. Several measurements are averaged by their
    uncertainty; where they contradict each other, nothing is written.

    \b
    Examples:
      gelform scale presses/ --punch punch.png,5
      gelform scale presses/ --points 20,31.5,290,28,17.1
      gelform scale presses/ --thread m8.png,1.25 --stage left.png,right.png,4 --background rest.png
      gelform scale imported.npz --punch punch.png,5
    """
    if all(one is None for one in (points, punch, thread, stage)):
        raise typer.BadParameter(
            "expected one or more of --points, --punch, --thread, --stage.", param_hint="scale"
        )
    marked = None if points is None else numbers(points, "X1,Y1,X2,Y2,MM", "--points")
    pressed = {
        option: _images_and_mm(text, option)
        for option, text in (("--punch", punch), ("--thread", thread), ("--stage", stage))
        if text is not None
    }
    from gelform.calibration.geometry.files import save_scale
    from gelform.calibration.geometry.scale import combined_scale

    scales = [] if marked is None else [_scale_of_points(marked)]
    if pressed:
        from gelform.calibration.geometry.files import read_setup

        setup = read_setup(place, background=background, sensor=sensor)
        scales += [_scale_of_images(setup, option, *given) for option, given in pressed.items()]
    found = combined_scale(scales)
    written = save_scale(found, place)
    say(f"{found.mm_per_px:.5g} +- {found.sigma:.2g} mm per pixel, from {found.source}.", quiet)
    say(f"Wrote {written}.", quiet)
    if as_json:
        described = {"mm_per_px": found.mm_per_px, "mm_per_px_sigma": found.sigma, "source": found.source}
        print_json({"file": written, **described})


def _images_and_mm(text: str, option: str) -> tuple[list[Path], float]:
    """The image files and the length behind them."""
    form = "A,B,MM" if option == "--stage" else "IMG,MM"
    *paths, length = text.split(",")
    if len(paths) != form.count(","):
        raise typer.BadParameter(f"expected {form}, got {text!r}.", param_hint=option)
    return [Path(path) for path in paths], numbers(length, "MM", option)[0]


def _scale_of_points(marked: tuple[float, ...]) -> Scale:
    from gelform.calibration.geometry.scale import scale_from_points

    x1, y1, x2, y2, mm = marked
    with mistakes_in("--points"):
        return scale_from_points((x1, y1), (x2, y2), mm)


def _scale_of_images(setup: Setup, option: str, paths: list[Path], mm: float) -> Scale:
    from gelform.calibration.geometry.scale_images import (
        scale_from_punch,
        scale_from_stage,
        scale_from_thread,
    )

    with mistakes_in(option):
        images = [setup.image(path) for path in paths]
        if option == "--stage":
            return scale_from_stage(images[0], images[1], setup.background, mm)
        measure = scale_from_punch if option == "--punch" else scale_from_thread
        return measure(images[0], setup.background, mm)
