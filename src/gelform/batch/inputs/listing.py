"""Which frames there are: folders of images, videos and recordings, in natural order, none of them opened."""

from __future__ import annotations

import glob
import hashlib
import os
import re
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from gelform.checks import check_path
from gelform.errors import DataError
from gelform.sensors.files import IMAGE_SUFFIXES
from gelform.sensors.recordings.image_folder import is_recorded_folder
from gelform.sensors.video_files import VIDEO_SUFFIXES, is_video

FILM_SUFFIXES = (*VIDEO_SUFFIXES, ".mcap")


@dataclass(frozen=True)
class Sequence:
    """Frames that belong together: the images of one folder, a video, or a recording.

    Attributes
    ----------
    name : its path below the input, with /; empty for the input's own folder
    path : the folder of its images, the video, or the recording
    images : names of the images in natural order; empty for a video or a recording, whose frames are not counted yet
    """

    name: str
    path: Path
    images: tuple[str, ...] = ()


@dataclass(frozen=True)
class Listing:
    """All sequences of an input below one folder, in natural order.

    Attributes
    ----------
    root : the folder; what the sequences' names start from
    sequences : in the order in which they are done
    searched : whether every folder below `root` belongs to the input
    """

    root: Path
    sequences: tuple[Sequence, ...]
    searched: bool = False

    @property
    def digest(self) -> str:
        """SHA-256 of all names: another one means that files came, went or were renamed."""
        sha = hashlib.sha256()
        for sequence in self.sequences:
            sha.update(os.fsencode("\0".join(("", sequence.name, *sequence.images)) + "\n"))
        return sha.hexdigest()


def listing_of(source: str | os.PathLike[str], *, leave_out: Collection[Path] = ()) -> Listing:
    """List what a batch is to work on.

    Parameters
    ----------
    source : a folder (with all folders below it), a video, a recording, an image, or a pattern such as "day*/*.png",
        where ** stands for any number of folders
    leave_out : files that are no frames of it, such as the background

    Hidden files, and what is neither image, video nor recording, are passed over; folders that are links are not
    entered.

    Raises
    ------
    DataError
        There is no such thing, it cannot be read, or holds no frames.
    """
    path, hidden = check_path(source), {os.path.realpath(one) for one in leave_out}
    if path.is_dir():
        listing = Listing(path, tuple(_in_tree(path, hidden)), searched=True)
        what = f"the folder {path}"
    elif path.exists():
        listing, what = _of_files([path], hidden), f"the file {path}"
    elif glob.has_magic(str(path)):
        found = [Path(one) for one in glob.glob(str(path), recursive=True)]
        listing, what = _of_files(found, hidden), f"the pattern {path}"
        listing = replace(listing, searched="**" in path.parts)
    else:
        raise DataError(f"No file or folder {path}. Check the path; put a pattern in quotes.")
    if not listing.sequences:
        suffixes = ", ".join((*IMAGE_SUFFIXES, *FILM_SUFFIXES))
        raise DataError(f"Expected images, videos or recordings ({suffixes}) in {what}, got none.")
    return listing


def natural(name: str) -> tuple[list[str | int], str]:
    """Sorts image2 before image10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)], name


def _in_tree(root: Path, hidden: set[str]) -> Iterator[Sequence]:
    """Folder by folder, each before those in it."""
    folders = [root]
    while folders:
        folder = folders.pop()
        name = "" if folder == root else folder.relative_to(root).as_posix()
        if is_recorded_folder(folder):
            yield Sequence(name, folder)
            continue
        files, inside = _entries(folder)
        if hidden:
            files = [one for one in files if os.path.realpath(folder / one) not in hidden]
        yield from _of_folder(name, folder, files)
        folders += [folder / one for one in sorted(inside, key=natural, reverse=True)]


def _entries(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the files and the folders in a folder."""
    files: list[str] = []
    folders: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.startswith("."):
                    (folders if entry.is_dir(follow_symlinks=False) else files).append(entry.name)
    except OSError as problem:
        raise DataError(
            f"Cannot list {folder}: {problem.strerror}. Allow it to be read, or give the folders beside it."
        ) from problem
    return files, folders


def _of_folder(name: str, folder: Path, files: Iterable[str]) -> Iterator[Sequence]:
    kinds = [(os.path.splitext(one)[1].lower(), one) for one in sorted(files, key=natural)]
    images = tuple(one for suffix, one in kinds if suffix in IMAGE_SUFFIXES)
    if images:
        yield Sequence(name, folder, images)
    for suffix, one in kinds:
        if suffix in FILM_SUFFIXES:
            yield Sequence(f"{name}/{one}" if name else one, folder / one)


def _of_files(paths: Iterable[Path], hidden: set[str]) -> Listing:
    """Files and folders of recordings, grouped by the folder that they are in."""
    wanted = [path for path in map(_absolute, paths) if os.path.realpath(path) not in hidden]
    wanted = [path for path in wanted if _is_frames(path)]
    if not wanted:
        return Listing(Path(), ())
    root = Path(os.path.commonpath([path.parent for path in wanted]))
    inside: dict[Path, list[str]] = {}
    for path in wanted:
        inside.setdefault(path.parent, []).append(path.name)
    sequences: list[Sequence] = []
    for folder in sorted(inside, key=lambda one: natural(one.as_posix())):
        name = "" if folder == root else folder.relative_to(root).as_posix()
        sequences += _of_folder(name, folder, inside[folder])
        recorded = [one for one in sorted(inside[folder], key=natural) if is_recorded_folder(folder / one)]
        sequences += [Sequence(f"{name}/{one}" if name else one, folder / one) for one in recorded]
    return Listing(root, tuple(sequences))


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))


def _is_frames(path: Path) -> bool:
    suffix = path.suffix.lower()
    if path.is_dir():
        return is_recorded_folder(path)
    return suffix in IMAGE_SUFFIXES or suffix == ".mcap" or is_video(path)
