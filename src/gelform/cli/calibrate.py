"""gelform calibrate: presses of a ball to a calibration."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gelform.cli.console import (
    Background,
    BallDiameter,
    Crop,
    Json,
    MmPerPx,
    Overwrite,
    Quiet,
    Sensor,
    figure,
    json_bytes,
    print_json,
    progress_shown,
    say,
    show_table,
    warm,
)
from gelform.cli.geometry import (
    Grid,
    LedFrames,
    LensImages,
    PitchMm,
    Punch,
    ScalePoints,
    Stage,
    Thread,
    grid_view,
    is_scale_asked,
    measured,
)
from gelform.cli.names import make_folder
from gelform.errors import CalibrationError, DataError
from gelform.progress import Progress

if TYPE_CHECKING:
    from gelform.calibration.presses.folder import Presses
    from gelform.calibration_file import Calibration

REPORT_FILES = ("report.html", "report.json", "circles.csv")
REPORT_SEED = 0


def calibrate(
    presses: Annotated[Path, typer.Argument(metavar="PRESSES", help="Ball presses: a folder or a video.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="CAL.npz", help="The calibration to write.")
    ],
    model: Annotated[
        str, typer.Option(help="Color model; auto chooses by errors on held-out presses.")
    ] = "auto",
    start: Annotated[
        Path | None,
        typer.Option(
            metavar="CAL.npz", help="Calibration of another unit of this sensor to begin with: 5 presses do."
        ),
    ] = None,
    sensor: Sensor = None,
    mm_per_px: MmPerPx = None,
    ball_diameter_mm: BallDiameter = None,
    background: Background = None,
    crop: Crop = None,
    scale_points: ScalePoints = None,
    punch: Punch = None,
    thread: Thread = None,
    stage: Stage = None,
    led_frames: LedFrames = None,
    lens_images: LensImages = None,
    grid: Grid = None,
    pitch_mm: PitchMm = None,
    report: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for a page that says how good it is and what to do next."),
    ] = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Calibrate a sensor from presses of a ball of known diameter, without a click.

    PRESSES holds background.png (the untouched gel), images, presses.csv (columns image,ball_diameter_mm) and
    sensor.toml (name, mm_per_px). A plain folder of images does too, with --ball-diameter-mm and --mm-per-px
    or --sensor; so do a video that begins with the untouched gel, gs_sdk's and py3DCal's folders and Taxim's
    dataPack.npz. Twenty presses all over the gel are enough, forty of two balls are good.

    \b
    Examples:
      gelform calibrate presses/ -o cal.npz
      gelform calibrate presses/ -o cal.npz --report report/
      gelform calibrate frames/ -o cal.npz --sensor gelsight-mini --ball-diameter-mm 6.35
      gelform calibrate presses.avi -o cal.npz --sensor gelsight-mini --ball-diameter-mm 6.35
      gelform calibrate frames/ -o cal.npz --mm-per-px 0.05 --ball-diameter-mm 4 --crop 20,10,600,450
      gelform calibrate presses/ -o cal.npz --punch punch.png,5 --led-frames red.png green.png blue.png
      gelform calibrate five_presses/ -o second.npz --start first.npz
      gelform calibrate presses/ -o cal.npz --lens-images grid.png --grid 9x6 --pitch-mm 1
    """
    _check_model(model)
    box = _crop(crop)
    _check_outputs(output, report, overwrite)
    lens = grid_view(lens_images, grid, pitch_mm)
    scale_asked = is_scale_asked(scale_points, punch, thread, stage, lens)
    if scale_asked and mm_per_px is not None:
        raise typer.BadParameter("expected no other source of the scale beside it.", param_hint="--mm-per-px")
    from gelform.calibration.fit import calibrate as calibrate_presses
    from gelform.calibration.presses.folder import read_presses
    from gelform.calibration_file import load_calibration

    with progress_shown(quiet) as progress:
        warm(progress)
        found = read_presses(
            presses,
            sensor=sensor,
            mm_per_px=1.0 if scale_asked else mm_per_px,  # measured below, in the images that are read here
            ball_diameter_mm=ball_diameter_mm,
            background=background,
            crop=box,
            progress=progress,
        )
        found = measured(
            found,
            points=scale_points,
            punch=punch,
            thread=thread,
            stage=stage,
            led_frames=led_frames,
            grid=lens,
        )
        first = None if start is None else load_calibration(start)
        calibration = calibrate_presses(found, color_model=model, start=first, progress=progress)
        calibration.save(output, overwrite=overwrite)
        if report is not None:
            write_report(found, calibration, report, overwrite=overwrite, progress=progress)
    _show(calibration, quiet or as_json)
    say(f"Wrote {output}{f' and {report / REPORT_FILES[0]}' if report else ''}.", quiet)
    if as_json:
        print_json({"calibration": str(output), **calibration.report.to_dict()})


