"""Keep calibrations in a folder; commands use the newest one with the camera's serial number.

If you give no calibration, `live`, `reconstruct`, `batch`, `bag` and `ros` search this folder and print their choice. The
guide of `gelform live` saves its calibration there. GELFORM_CALIBRATIONS names another folder.

\b
Examples:
  gelform calibrations list
  gelform calibrations add mini.npz --serial 2BKRXXXX
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import BadParameter, Option

import gelform
from gelform import DataError
from gelform.cli.console import ShownOption, print_json, printable
from gelform.cli.files import check_output
from gelform.cli.options import NewCalibration, Overwrite, argument

SUMMARY = "List, add, remove and export calibrations by serial."
COLUMNS = {
    "normal_free_deg": "normals (°)",
    "cap_free_um": "contact (um)",
    "off_contact_um": "off contact (um)",
}

Which = Annotated[str, argument("WHICH", "Serial, file name, or first characters of the digest.")]
Gel = Annotated[str | None, Option("--gel", metavar="GEL", help="Only calibrations of this gel.")]


def list_(
    *,
    serial: Annotated[str | None, Option(help="Only calibrations of this camera.")] = None,
    gel: Gel = None,
    shown: ShownOption,
) -> None:
    """List calibrations by serial, gel and date.

    The table shows their errors on held-out presses.

    The newest comes first; a camera uses the newest one with its serial number. Unreadable files are listed with the reason.

    \b
    Examples:
      gelform calibrations list
      gelform calibrations list --serial 2BKRXXXX --gel gel-3
      gelform calibrations list --json
    """
    from gelform.calibration import library
    from gelform.foundations.files import DIGEST_SHOWN

    folder = library.library_folder()
    there = [
        one for one in library.entries(folder) if serial in (None, one.serial) and gel in (None, one.gel_id)
    ]
    if shown.as_json:
        print_json({"folder": folder, "calibrations": [library.facts_of(one) for one in there]})
        return
    rows = [
        (
            one.sensor_name,
            one.serial,
            one.gel_id,
            library.date_of(one.created_utc),
            *map(one.held_out.get, COLUMNS),
            one.digest[:DIGEST_SHOWN],
        )
        for one in there
        if not one.problem
    ]
    columns = ("sensor", "serial", "gel", "made (UTC)", *COLUMNS.values(), "digest")
    shown.table(f"Calibrations in {folder}", columns, rows)
    for one in there:
        if one.problem:
            shown.say(f"damaged: {one.path.name}: {one.problem}")
    if not there:
        shown.say(f"No calibration is in {folder}. Add one: gelform calibrations add CAL.npz.")


def add(
    *,
    files: Annotated[list[Path], argument("CAL.npz...", "Files of calibrations.")],
    serial: Annotated[str | None, Option(help="Serial number of the camera, if the file lacks it.")] = None,
    gel: Annotated[
        str | None, Option("--gel", metavar="GEL", help="Name of the gel, if the file lacks it.")
    ] = None,
    shown: ShownOption,
) -> None:
    """Copy calibrations into the library.

    The file itself stays in its place. A calibration that is already in the library is not copied again.

    \b
    Examples:
      gelform calibrations add mini.npz
      gelform calibrations add mini.npz --serial 2BKRXXXX --gel gel-3
    """
    from gelform.calibration.library import add_calibration

    if serial is not None and len(files) > 1:
        raise BadParameter("belongs to one camera: add one file at a time.", param_hint="--serial")
    loaded = [_named(path, serial, gel) for path in files]  # a refused one leaves the library as it is
    added = []
    for calibration in loaded:
        path, new = add_calibration(calibration)
        shown.say(f"Added {path}." if new else f"Already in the library: {path}.")
        if not calibration.serial:
            shown.say(
                "It has no serial, so only a camera without one uses it automatically. Name its camera: --serial SERIAL."
            )
        added.append({"file": path, "new": new, "serial": calibration.serial, "gel_id": calibration.gel_id})
    shown.json({"added": added})


def _named(path: Path, serial: str | None, gel: str | None) -> gelform.Calibration:
    """The calibration with the user's serial number and gel; DataError if the file states others."""
    calibration = gelform.load_calibration(path)
    said: dict[str, Any] = {}
    for name, option, value in (("serial", "--serial", serial), ("gel_id", "--gel", gel)):
        known = getattr(calibration, name)
        if value and known and value != known:
            raise DataError(f"{path} is of {name} {known!r}, not of {value!r}. Leave {option} out.")
        if value:
            said[name] = value
    return replace(calibration, **said) if said else calibration


def remove(
    *,
    which: Which,
    gel: Gel = None,
    every: Annotated[bool, Option("--all", help="Delete all that match, if there are several.")] = False,
    yes: Annotated[bool, Option("--yes", "-y", help="Do not ask.")] = False,
    shown: ShownOption,
) -> None:
    """Delete calibrations from the library, after asking.

    \b
    Examples:
      gelform calibrations remove 1a2b3c4d5e
      gelform calibrations remove 2BKRXXXX --gel gel-2 --all --yes
    """
    from gelform.calibration.library import listed, matching, remove_calibration

    found = matching(which, gel)
    if len(found) > 1 and not every:
        raise DataError(f"{len(found)} calibrations match: {listed(found)}. Name one, or use --all.")
    if not yes:
        if sys.stdin is None:
            raise DataError("Expected a terminal to ask in. Use --yes to delete without a question.")
        typer.confirm(printable(f"Delete {listed(found)}?"), abort=True, err=True)
    for entry in found:
        remove_calibration(entry)
        shown.say(f"Deleted {entry.path}.")
    shown.json({"removed": [str(entry.path) for entry in found]})


def export_(
    *, which: Which, gel: Gel = None, output: NewCalibration, overwrite: Overwrite = False, shown: ShownOption
) -> None:
    """Copy the newest matching calibration out of the library.

    \b
    Examples:
      gelform calibrations export 2BKRXXXX -o mini.npz
      gelform calibrations export 2BKRXXXX --gel gel-2 -o gel-2.npz
    """
    from gelform.calibration.library import described, matching
    from gelform.foundations.files import written_file

    check_output(output, overwrite=overwrite)
    found = matching(which, gel)
    entry = next((one for one in found if not one.problem), None)
    if entry is None:
        raise DataError(f"{found[0].path.name} cannot be read: {found[0].problem}")
    with written_file(output, overwrite=overwrite) as handle:
        handle.write(entry.path.read_bytes())
    shown.say(f"Wrote {output}: {described(entry.path.name, entry)}.")
    shown.json({"file": output, "from": entry.path, "serial": entry.serial, "gel_id": entry.gel_id})


COMMANDS = (list_, add, remove, export_)
