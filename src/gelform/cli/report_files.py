"""The files of a calibration's report: the page, the numbers behind it, and the circles as a table."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelform.cli.console import json_bytes
from gelform.cli.result_names import check_output, make_folder
from gelform.errors import DataError
from gelform.progress import Progress

if TYPE_CHECKING:
    from gelform.calibration.presses.folder import Presses
    from gelform.calibration_file import Calibration

REPORT_FILES = ("report.html", "report.json", "circles.csv")
REPORT_SEED = 0


def check_report_folder(folder: Path, overwrite: bool) -> None:
    """Make the folder, and refuse one that holds a report (unless `overwrite`): before the work, not after it."""
    check_output(folder / REPORT_FILES[0], overwrite=True)
    there = [name for name in REPORT_FILES if (folder / name).exists()]
    if there and not overwrite:
        raise DataError(f"{folder / there[0]} is already there. Choose another folder, or allow --overwrite.")


def content_of(
    presses: Presses, calibration: Calibration, progress: Progress, *, with_learning: bool
) -> dict[str, Any]:
    """The report in numbers and words; with the learning curve, which calibrates a dozen times more, it says more."""
    import numpy as np

    from gelform.calibration.report.content import report_content
    from gelform.calibration.report.learning import learning_curve

    rng = np.random.default_rng(REPORT_SEED)
    learning = learning_curve(presses, calibration, rng=rng, progress=progress) if with_learning else None
    return report_content(presses, calibration, rng=rng, learning=learning)


def write_report(
    content: dict[str, Any], presses: Presses, calibration: Calibration, folder: Path, *, overwrite: bool
) -> None:
    """Write what `--report` promises: the page, the numbers behind it, and the circles as a table."""
    from gelform.calibration.report.page.page import report_page

    page = report_page(content, presses, calibration)
    files = (page.encode(), json_bytes(content), _circles_csv(calibration.report.presses))
    _write_all({folder / name: data for name, data in zip(REPORT_FILES, files)}, overwrite)


def _write_all(files: Mapping[Path, bytes], overwrite: bool) -> None:
    """Write all the files or none: each takes its name only when the bytes of all are on the disk."""
    from gelform.npz_files import written_file

    make_folder(next(iter(files)).parent)
    with ExitStack() as stack:
        for path, data in files.items():
            handle = stack.enter_context(written_file(path, overwrite=overwrite))
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())


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
