"""Image files of a calibrated sensor: view, check of the size, reconstruction; errors name the file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gelform.cli.console import say
from gelform.cli.options import STARTERS
from gelform.cli.process import mistakes_in
from gelform.errors import CalibrationError, DataError, GelformError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from gelform.calibration.library.choose import Unit
    from gelform.calibration_file import Calibration
    from gelform.cli.options import CalibrationOptions
    from gelform.reconstruct import Reconstructor
    from gelform.result import Reconstruction


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

    from gelform.batch.inputs.listing import FILM_SUFFIXES, is_container, listing_of
    from gelform.sensors.files import is_stack

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
    from gelform.calibration.library.choose import NoCalibration, choose_calibration
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
