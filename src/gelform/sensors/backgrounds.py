"""The untouched image from files: one image, several, or a folder of them."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform.background.average import Background, background_from_frames
from gelform.checks import check_path
from gelform.errors import DataError
from gelform.sensors.files import IMAGE_SUFFIXES, read_image


def read_background(paths: str | Path | Sequence[str | Path]) -> NDArray[Any]:
    """The untouched image (H, W, 3), RGB: uint8 of one file, float32 of the robust average of several.

    Parameters
    ----------
    paths : an image, a folder of images, or several of either

    Raises
    ------
    DataError
        A file is missing or unreadable, a folder holds no image, or the frames disagree (see
        `background_from_frames`).
    """
    files = background_files(paths)
    return read_image(files[0]) if len(files) == 1 else averaged_background(paths).background


def averaged_background(paths: str | Path | Sequence[str | Path]) -> Background:
    """The same with the noise of a frame, and which images were left out and why."""
    files = background_files(paths)
    try:
        return background_from_frames(map(read_image, files), names=[str(file) for file in files])
    except ValueError as problem:  # another size
        raise DataError(f"Images of the untouched gel in {files[0].parent}: {problem}") from problem


def background_in(folder: Path, stem: str = "background") -> Path:
    """The image of that stem in a folder, or a folder of that name with several."""
    found = sorted(
        p
        for p in folder.glob(f"{stem}*")
        if p.stem == stem and (p.suffix.lower() in IMAGE_SUFFIXES or p.is_dir())
    )
    if not found:
        raise DataError(
            f"No background in {folder}: expected {stem}.png, an image of the untouched gel. "
            "Take one, or name it with background= (--background)."
        )
    return found[0]


def background_files(paths: str | Path | Sequence[str | Path]) -> list[Path]:
    """Every image that is meant, folders opened, in the order of their names."""
    if not isinstance(paths, (str, PathLike, Sequence)) or isinstance(paths, bytes):
        raise TypeError(f"Expected the path of an image or a folder, or several, got {type(paths).__name__}.")
    given = [paths] if isinstance(paths, (str, PathLike)) else list(paths)
    files: list[Path] = []
    for path in map(check_path, given):
        inside = (
            sorted(p for p in path.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES)
            if path.is_dir()
            else [path]
        )
        if not inside:
            raise DataError(f"Expected images of the untouched gel in the folder {path}, got none.")
        files += inside
    return files


__all__ = [
    "Background",
    "averaged_background",
    "background_files",
    "background_in",
    "read_background",
]
