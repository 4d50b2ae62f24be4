"""Options of `calibrate` that measure a sensor beside its presses: scale, crosstalk, lens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from gelform.calibration.geometry.lens import GridView
    from gelform.calibration.geometry.scale import Scale
    from gelform.calibration.presses.folder import Presses

ScalePoints = Annotated[
    str | None,
    typer.Option(metavar="X1,Y1,X2,Y2,MM", help="Scale: two marked points, px, and their distance."),
]
Punch = Annotated[
    str | None, typer.Option(metavar="IMG,MM", help="Scale: press of a flat, round punch and its diameter.")
]
Thread = Annotated[str | None, typer.Option(metavar="IMG,MM", help="Scale: press of a thread and its pitch.")]
Stage = Annotated[
    str | None, typer.Option(metavar="A,B,MM", help="Scale: one thing pressed twice, a stage's step apart.")
]
LedFrames = Annotated[
    tuple[Path, Path, Path] | None,
    typer.Option(
        metavar="R G B", help="Untouched gel with the red, green, blue LEDs alone: crosstalk is undone."
    ),
]
LensImages = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="IMG", help="Grid on the gel, whole frames (may be repeated): lens undone, and scale."
    ),
]
Grid = Annotated[
    str | None,
    typer.Option(metavar="CxR[,dots]", help="Its inner corners, such as 9x6; with ,dots a grid of dots."),
]
PitchMm = Annotated[float | None, typer.Option(metavar="F", help="Its pitch, mm.")]


def is_scale_asked(*options: Any) -> bool:
    """Whether some option will tell the scale, so that none is needed from the folder."""
    return any(option is not None and option != [] for option in options)


def measured(
    presses: Presses,
    *,
    points: str | None,
    punch: str | None,
    thread: str | None,
    stage: str | None,
    led_frames: tuple[Path, Path, Path] | None,
    grid: GridView | None,
) -> Presses:
    """The presses with what the options measure: first the lens, then crosstalk and scale in its images."""
    from gelform.calibration.geometry.crosstalk import crosstalk_from_frames
    from gelform.calibration.geometry.scale import combined_scale
    from gelform.calibration.presses.adjust import with_crosstalk, with_scale, with_view
    from gelform.sensors.files import read_image

    if grid is not None:
        presses = with_view(presses, grid.view, grid.describe())
    scales = [] if grid is None else [grid.scale]
    if points is not None:
        scales.append(_scale_of_points(points))
    scales += _scales_of_images(presses, punch, thread, stage)
    if scales:
        presses = with_scale(presses, combined_scale(scales))
    if led_frames:
        frames = [read_image(path) for path in led_frames]
        presses = with_crosstalk(presses, crosstalk_from_frames(frames, response=presses.response))
    return presses


def grid_view(images: list[Path] | None, grid: str | None, pitch_mm: float | None) -> GridView | None:
    """The view that --lens-images, --grid and --pitch-mm tell together."""
    if not images:
        if grid is not None or pitch_mm is not None:
            raise typer.BadParameter(
                "expected --lens-images beside --grid and --pitch-mm.", param_hint="--grid"
            )
        return None
    if grid is None or pitch_mm is None:
        raise typer.BadParameter("expected --grid and --pitch-mm beside it.", param_hint="--lens-images")
    from gelform.calibration.geometry.lens import view_from_grid
    from gelform.sensors.files import read_image

    size, _, kind = grid.partition(",")
    try:
        columns, rows = (int(count) for count in size.split("x"))
    except ValueError:
        raise typer.BadParameter(f"expected COLUMNSxROWS, got {grid!r}.", param_hint="--grid") from None
    if kind not in ("", "dots"):
        raise typer.BadParameter(
            f"expected nothing or dots behind the comma, got {kind!r}.", param_hint="--grid"
        )
    frames = [read_image(path) for path in images]
    return view_from_grid(
        frames, pattern=(columns, rows), pitch_mm=pitch_mm, kind="dots" if kind else "checkerboard"
    )


def _scale_of_points(text: str) -> Scale:
    from gelform.calibration.geometry.scale import scale_from_points

    x1, y1, x2, y2, mm = _numbers(text.split(","), 5, "X1,Y1,X2,Y2,MM", "--scale-points", text)
    return scale_from_points((x1, y1), (x2, y2), mm)


def _scales_of_images(
    presses: Presses, punch: str | None, thread: str | None, stage: str | None
) -> list[Scale]:
    from gelform.calibration.geometry.scale_images import scale_from_punch, scale_from_thread
    from gelform.calibration.geometry.scale_stage import scale_from_stage

    scales = []
    if punch is not None:
        (image,), mm = _images(presses, punch, 1, "--punch")
        scales.append(scale_from_punch(image, presses.background, mm))
    if thread is not None:
        (image,), mm = _images(presses, thread, 1, "--thread")
        scales.append(scale_from_thread(image, presses.background, mm))
    if stage is not None:
        (first, second), mm = _images(presses, stage, 2, "--stage")
        scales.append(scale_from_stage(first, second, presses.background, mm))
    return scales


def _images(presses: Presses, text: str, count: int, option: str) -> tuple[list[Any], float]:
    """Images through the presses' view, and the length behind them."""
    from gelform.sensors.files import read_image
    from gelform.view import image_from_frame

    *paths, last = text.split(",")
    wanted = "IMG,MM" if count == 1 else "A,B,MM"
    if len(paths) != count:
        raise typer.BadParameter(f"expected {wanted}, got {text!r}.", param_hint=option)
    (mm,) = _numbers([last], 1, wanted, option, text)
    return [image_from_frame(read_image(path), presses.view) for path in paths], mm


def _numbers(parts: list[str], count: int, wanted: str, option: str, text: str) -> list[float]:
    try:
        numbers = [float(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise typer.BadParameter(f"expected {wanted}, got {text!r}.", param_hint=option)
    return numbers
