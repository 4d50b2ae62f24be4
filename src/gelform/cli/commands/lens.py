"""gelform lens: what the camera does to the picture, from images of a grid and of single LEDs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from gelform.cli.console import print_json, say
from gelform.cli.failures import mistakes_in
from gelform.cli.options import Json, Quiet, positive


def lens(
    place: Annotated[
        Path, typer.Argument(metavar="PLACE", help="Press folder, or its sensor.toml, to write into.")
    ],
    images: Annotated[
        list[Path] | None,
        typer.Option("--image", metavar="IMG", help="The grid on the gel, a whole frame; may be repeated."),
    ] = None,
    grid: Annotated[
        str | None, typer.Option(metavar="CxR", help="Its inner corners, such as 9x6; or its dots.")
    ] = None,
    pitch_mm: Annotated[
        float | None, typer.Option(metavar="F", parser=positive, help="Its pitch, mm.")
    ] = None,
    dots: Annotated[bool, typer.Option("--dots", help="It is a grid of dots, not a checkerboard.")] = False,
    led_frames: Annotated[
        tuple[Path, Path, Path] | None,
        typer.Option(
            metavar="R G B", help="Untouched gel with the red, green, blue LEDs alone: crosstalk is undone."
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure the lens (distortion, perspective, scale) and the crosstalk of the colours, for `calibrate` to undo.

    The first image shows a printed grid that lies on the gel; further ones, tilted or moved, help with the
    distortion alone. All are written into sensor.toml, beside what is there.

    \b
    Examples:
      gelform lens presses/ --image grid.png --grid 9x6 --pitch-mm 1
      gelform lens presses/sensor.toml --image flat.png --image tilted.png --grid 12x9 --pitch-mm 0.8 --dots
      gelform lens presses/ --led-frames red.png green.png blue.png
    """
    asked = [images, grid, pitch_mm]
    if any(asked) and not all(asked):
        raise typer.BadParameter("expected all three or none.", param_hint="--image, --grid, --pitch-mm")
    if not images and led_frames is None:
        raise typer.BadParameter("expected --image or --led-frames.", param_hint="lens")
    said: dict[str, Any] = {}
    if images and grid is not None and pitch_mm is not None:
        said |= _write_grid(place, images, _columns_rows(grid), pitch_mm, "dots" if dots else "checkerboard")
    if led_frames is not None:
        said |= _write_crosstalk(place, led_frames)
    for text in (said.get("lens"), said.get("crosstalk")):
        say(f"{text}." if text else "", quiet or not text)
    say(f"Wrote {said['file']}.", quiet)
    if as_json:
        print_json(said)


def _columns_rows(text: str) -> tuple[int, int]:
    try:
        columns, rows = (int(count) for count in text.split("x"))
    except ValueError:
        raise typer.BadParameter(f"expected COLUMNSxROWS, got {text!r}.", param_hint="--grid") from None
    return columns, rows


def _write_grid(
    place: Path, images: list[Path], pattern: tuple[int, int], pitch_mm: float, kind: Any
) -> dict[str, Any]:
    from gelform.calibration.geometry.files import save_grid_view
    from gelform.calibration.geometry.lens import view_from_grid
    from gelform.sensors.files import read_image

    frames = [read_image(path) for path in images]
    with mistakes_in("--image, --grid"):
        found = view_from_grid(frames, pattern=pattern, pitch_mm=pitch_mm, kind=kind)
    file = save_grid_view(found, place)
    scale = {"mm_per_px": found.scale.mm_per_px, "mm_per_px_sigma": found.scale.sigma}
    return {"file": file, "lens": found.describe(), **scale, "residual_px": found.residual_px}


def _write_crosstalk(place: Path, led_frames: tuple[Path, Path, Path]) -> dict[str, Any]:
    from gelform.calibration.geometry.crosstalk import crosstalk_from_frames
    from gelform.calibration.geometry.files import save_crosstalk
    from gelform.sensors.files import read_image, read_sensor_toml

    settings = read_sensor_toml(place / "sensor.toml" if place.is_dir() else place)
    with mistakes_in("--led-frames"):
        found = crosstalk_from_frames([read_image(path) for path in led_frames], response=settings.response)
    return {"file": save_crosstalk(found, place), "crosstalk": found.describe(), "matrix": found.matrix}
