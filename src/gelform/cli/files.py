"""Files of commands: images of a calibrated sensor in, and outputs under unique names, checked before any work."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelform.cli.console import check_pictures, json_bytes, say
from gelform.cli.options import STARTERS
from gelform.cli.process import mistakes_in
from gelform.errors import CalibrationError, DataError, GelformError
from gelform.foundations.findings import Progress

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gelform.calibration.library.library import Unit
    from gelform.calibration.presses.folder import Presses
    from gelform.calibration_file import Calibration
    from gelform.cli.options import CalibrationOptions
    from gelform.reconstruct import Reconstructor
    from gelform.result import Reconstruction

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
    from gelform.foundations.files import sweep

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
    from gelform.foundations.files import sweep

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
    from gelform.exchange.exporters.press_folder import check_room

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
    from gelform.foundations.files import written_file

    make_folder(next(iter(files)).parent)
    with ExitStack() as stack:
        for path, data in files.items():
            handle = stack.enter_context(written_file(path, overwrite=overwrite))
            handle.write(data)
            handle.flush()
            os.fsync(handle.fileno())


def _circles_csv(rows: Any) -> bytes:
    """The table of presses with the fitted circles, in the form of labels in presses.csv."""
    from gelform.foundations.files import table_text

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


def images_of(inputs: Sequence[Path], background: Path | None) -> list[Path]:
    """The images of files and folders, without the background; DataError for a video or another file of several."""
    images, film = images_or_film(inputs, background)
    if film is not None:
        holds = ", which also holds a video or a recording: name its images" if film.is_dir() else ""
        raise DataError(
            f"Expected images, got {film}{holds}. Its frames: gelform batch, or gelform reconstruct."
        )
    return images


def images_or_film(
    inputs: Sequence[Path], background: Path | None, dataset: str = ""
) -> tuple[list[Path], Path | None]:
    """The images of files, folders and patterns; or the one video, recording or file of several images among them."""
    import glob

    from gelform.batch.containers import is_container
    from gelform.batch.inputs import listing_of
    from gelform.sensors.files import FILM_SUFFIXES, is_stack

    images: list[Path] = []
    leave_out = [] if background is None else [background]
    for one in inputs:
        is_pattern = glob.has_magic(str(one)) and not one.exists()
        is_film = one.suffix.lower() in FILM_SUFFIXES or is_container(one) or is_stack(one)
        if not (one.is_dir() or is_pattern or is_film):
            images.append(one)
            continue
        for sequence in listing_of(one, leave_out=leave_out, dataset=dataset).sequences:
            if not sequence.images:
                if len(inputs) > 1:
                    raise DataError(f"{sequence.path} is no image. Give it alone, or use gelform batch.")
                return [], one
            images += [sequence.path / name for name in sequence.images]
    return images, None


def image_in(path: Path, calibration: Calibration, *, bgr: bool = False) -> NDArray[np.uint8]:
    """The image (H, W, 3), RGB, of a camera frame in a file; `bgr`: its channels are blue, green, red."""
    from gelform.sensors.files import read_image

    return _viewed(read_image(path, most_pixels=calibration.most_pixels, bgr=bgr), path, calibration)


def background_in(path: Path | None, calibration: Calibration) -> NDArray[np.float32] | None:
    """The background image from a file or a folder of frames; None without a path."""
    from gelform.sensors.files import read_background

    return None if path is None else _viewed(read_background(path), path, calibration)


def calibration_given(
    given: CalibrationOptions, background: Path | None, unit: Callable[[], Unit], quiet: bool = False
) -> Calibration:
    """The calibration from a file, else from the library, else a starter's; prints which one it is unless it is a file's."""
    from gelform.calibration.library.library import NoCalibration, choose_calibration
    from gelform.calibration_file import load_calibration

    given.check(background)
    if given.calibration is not None:
        return load_calibration(given.calibration)
    of = unit()
    try:
        chosen = choose_calibration(of, ready=given.sensor is None)
    except NoCalibration as problem:
        return starter_given(given, background, of.serial, problem, quiet)
    say(chosen.said, quiet)
    return chosen.calibration


def starter_given(
    given: CalibrationOptions, background: Path | None, serial: str, missing: GelformError, quiet: bool
) -> Calibration:
    """The requested starter's calibration, announced to the user; raises `missing` with advice if none is requested."""
    if given.sensor is None or background is None:
        known = ", ".join(STARTERS)
        raise type(missing)(
            f"{missing} Or take a starter, with an image of the gel at rest: --sensor NAME ({known}) --background IMG."
        )
    made = starter_calibration(given.sensor, background, mm_per_px=given.mm_per_px, serial=serial or None)
    say(f"Calibration: the starter of a {made.sensor_name}, with {background} as its background.", quiet)
    return made


def prepared(calibration: Calibration | Path, background: Path | None, **settings: Any) -> Reconstructor:
    """A Reconstructor from a calibration and, if given, a background image or a folder of them."""
    from gelform.calibration_file import as_calibration
    from gelform.reconstruct import Reconstructor

    loaded = as_calibration(calibration)
    return Reconstructor(loaded, background=background_in(background, loaded), **settings)


def starter_calibration(sensor: str, background: Path, *, bgr: bool = False, **known: Any) -> Calibration:
    """The calibration of a unit from an image of its gel at rest, or a folder of several, by its make's starter.

    Parameters
    ----------
    bgr : whether the images are blue, green, red
    known : mm_per_px, serial, gel_id, as `calibration_from_background` takes them
    """
    from gelform.calibration.starters import calibration_from_background
    from gelform.sensors.files import read_background

    untouched = read_background(background, bgr=bgr)
    try:
        with mistakes_in(background):
            return calibration_from_background(untouched, sensor, **known)
    except CalibrationError as problem:
        raise CalibrationError(f"{background}: {problem}") from problem


def reconstruction_of(run: Reconstructor, image: NDArray[np.uint8], path: Path) -> Reconstruction:
    """The reconstruction of a file's image; an error names the file."""
    try:
        return run.from_image(image)
    except GelformError as problem:
        raise type(problem)(f"{path}: {problem}") from problem


def _viewed(frame: NDArray[Any], path: Path, calibration: Calibration) -> NDArray[Any]:
    from gelform.foundations.checks import check_image
    from gelform.image.view import image_from_frame

    with mistakes_in(f"{path}, for the calibration of {calibration.sensor_name}"):
        return check_image(image_from_frame(frame, calibration.view), shape=calibration.image_shape)