def write_report(
    presses: Presses,
    calibration: Calibration,
    folder: Path,
    *,
    overwrite: bool,
    progress: Progress,
    with_learning: bool = True,
) -> None:
    """Write what `--report` promises: the page, the numbers behind it, and the circles as a table.

    The learning curve calibrates a dozen times more; without it the page says less and comes sooner.
    """
    import numpy as np

    from gelform.calibration.report.content import report_content
    from gelform.calibration.report.learning import learning_curve
    from gelform.calibration.report.page.page import report_page
    from gelform.npz_files import written_file

    rng = np.random.default_rng(REPORT_SEED)
    learning = learning_curve(presses, calibration, rng=rng, progress=progress) if with_learning else None
    progress(0, 1, "drawing the report")
    content = report_content(presses, calibration, rng=rng, learning=learning)
    page = report_page(content, presses, calibration)
    make_folder(folder)
    files = (page.encode(), json_bytes(content), _circles_csv(calibration.report.presses))
    for name, data in zip(REPORT_FILES, files):
        with written_file(folder / name, overwrite=overwrite) as file:
            file.write(data)
    progress(1, 1, "drawing the report")


def _check_model(model: str) -> None:
    from gelform.calibration.selection.candidates import color_model_names

    if model not in color_model_names():
        raise typer.BadParameter(
            f"expected one of {', '.join(color_model_names())}, got {model!r}.", param_hint="--model"
        )


def _crop(text: str | None) -> tuple[float, float, float, float] | None:
    if text is None:
        return None
    try:
        left, top, width, height = (float(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(
            f"expected LEFT,TOP,WIDTH,HEIGHT in px, got {text!r}.", param_hint="--crop"
        ) from None
    return left, top, width, height


def _check_outputs(output: Path, report: Path | None, overwrite: bool) -> None:
    """Everything that could stop the writing is said before the work."""
    from gelform.npz_files import check_free

    make_folder(output.parent)
    check_free(output, overwrite=overwrite, error=CalibrationError)
    if report is None:
        return
    make_folder(report)
    there = [name for name in REPORT_FILES if (report / name).exists()]
    if there and not overwrite:
        raise DataError(f"{report / there[0]} is already there. Choose another folder, or allow --overwrite.")


def _circles_csv(rows: Any) -> bytes:
    """The table of presses with the circles found: as presses.csv wants its labels."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    named = ["image", "ball_diameter_mm", "center_x_px", "center_y_px", "contact_radius_px"]
    writer.writerow([*named, "center_sigma_px", "contact_radius_sigma_px", "accepted", "reason"])
    for row in rows:
        circle = [f"{value:.2f}" for value in (row.center_x_px, row.center_y_px, row.contact_radius_px)]
        sigma = (row.center_sigma_px, row.contact_radius_sigma_px)
        known = ["" if value is None else f"{value:.2f}" for value in sigma]
        writer.writerow(
            [row.name, f"{row.ball_diameter_mm:g}", *circle, *known, int(row.accepted), row.reason or ""]
        )
    return text.getvalue().encode()


def _show(calibration: Calibration, quiet: bool) -> None:
    report = calibration.report
    rejected = [(row.name, row.reason or "") for row in report.presses if not row.accepted]
    used = len(report.presses) - len(rejected)
    say(
        f"{calibration.sensor_name}: {used} of {len(report.presses)} presses used, {report.seconds:.0f} s.",
        quiet,
    )
    if rejected:
        show_table("Presses left out", ("press", "why"), rejected, quiet=quiet)
    tried = [
        (one["candidate"] + (" <" if one["chosen"] else ""), figure(one["normal_free_deg"]))
        for one in report.candidates
    ]
    show_table("Color models tried", ("model (< chosen)", "held-out normal (deg)"), tried, quiet=quiet)
    held_out = [(name, figure(value)) for name, value in report.held_out.items()]
    show_table("Errors on presses that were held out", ("figure", "value"), held_out, quiet=quiet)
    for note in report.notes:
        say(f"note: {note}", quiet)
