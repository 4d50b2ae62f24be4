"""gelform scale, lens and crosstalk: calibration from objects of known size, and from the gel under single LEDs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, BadParameter, Option

import gelform
from gelform.cli.console import ShownOption
from gelform.cli.options import Background, Bgr, Sensor, number, numbers
from gelform.cli.process import mistakes_in

Place = Annotated[Path, Argument(metavar="PLACE", help="Press folder, or its sensor.toml, to write into.")]


def scale(
    *,
    place: Annotated[
        Path, Argument(metavar="PLACE", help="Press folder, its sensor.toml, or an imported calibration.")
    ],
    points: Annotated[
        list[str] | None,
        Option(
            metavar="X1,Y1,X2,Y2,MM",
            help="Two marked points of the image, px, and their distance; may be repeated.",
        ),
    ] = None,
    stage: Annotated[
        list[str] | None,
        Option(
            metavar="A,B,MM",
            help="Two images of one object, and the stage's step between them; may be repeated.",
        ),
    ] = None,
    sensor: Sensor = None,
    background: Background = None,
    shown: ShownOption,
) -> None:
    """Measure mm per pixel, for `calibrate`.

    Writes the scale into the folder's sensor.toml, where `calibrate` reads it.

    The images are camera frames, read through the existing [view]. Several measurements are averaged, weighted by their
    uncertainty. If they contradict each other, nothing is written. Measure along x and along y: they show pixels that are
    not square.

    \b
    Examples:
      gelform scale presses/ --points 20,31.5,290,28,17.1
      gelform scale presses/ --points 20,31,290,31,17.1 --points 100,20,100,210,12
      gelform scale presses/ --stage left.png,right.png,4 --background rest.png
      gelform scale imported.npz --points 20,31.5,290,28,17.1
    """
    if not points and not stage:
        raise BadParameter("expected --points, --stage or both.", param_hint="scale")
    marked = [numbers(text, "X1,Y1,X2,Y2,MM", "--points") for text in points or ()]
    pressed = []
    for text in stage or ():
        *paths, length = text.split(",")
        if len(paths) != 2:
            raise BadParameter(f"expected A,B,MM, got {text!r}.", param_hint="--stage")
        pressed.append((map(Path, paths), numbers(length, "MM", "--stage")[0]))
    from gelform.calibration.geometry.files import read_setup, save_scale, width_note

    with mistakes_in("--points"):
        scales = [gelform.scale_from_points((x1, y1), (x2, y2), mm) for x1, y1, x2, y2, mm in marked]
    if pressed:
        setup = read_setup(place, background=background, sensor=sensor)
        with mistakes_in("--stage"):
            for images, step_mm in pressed:
                first, second = map(setup.image, images)
                scales.append(gelform.scale_from_stage(first, second, setup.background, step_mm))
    found = gelform.combined_scale(scales)
    written = save_scale(found, place)
    if doubt := width_note(found.mm_per_px, place):
        shown.say(f"note: {doubt}")
    shown.say(f"{found.mm_per_px:.5g} +- {found.sigma:.2g} mm per pixel, from {found.source}.")
    shown.say(f"Wrote {written}.")
    measured = {"mm_per_px": found.mm_per_px, "mm_per_px_sigma": found.sigma}
    shown.json({"file": written, **measured, "source": found.source})


def lens(
    *,
    place: Place,
    images: Annotated[
        list[Path], Option("--image", metavar="IMG", help="Whole frame with the grid; may be repeated.")
    ],
    grid: Annotated[str, Option(metavar="CxR", help="Inner corners of the grid, such as 9x6; or its dots.")],
    pitch_mm: Annotated[float, number("Pitch of the grid, mm.")],
    dots: Annotated[bool, Option("--dots", help="The grid has dots, not a checkerboard.")] = False,
    shown: ShownOption,
) -> None:
    """Measure the lens, so that `calibrate` undoes it.

    Measures distortion, perspective and scale. The first image shows a printed grid on the gel. Further images, tilted or
    moved, improve the distortion only. The results are added to sensor.toml.

    \b
    Examples:
      gelform lens presses/ --image grid.png --grid 9x6 --pitch-mm 1
      gelform lens presses/sensor.toml --image flat.png --image tilted.png --grid 12x9 --pitch-mm 0.8 --dots
    """
    try:
        columns, rows = (int(count) for count in grid.split("x"))
    except ValueError:
        raise BadParameter(f"expected COLUMNSxROWS, got {grid!r}.", param_hint="--grid") from None
    from gelform.calibration.geometry.files import save_grid_view

    frames = [gelform.read_image(path) for path in images]
    with mistakes_in("--image, --grid"):
        found = gelform.view_from_grid(
            frames, pattern=(columns, rows), pitch_mm=pitch_mm, kind="dots" if dots else "checkerboard"
        )
    file = save_grid_view(found, place)
    shown.say(f"{found.describe()}.")
    shown.say(f"Wrote {file}.")
    known = {"mm_per_px": found.scale.mm_per_px, "mm_per_px_sigma": found.scale.sigma}
    shown.json({"file": file, "lens": found.describe(), **known, "residual_px": found.residual_px})


def crosstalk(
    *,
    place: Place,
    led_frames: Annotated[
        tuple[Path, Path, Path],
        Argument(metavar="R G B", help="Gel at rest under the red, green, blue LEDs alone."),
    ],
    bgr: Bgr = False,
    shown: ShownOption,
) -> None:
    """Measure the crosstalk of the colors, for `calibrate`.

    Each of three images shows the gel at rest under the LEDs of one color only. Their light in the other channels is
    added to sensor.toml.

    \b
    Examples:
      gelform crosstalk presses/ red.png green.png blue.png
      gelform crosstalk presses/sensor.toml red.png green.png blue.png --json
    """
    from gelform.calibration.geometry.files import save_crosstalk
    from gelform.sensors.files import read_sensor_toml

    settings = read_sensor_toml(place / "sensor.toml" if place.is_dir() else place)
    with mistakes_in("R G B"):
        frames = [gelform.read_image(path, bgr=bgr) for path in led_frames]
        found = gelform.crosstalk_from_frames(frames, response=settings.response)
    file = save_crosstalk(found, place)
    shown.say(f"{found.describe()}.")
    shown.say(f"Wrote {file}.")
    shown.json({"file": file, "crosstalk": found.describe(), "matrix": found.matrix})
