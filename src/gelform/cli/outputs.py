"""Output files: unique names, checked before any work, and the files of a calibration's report."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelform.cli.console import check_pictures, json_bytes
from gelform.errors import DataError
from gelform.foundations.progress import Progress

if TYPE_CHECKING:
    from gelform.calibration.presses.folder import Presses
    from gelform.calibration_file import Calibration

REPORT_FILES = ("report.html", "report.json", "circles.csv")


def result_paths(inputs: Sequence[Path], folder: Path, formats: Sequence[str]) -> list[dict[str, Path]]:
    """The path of each input's result, in each format: `folder/<path below the common folder>.<format>`.

    If two inputs differ only in their suffix (a.png, a.jpg), the suffix stays in the name (a.png.npz, a.jpg.npz).

    Raises
    ------
    DataError
        An input is given twice, or two inputs would get the same name.
    """
    full = [Path(os.path.abspath(path)) for path in inputs]
    twice = [str(path) for path, count in Counter(full).items() if count > 1]
    if twice:
        raise DataError(f"{twice[0]} is given twice. Give each image once.")
    common = Path(os.path.commonpath([path.parent for path in full]))
    below = [path.relative_to(common) for path in full]
    stems = Counter(path.with_suffix("") for path in below)
    names = [path if stems[path.with_suffix("")] > 1 else path.with_suffix("") for path in below]
    shared = [str(name) for name, count in Counter(names).items() if count > 1]
    if shared:
        raise DataError(f"Two images would both be called {shared[0]}. Reconstruct them into two folders.")
    return [{one: folder / f"{name}.{one}" for one in formats} for name in names]


def check_results(paths: Sequence[dict[str, Path]], *, overwrite: bool, protected: Sequence[Path]) -> None:
    """Refuse results that exist (unless `overwrite`), and any that would replace an input.

    Temporary files of killed runs are deleted there.

    Raises
    ------
    DataError
        The message names the first existing result and their number.
    """
    from gelform.foundations.npz_files import sweep

    inputs = {os.path.realpath(path) for path in protected}
    results = [path for one in paths for path in one.values()]
    clashing = [path for path in results if os.path.realpath(path) in inputs]
    if clashing:
        raise DataError(f"The result {clashing[0]} would replace an input. Choose another folder with -o.")
    there = [path for path in results if os.path.lexists(path)]
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise DataError(f"{there[0]} is already there{more}. Choose another folder, or allow --overwrite.")
    for folder in {path.parent for path in results if path.parent.is_dir()}:
        sweep(folder)


def picture_paths(
    images: Sequence[Path], folder: Path | None, *, overwrite: bool, protected: Sequence[Path]
) -> list[Path | None]:
    """The path of each image's picture; None for each without a folder. Checked before any work.

    Raises
    ------
    DataError
        As `result_paths` and `check_results`.
    GelformError
        matplotlib is not installed.
    """
    if folder is None:
        return [None] * len(images)
    check_pictures()
    paths = result_paths(images, folder, ["png"])
    check_results(paths, overwrite=overwrite, protected=[*images, *protected])
    return [one["png"] for one in paths]


def check_output(path: Path, *, overwrite: bool) -> None:
    """Refuse a file name that cannot be written, before the work; a missing folder is made.

    Temporary files of killed runs in that folder are deleted.

    Raises
    ------
    DataError
        The name is a folder's, the file exists (unless `overwrite`), or nothing can be written there.
    """
    from gelform.foundations.npz_files import sweep

    if path.is_dir():
        raise DataError(f"Expected a file name, got the folder {path}. Add a name: {path / 'name'}.")
    if os.path.lexists(path) and not overwrite:
        raise DataError(f"{path} is already there. Choose another name, or allow --overwrite.")
    _check_room(make_folder(path.parent))
    sweep(path.parent)


def make_folder(folder: Path) -> Path:
    """Make a folder and its parents, and check that it is writable.

    Raises
    ------
    DataError
        The folder cannot be made or written to; the message says why.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError as problem:
        raise DataError(f"Expected a folder to write to, got the file {folder}.") from problem
    except OSError as problem:
        raise DataError(f"Cannot make the folder {folder}: {problem.strerror or problem}.") from problem
    if not os.access(folder, os.W_OK):
        _check_room(folder)
        raise DataError(f"Cannot write into {folder}: permission denied.")
    return folder


def _check_room(folder: Path) -> None:
    from gelform.exchange.exporters.folders import check_room

    try:
        check_room(folder)
    except OSError as problem:
        raise DataError(f"Cannot write into {folder}: {problem.strerror or problem}.") from problem


def check_report_folder(folder: Path, overwrite: bool) -> None:
    """Make the folder, and refuse one that contains a report (unless `overwrite`), before the work."""
    check_output(folder / REPORT_FILES[0], overwrite=True)
    there = [name for name in REPORT_FILES if (folder / name).exists()]
    if there and not overwrite:
        raise DataError(f"{folder / there[0]} is already there. Choose another folder, or allow --overwrite.")


def content_of(
    presses: Presses, calibration: Calibration, progress: Progress, *, with_learning: bool
) -> dict[str, Any]:
    """The report as numbers and text. The learning curve costs a dozen calibrations and adds a section."""
    import numpy as np

    from gelform.calibration.report.content import report_content
    from gelform.calibration.report.learning import learning_curve

    rng = np.random.default_rng(0)
    learning = learning_curve(presses, calibration, rng=rng, progress=progress) if with_learning else None
    return report_content(presses, calibration, rng=rng, learning=learning)


def write_report(
    content: dict[str, Any], presses: Presses, calibration: Calibration, folder: Path, *, overwrite: bool
) -> None:
    """Write the files of `--report`: the page, its numbers, and the circles as a table."""
    from gelform.calibration.report.page import report_page

    page = report_page(content, presses, calibration)
    files = (page.encode(), json_bytes(content), _circles_csv(calibration.report.presses))
    _write_all({folder / name: data for name, data in zip(REPORT_FILES, files)}, overwrite)


def _write_all(files: Mapping[Path, bytes], overwrite: bool) -> None:
    """Write all files or none: each gets its name only when the bytes of all are on the disk."""
    from gelform.foundations.npz_files import written_file

    make_folder(next(iter(files)).parent)
    with ExitStack() as stack:
        for path, data in files.items():
            handle = stack.enter_context(written_file(path, overwrite=overwrite))
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())


def _circles_csv(rows: Any) -> bytes:
    """The table of presses with the fitted circles, in the form of labels in presses.csv."""
    from gelform.foundations.tables import table_text

    named = ["image", "ball_diameter_mm", "center_x_px", "center_y_px", "contact_radius_px"]
    lines = [[*named, "center_sigma_px", "contact_radius_sigma_px", "accepted", "reason"]]
    for row in rows:
        circle = [f"{value:.2f}" for value in (row.center_x_px, row.center_y_px, row.contact_radius_px)]
        sigma = (row.center_sigma_px, row.contact_radius_sigma_px)
        known = ["" if value is None else f"{value:.2f}" for value in sigma]
        lines.append(
            [row.name, f"{row.ball_diameter_mm:g}", *circle, *known, f"{row.accepted:d}", row.reason or ""]
        )
    return table_text(lines).encode()
