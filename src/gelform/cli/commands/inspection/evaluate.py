"""gelform evaluate: errors of a calibration on presses."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gelform.cli.console import figure, print_json, progress_shown, say, show_table
from gelform.cli.options import Background, BallDiameter, CalibrationFile, Json, MmPerPx, Quiet, Sensor
from gelform.errors import DataError

if TYPE_CHECKING:
    from gelform.calibration.presses.press_set import Presses
    from gelform.calibration_file import Calibration

COLUMNS = {  # of the table, which fits 80 columns
    "normal_free_deg": "normal °",
    "cap_free_um": "cap um",
    "radius_percent": "radius %",
    "off_contact_um": "off um",
}
SEEN = (
    "Their errors say little of new ones; they may even be larger than those that `calibrate` reports of held-out "
    "presses, since it fits all circles together and here each is found in its own image."
)


def evaluate(
    presses: Annotated[Path, typer.Argument(metavar="PRESSES", help="Folder of ball presses.")],
    calibration: CalibrationFile,
    sensor: Sensor = None,
    mm_per_px: MmPerPx = None,
    ball_diameter_mm: BallDiameter = None,
    background: Background = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Measure a calibration on presses of a ball: angles in degrees, depth in um, radius in percent.

    Says which presses the calibration was made from: their errors say little.

    \b
    Examples:
      gelform evaluate new_presses/ -c cal.npz
      gelform evaluate new_presses/ -c cal.npz --json > errors.json
      gelform evaluate frames/ -c cal.npz --sensor gelsight-mini --ball-diameter-mm 6.35
    """
    from gelform.calibration.evaluate import evaluate as evaluate_presses
    from gelform.calibration.presses.folder import read_presses
    from gelform.calibration_file import load_calibration

    loaded = load_calibration(calibration)
    with progress_shown(quiet) as progress:
        found = read_presses(
            presses,
            sensor=sensor,
            mm_per_px=mm_per_px,
            ball_diameter_mm=ball_diameter_mm,
            background=background,
            progress=progress,
        )
        _check_size(found, loaded)
        evaluation = evaluate_presses(loaded, found, progress=progress)
    if evaluation.seen:
        say(f"warning: the calibration was made from {evaluation.seen} of these presses. {SEEN}")
    whose = "the calibration's own" if evaluation.own_background else "another than the calibration's"
    say(f"Background: {whose}.", quiet)
    for message in evaluation.findings:
        say(f"warning: {message}")
    if as_json:
        print_json(evaluation.to_dict())
        return
    rows = [
        (
            f"{row['name']}{' (seen)' if row['seen'] else ''}",
            f"{row['ball_diameter_mm']:g}",
            *(figure(row["errors"][name]) if row["reason"] is None else "-" for name in COLUMNS),
        )
        for row in evaluation.rows
    ]
    show_table("Presses", ("press", "ball mm", *COLUMNS.values()), rows, quiet=quiet)
    left_out = [(row["name"], row["reason"]) for row in evaluation.rows if row["reason"] is not None]
    if left_out:
        show_table("Presses left out", ("press", "why"), left_out, quiet=quiet)
    show_table(
        "Over all presses",
        ("figure", "value"),
        [(n, figure(v)) for n, v in evaluation.summary.items()],
        quiet=quiet,
    )
    _show_where(evaluation.where, quiet)
    if evaluation.flats:
        heights = [_height_row(**flat) for flat in evaluation.flats]
        show_table("Flat punches", ("press", "height mm", "read mm", "%"), heights, quiet=quiet)


def _height_row(name: str, height_mm: float, read_mm: float | None) -> tuple[str, str, str, str]:
    if read_mm is None:
        return name, f"{height_mm:g}", "-", "-"
    return name, f"{height_mm:g}", f"{read_mm:.3f}", figure(100 * read_mm / height_mm)


def _show_where(where: dict[str, Any], quiet: bool) -> None:
    """Normal errors by the ball's slope, and by place: inside the contact's edge and up to the visible rim."""
    to_rim = {b["slope_from"]: b for b in where["rim"]["by_slope"]}
    title = f"Normal error, degrees, by the ball's slope (edge at {where['contact_radius_ratio']:.2f} of the visible radius)"
    rows = [
        (
            f"{b['slope_from']:g}-{b['slope_to']:g}",
            figure(b["normal_deg"]),
            figure(b["gain"]),
            figure(to_rim[b["slope_from"]]["normal_deg"]) if b["slope_from"] in to_rim else "-",
            str(b["pixels"]),
        )
        for b in where["contact"]["by_slope"]
    ]
    show_table(title, ("slope", "contact", "gain", "up to the rim", "pixels"), rows, quiet=quiet)
    places = where["contact"]["by_place"]
    cells = [
        f"{_degrees(whole)} / {_degrees(part)}"
        for whole, part in zip(places["normal_deg"], where["rim"]["by_place"]["normal_deg"])
    ]
    columns = places["columns"]
    grid = [tuple(cells[k : k + columns]) for k in range(0, len(cells), columns)]
    title = "Normal error, degrees, by place in the image: contact / up to the rim"
    show_table(title, tuple(f"column {k + 1}" for k in range(columns)), grid, quiet=quiet)


def _degrees(value: float | None) -> str:
    return "-" if value is None else figure(value)


def _check_size(presses: Presses, calibration: Calibration) -> None:
    """Images of the calibration's size, or frames of its view."""
    frame, sizes = calibration.view.frame_shape, [calibration.image_shape]
    if frame is not None and frame not in sizes:
        sizes.append(frame)
    if presses.image_shape not in sizes:
        named = " or ".join(f"{height}x{width}" for height, width in sizes)
        got = f"{presses.image_shape[0]}x{presses.image_shape[1]}"
        raise DataError(f"{presses.folder}: Expected images of {named} px (height x width), got {got}.")
