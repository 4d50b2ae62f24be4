"""Files of commands: images of a calibrated sensor in, and outputs under unique names, checked before any work."""

from __future__ import annotations

import glob
import os
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import BadParameter

import gelform
from gelform import sensors
from gelform.calibration import report
from gelform.cli import options
from gelform.cli.console import check_pictures, json_bytes, mistakes_in, say
from gelform.errors import DataError, GelformError, Progress, cannot

if TYPE_CHECKING:
    from gelform.arrays import Array, Image, Map
    from gelform.calibration.presses.folder import Presses

REPORT_FILES = ("report.html", "report.json", "circles.csv")


def result_paths(inputs: Sequence[Path], folder: Path, formats: Sequence[str]) -> list[dict[str, Path]]:
    """The path of each input's result, in each format: `folder/<path below the common folder>.<format>`.

    If two inputs differ only in their suffix (a.png, a.jpg), the suffix stays in the name (a.png.npz, a.jpg.npz).
    DataError: an input is given twice, or two inputs would get the same name.
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


def check_results(results: Sequence[Path], *, overwrite: bool, protected: Sequence[Path] = ()) -> None:
    """Refuse results that exist (unless `overwrite`), and any that would replace an input.

    Temporary files of killed runs are deleted there.
    """
    from gelform.foundations.files import check_free, sweep

    inputs = {os.path.realpath(path) for path in protected}
    clashing = [path for path in results if os.path.realpath(path) in inputs]
    if clashing:
        raise DataError(f"The result {clashing[0]} would replace an input. Choose another folder with -o.")
    there = [path for path in results if os.path.lexists(path)]
    for path in there:
        check_free(path, overwrite=True)
    if there and not overwrite:
        more = f" and {len(there) - 1} more" if len(there) > 1 else ""
        raise DataError(f"{there[0]} is already there{more}. Choose another place, or allow --overwrite.")
    for folder in {path.parent for path in results if path.parent.is_dir()}:
        sweep(folder)


def new_pictures(
    images: Sequence[Path], folder: Path | None, *, overwrite: bool, read: Sequence[Path | None] = ()
) -> list[tuple[Path, Path | None]]:
    """Each image with its picture, None without a folder; checked before any work, and `read` is not replaced."""
    if folder is None:
        return [(image, None) for image in images]
    check_pictures()
    paths = [one["png"] for one in result_paths(images, folder, ["png"])]
    check_results(paths, overwrite=overwrite, protected=[*images, *filter(None, read)])
    return list(zip(images, paths))


def save_by_name(result: gelform.Reconstruction, path: Path, *, overwrite: bool) -> None:
    """Write the whole result into a .npz, or its surface in the form that another ending of the name says."""
    from gelform.exchange.exporters.surface import save_surface

    save = gelform.save_result if path.suffix.lower() == ".npz" else save_surface
    save(result, path, overwrite=overwrite)


def check_output(path: Path, *, overwrite: bool) -> None:
    """Refuse a file name that cannot be written, before the work; a missing folder is made.

    Temporary files of killed runs in that folder are deleted. DataError: the name is a folder's, the file exists (unless
    `overwrite`), or nothing can be written there.
    """
    check_results([path], overwrite=overwrite)
    _check_room(make_folder(path.parent))


def make_folder(folder: Path) -> Path:
    """Make a folder and its parents, and check that it is writable; a DataError says why not."""
    from gelform.foundations.files import made_folder

    made_folder(folder)
    if not os.access(folder, os.W_OK):
        _check_room(folder)
        raise DataError(f"Cannot write into {folder}: permission denied.")
    return folder


def _check_room(folder: Path) -> None:
    from gelform.exchange.exporters.press_folder import check_room

    with cannot(f"write into {folder}"):
        check_room(folder)


def content_of(
    presses: Presses, calibration: gelform.Calibration, progress: Progress, *, with_learning: bool
) -> dict[str, Any]:
    """The report as numbers and text. The learning curve costs a dozen calibrations and adds a section."""
    import numpy as np

    rng, learning = np.random.default_rng(0), None
    if with_learning:
        learning = report.learning_curve(presses, calibration, rng=rng, progress=progress)
    content: dict[str, Any] = report.report_content(presses, calibration, rng=rng, learning=learning)
    return content


def write_report(
    content: dict[str, Any], presses: Presses, calibration: gelform.Calibration, folder: Path, overwrite: bool
) -> None:
    """Write the files of `--report`, all or none: the page, its numbers, and the circles as a table."""
    from gelform.foundations.files import written_file

    page = report.report_page(content, presses, calibration)
    contents = (page.encode(), json_bytes(content), _circles_csv(calibration.report.presses))
    make_folder(folder)
    with ExitStack() as stack:  # each gets its name only when the bytes of all are on the disk
        for name, data in zip(REPORT_FILES, contents):
            handle = stack.enter_context(written_file(folder / name, overwrite=overwrite))
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
        sigmas = ["" if value is None else f"{value:.2f}" for value in sigma]
        lines.append(
            [row.name, f"{row.ball_diameter_mm:g}", *circle, *sigmas, f"{row.accepted:d}", row.reason or ""]
        )
    return table_text(lines).encode()


@dataclass(frozen=True)
class Inputs:
    """What reads frames: a calibration (a file, else the library's newest of the unit, else a starter), and a background."""

    calibration: options.OptionalCalibration = None
    sensor: options.StarterSensor = None
    mm_per_px: Annotated[
        float | None, options.number("For a starter: width of an image pixel on the gel, mm.", options.pitch)
    ] = None
    background: options.Background = None
    bgr: options.Bgr = False

    def __post_init__(self) -> None:
        """Refuse options that exclude each other; a starter needs the background image."""
        if self.sensor is None:
            if self.mm_per_px is not None:
                raise BadParameter("is of a starter: name it with --sensor.", param_hint="--mm-per-px")
            return
        options.one_of(self.sensor, options.STARTERS, "--sensor")
        if self.calibration is not None:
            raise BadParameter(
                "-c names the calibration already. Leave one of them out.", param_hint="--sensor"
            )
        if not self.from_film and (self.background is None or self.background.suffix.lower() == ".csv"):
            raise BadParameter(
                "needed with --sensor: an image of the gel at rest, or a folder of several.",
                param_hint="--background",
            )

    @property
    def from_film(self) -> bool:
        """Whether the first frames of each sequence show the gel at rest."""
        return False

    def calibration_of(self, source: str | Sequence[Path], quiet: bool) -> gelform.Calibration:
        """The calibration for a source or for files of images; says which one it is unless it is a file's."""
        from gelform.calibration import library

        if self.calibration is not None:
            return gelform.load_calibration(self.calibration)
        unit = library.unit_of(source) if isinstance(source, str) else library.unit_of_all(source)
        try:
            chosen = library.choose_calibration(unit, ready=self.sensor is None)
        except library.NoCalibration as problem:
            return self.starter(unit.serial, problem, quiet)
        say(chosen.said, quiet)
        return chosen.calibration

    def starter(self, serial: str, missing: GelformError, quiet: bool) -> gelform.Calibration:
        """The requested starter's calibration, announced to the user; raises `missing` with advice if none is requested."""
        if self.sensor is None or self.background is None:
            makes = ", ".join(options.STARTERS)
            raise type(missing)(
                f"{missing} Or take a starter, with an image of the gel at rest: --sensor NAME ({makes}) --background IMG."
            )
        made = starter_calibration(
            self.sensor, self.background, mm_per_px=self.mm_per_px, serial=serial or None
        )
        say(
            f"Calibration: the starter of a {made.sensor_name}, with {self.background} as its background.",
            quiet,
        )
        return made

    def background_for(self, calibration: gelform.Calibration) -> Map | None:
        """The background image from the file or the folder of frames; None without one."""
        path = self.background
        return None if path is None else _viewed(sensors.read_background(path), path, calibration)

    def image(self, path: Path, calibration: gelform.Calibration) -> Image:
        """The image (H, W, 3), RGB, of a camera frame in a file."""
        frame = gelform.read_image(path, most_pixels=calibration.most_pixels, bgr=self.bgr)
        return _viewed(frame, path, calibration)

    def reconstructor(self, calibration: gelform.Calibration) -> gelform.Reconstructor:
        """A Reconstructor of a calibration with the background, if there is one."""
        return gelform.Reconstructor(calibration, background=self.background_for(calibration))

    def images(self, paths: Sequence[Path]) -> list[Path]:
        """The images of files and folders, without the background; DataError for a video or another file of several."""
        images, film = self.images_or_film(paths)
        if film is not None:
            holds = ", which also holds a video or a recording: name its images" if film.is_dir() else ""
            raise DataError(
                f"Expected images, got {film}{holds}. Its frames: gelform batch, or gelform reconstruct."
            )
        return images

    def images_or_film(self, paths: Sequence[Path], dataset: str = "") -> tuple[list[Path], Path | None]:
        """The images of files, folders and patterns; or the one video, recording or file of several images among them."""
        from gelform.batch.inputs import listing_of
        from gelform.sensors.containers import is_container
        from gelform.sensors.files import FILM_SUFFIXES, is_stack

        images: list[Path] = []
        leave_out = [] if self.background is None else [self.background]
        for one in paths:
            is_pattern = glob.has_magic(str(one)) and not one.exists()
            is_film = one.suffix.lower() in FILM_SUFFIXES or is_container(one) or is_stack(one)
            if not (one.is_dir() or is_pattern or is_film):
                images.append(one)
                continue
            for sequence in listing_of(one, leave_out=leave_out, dataset=dataset).sequences:
                if not sequence.images:
                    if len(paths) > 1:
                        raise DataError(f"{sequence.path} is no image. Give it alone, or use gelform batch.")
                    return [], one
                images += [sequence.path / name for name in sequence.images]
        return images, None


@dataclass(frozen=True)
class FilmInputs(Inputs):
    """Inputs of what reads films too."""

    dataset: options.Dataset = ""

    @property
    def reading(self) -> dict[str, Any]:
        """Keywords of `open_source`."""
        return {"bgr": self.bgr, "dataset": self.dataset}


def starter_calibration(
    sensor: str, background: Path, *, bgr: bool = False, **known: Any
) -> gelform.Calibration:
    """The calibration of a unit from an image of its gel at rest, or a folder of several, by its make's starter.

    `known` are mm_per_px, serial and gel_id, as `calibration_from_background` takes them.
    """
    untouched = sensors.read_background(background, bgr=bgr)
    with mistakes_in(background), named(background):
        return gelform.calibration_from_background(untouched, sensor, **known)


@contextmanager
def named(path: Path) -> Iterator[None]:
    """Name the file in an error of gelform's."""
    try:
        yield
    except GelformError as problem:
        raise type(problem)(f"{path}: {problem}") from problem


def _viewed(frame: Array, path: Path, calibration: gelform.Calibration) -> Array:
    with mistakes_in(f"{path}, for the calibration of {calibration.sensor_name}"):
        image = gelform.image_from_frame(frame, calibration.view)
        if image.shape[:2] != calibration.image_shape:
            raise ValueError(f"Expected image of {other_size(image.shape, [calibration.image_shape])}")
    return image


def other_size(given: Sequence[int], expected: Sequence[Sequence[int]]) -> str:
    """The end of a sentence about images of another size (height, width) than those of the calibration: what to do."""
    sizes = " or ".join(f"{height}x{width}" for height, width in expected)
    return (
        f"{sizes} px (height x width), got {given[0]}x{given[1]}. Use the calibration of this sensor, or calibrate with "
        "images of this size."
    )
