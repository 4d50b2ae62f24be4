"""What is written once all parts are done: the form's own file of everything, the table, the contact sheet."""

from __future__ import annotations

from pathlib import Path

from gelform.batch.manifest import Manifest
from gelform.batch.outputs.writers import finish_of
from gelform.batch.records import files_of
from gelform.batch.sheet import NAME as SHEET
from gelform.batch.sheet import sheet_bytes, write_sheet
from gelform.batch.table import TABLES, table_is_whole, tables_there, write_table


def finish(output: Path, manifest: Manifest, table: str, source: Path, *, again: bool) -> None:
    """Write what is not there yet, all of it where parts were done in this run (`again`).

    Parameters
    ----------
    table : a form of TABLES
    source : the folder of the input
    """
    last, parts = finish_of(manifest.settings["form"]), manifest.parts
    if again or last.missing(output):
        last.write(output, files_of(output, parts), source)
    if again or not (output / TABLES[table]).exists():
        write_table(output, parts, table)
    if again or not (output / SHEET).exists():
        write_sheet(output, manifest)


def problems_of_finish(output: Path, manifest: Manifest) -> list[Path]:
    """Files of it that are missing, or do not say what the parts say."""
    parts = manifest.parts
    wrong = finish_of(manifest.settings["form"]).wrong(output, files_of(output, parts))
    tables = tables_there(output)
    bad = [output / TABLES[one] for one in tables if not table_is_whole(output, parts, one)]
    if not tables:
        bad.append(output / TABLES["csv"])
    sheet = output / SHEET
    if (sheet.read_bytes() if sheet.is_file() else b"") != sheet_bytes(output, manifest):
        bad.append(sheet)
    return [path for path in (wrong, *bad) if path is not None]
