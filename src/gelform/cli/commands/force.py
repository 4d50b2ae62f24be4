"""Calibrate force in newtons, and measure its errors.

Press objects with known loads, on a kitchen scale or with a gauge, and list the loads in loads.csv.

\b
Examples:
  gelform force calibrate loads/ -c cal.npz --overwrite
  gelform force evaluate more_loads/ -c cal.npz
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

import gelform
from gelform import CalibrationError
from gelform.cli import options
from gelform.cli.console import ShownOption, only_writer
from gelform.cli.files import check_output
from gelform.errors import counted

if TYPE_CHECKING:
    from gelform.calibration.loads import LoadedPresses

SUMMARY = "Calibrate force in newtons, and measure its errors."
Loads = Annotated[Path, options.argument("LOADS", "Folder of images with loads.csv.")]
UNITS = {"normal": "N", "shear": "N", "torsion": "N mm"}
SHARES = {  # parts of 1, shown as %
    "median": "median error (%)",
    "q90": "90 % below (%)",
    "within_1": "in 1 sigma (%)",
    "within_2": "in 2 (%)",
}


def calibrate(
    *,
    loads: Loads,
    calibration: options.CalibrationFile,
    output: Annotated[
        Path | None, options.output("CAL.npz", "The calibration to write. Default: -c, with --overwrite.")
    ] = None,
    background: options.Background = None,
    bgr: options.Bgr = False,
    sure_of_unit: Annotated[
        bool, Option("--sure-of-unit", help="The loads are newtons, though the gel seems too hard or soft.")
    ] = False,
    overwrite: options.Overwrite = False,
    shown: ShownOption,
) -> None:
    """Add force in newtons to a calibration.

    LOADS has images and loads.csv with the columns image,object,force_n; for shear also force_x_n,force_y_n. Three hard
    objects, three or four loads each from 1 to 10, are good. Loads are in newtons: grams times 0.00981.

    \b
    Examples:
      gelform force calibrate loads/ -c cal.npz --overwrite
      gelform force calibrate loads/ -c cal.npz -o with_force.npz
    """
    output = output or calibration
    check_output(output, overwrite=overwrite)
    from gelform.calibration.loads import LAGS
    from gelform.depth.force import LEAST_OBJECTS

    loaded = gelform.load_calibration(calibration)
    with only_writer(output):
        found = _read(loads, loaded, shown, background=background, bgr=bgr)
        if found.lag_frames in (LAGS[0], LAGS[-1]):
            shown.say(
                f"warning: a lag of {counted(found.lag_frames, 'frame')} is at the end of the range that was "
                "tried, so it is doubtful. "
                "Check the times, or write the lag into a column lag_frames of loads.csv."
            )
        fitted = gelform.calibrate_force(found.touches, found.loads, sure_of_unit=sure_of_unit)
        model = replace(fitted, lag_frames=found.lag_frames)
        replace(loaded, force=model).save(output, overwrite=overwrite)
    described = model.to_dict()
    for kind, unit in UNITS.items():
        if part := described[kind]:
            off = f"{100 * part['relative']:.0f} % and {part['floor']:.2g} {unit}"
            shown.say(f"{kind}: {counted(part['loads'], 'load')}, one standard deviation {off}.")
    if (objects := len(model.objects)) < LEAST_OBJECTS:
        shown.say(
            f"Only {'one object was' if objects == 1 else 'two objects were'} pressed, so at least 30 % are stated. Press "
            f"{LEAST_OBJECTS - objects} more of another shape."
        )
    shown.say(f"Wrote {output}.")
    shown.json({"calibration": output, **described, "lag_frames": found.lag_frames})


def evaluate(
    *,
    loads: Loads,
    calibration: options.CalibrationFile,
    background: options.Background = None,
    bgr: options.Bgr = False,
    shown: ShownOption,
) -> None:
    """Measure the errors of a calibration's forces.

    A film's lag is that of its table, else of the calibration's recordings; it is not fitted to these loads. The errors of
    the best constant stand beside them: a gripper that always stops at one force makes any constant look good.

    \b
    Examples:
      gelform force evaluate more_loads/ -c cal.npz
      gelform force evaluate more_loads/ -c cal.npz --json > errors.json
    """
    from gelform.depth.force import NO_LOADS, sigma_ratio

    loaded = gelform.load_calibration(calibration)
    if loaded.force is None:
        raise CalibrationError(f"{calibration} states no forces: {NO_LOADS}.")
    lag = loaded.force.lag_frames or 0
    found = _read(loads, loaded, shown, background=background, bgr=bgr, lag_frames=lag)
    errors = gelform.evaluate_force(loaded.force, found.touches, found.loads)
    worse = []
    for kind, unit in UNITS.items():
        columns = (
            "object",
            "presses",
            "refused (%)",
            f"mean error ({unit})",
            f"a constant's ({unit})",
            *SHARES.values(),
        )
        shown.table(f"Errors of the force: {kind}", columns, map(_row, errors[kind]))
        for row in errors[kind][-1:]:  # of all objects
            if (off := row.get("mae", 0.0)) > (constant := row.get("constant", {}).get("mae", 0.0)):
                worse.append(
                    f"The mean error of the {kind} force is {off:.3g} {unit}, larger than that of a constant, "
                    f"{constant:.3g} {unit}: it says nothing about these loads. Calibrate again, with these objects too."
                )
    shown.table("Without a normal force", ("reason", "presses"), errors["reasons"].items())
    ratio = sigma_ratio(loaded.force, found.touches, found.loads)
    if ratio is not None:
        remedy = " Calibrate again, with these objects too." if ratio >= 1.5 else ""  # larger than stated
        shown.say(f"Errors of the normal force are {ratio:.2g} times the stated sigma.{remedy}")
    for said in worse:
        shown.say(said)
    shown.json({"lag_frames": found.lag_frames, "errors_over_sigma": ratio, **errors})


def _read(folder: Path, calibration: gelform.Calibration, shown: ShownOption, **given: Any) -> LoadedPresses:
    with shown.progress() as progress:
        found = gelform.read_loads(folder, calibration, progress=progress, **given)
    if found.lag_frames is not None:
        shown.say(
            f"The gauge lags behind the images by {counted(found.lag_frames, 'frame')}; this is removed."
        )
    return found


def _row(row: Mapping[str, Any]) -> Sequence[Any]:
    errors = row.get("mae"), row.get("constant", {}).get("mae")
    shares = [None if row.get(name) is None else 100 * row[name] for name in ("refused", *SHARES)]
    return row["object"], row["presses"], shares[0], *errors, *shares[1:]


COMMANDS = (calibrate, evaluate)
