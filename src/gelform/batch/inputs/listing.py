"""The list of frames: folders of images, videos and recordings, in natural order; only TIFFs are opened, to count pages."""

from __future__ import annotations

import glob
import hashlib
import os
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path

from gelform.batch.inputs.containers import (
    HDF5_SUFFIXES,
    ContainerError,
    Sequence,
    hdf5_sequences,
    is_zarr,
    natural,
    zarr_sequences,
)
from gelform.batch.inputs.lerobot import is_lerobot_set, lerobot_sequences, lossy_warnings
from gelform.errors import DataError
from gelform.foundations.checks import check_path
from gelform.foundations.foreign_files import way_for
from gelform.sensors.files import IMAGE_SUFFIXES, is_stack
from gelform.sensors.recordings.mcap_reader import end_missing, refuse_bag
from gelform.sensors.values import is_npy
from gelform.sensors.video_files import VIDEO_SUFFIXES

FILM_SUFFIXES = (*VIDEO_SUFFIXES, ".mcap")


@dataclass(frozen=True)
class Listing:
    """All sequences of an input below one folder, in natural order.

    Attributes
    ----------
    root : the folder that the sequences' names are relative to
    sequences : in the order of the work
    searched : whether every folder below `root` belongs to the input
    warnings : messages about the input for the user
    """

    root: Path
    sequences: tuple[Sequence, ...]
    searched: bool = False
    warnings: tuple[str, ...] = ()

    @property
    def digest(self) -> str:
        """SHA-256 of all names; it changes when files are added, removed or renamed."""
        sha = hashlib.sha256()
        for sequence in self.sequences:
            inside = (sequence.dataset, str(sequence.offset), str(sequence.count)) if sequence.dataset else ()
            sha.update(os.fsencode("\0".join(("", sequence.name, *sequence.images, *inside)) + "\n"))
        return sha.hexdigest()


def listing_of(
    source: str | os.PathLike[str], *, leave_out: Collection[Path] = (), dataset: str = ""
) -> Listing:
    """List the frames of a batch.

    Parameters
    ----------
    source : a folder (with all folders below it), a video, a recording, an image, or a pattern such as "day*/*.png",
        where ** stands for any number of folders; an HDF5 file, a Zarr store, a LeRobot data set (version 3.0); a TIFF of
        several pages, or frames of numpy (*.npy), the latter not in folders
    leave_out : files to exclude, such as the background
    dataset : datasets of HDF5 or Zarr, or cameras of LeRobot; * matches one name ("data/*/obs/gelsight"). With it, only the
        HDF5 files and Zarr stores of a folder are read

    Hidden files and other kinds of files are skipped; folders that are links are not entered.

    Raises
    ------
    DataError
        The source is missing, unreadable, or contains no frames.
    """
    path, hidden = check_path(source), {os.path.realpath(one) for one in leave_out}
    if is_lerobot_set(path):
        episodes = tuple(lerobot_sequences(path, dataset))
        return Listing(path, episodes, searched=True, warnings=lossy_warnings(path, episodes))
    if path.exists() and is_container(path):
        return Listing(path.parent, tuple(_in_container(path, path.name, dataset)))
    if path.is_dir():
        tree = _containers_in_tree(path, dataset) if dataset else _in_tree(path, hidden)
        listing = Listing(path, tuple(tree), searched=True)
        what = f"the folder {path}"
    elif path.exists():
        listing, what = _of_files([path], hidden, _absolute(path).parent), f"the file {path}"
    elif glob.has_magic(str(path)):
        found = [Path(one) for one in glob.glob(str(path), recursive=True)]
        listing, what = _of_found(found, hidden, dataset, _begin(path)), f"the pattern {path}"
        listing = replace(listing, searched="**" in path.parts)
    else:
        raise DataError(f"No file or folder {path}. Check the path; put a pattern in quotes.")
    if not listing.sequences:
        refuse_bag(path)
        suffixes = ", ".join((*IMAGE_SUFFIXES, *FILM_SUFFIXES))
        if way := way_for(path):
            raise DataError(f"Expected images, videos or recordings ({suffixes}), got {what}.{way}")
        if dataset:
            raise DataError(
                f"Expected HDF5 files or Zarr stores in {what} for --dataset {dataset}, got none."
            )
        raise DataError(
            f"Expected images, videos or recordings ({suffixes}) in {what}, got none. Of HDF5 files and Zarr stores, "
            "say with --dataset which dataset."
        )
    recordings = [one.path for one in listing.sequences if one.path.suffix.lower() == ".mcap"]
    return replace(listing, warnings=tuple(filter(None, map(end_missing, recordings))))


def is_container(path: Path) -> bool:
    """Whether a path is an HDF5 file or a Zarr store, which hold frames under a path inside."""
    return path.suffix.lower() in HDF5_SUFFIXES or is_zarr(path)


def _in_container(path: Path, name: str, dataset: str) -> list[Sequence]:
    return (zarr_sequences if is_zarr(path) else hdf5_sequences)(path, name, dataset)


def _among_others(path: Path, name: str, dataset: str) -> list[Sequence]:
    """The same; if one of several is unreadable, it becomes a sequence whose only row holds the error."""
    try:
        return _in_container(path, name, dataset)
    except ContainerError:
        return [Sequence(name, path, dataset=dataset)]


def _containers_in_tree(root: Path, dataset: str) -> Iterator[Sequence]:
    folders = [root]
    while folders:
        folder = folders.pop()
        files, inside = _entries(folder)
        here = [folder / one for one in sorted((*files, *inside), key=natural) if is_container(folder / one)]
        for path in here:
            yield from _among_others(path, path.relative_to(root).as_posix(), dataset)
        below = [folder / one for one in sorted(inside, key=natural, reverse=True)]
        folders += [one for one in below if one not in here]


def _begin(pattern: Path) -> Path:
    """The folder below which a pattern searches; names do not depend on the number of matches."""
    return Path(*takewhile(lambda one: not glob.has_magic(one), _absolute(pattern).parent.parts))


def _of_found(found: list[Path], hidden: set[str], dataset: str, root: Path) -> Listing:
    """The listing of a pattern's matches."""
    if not dataset:
        return _of_files(found, hidden, root)
    paths = sorted(
        (path for path in map(_absolute, found) if is_container(path)), key=lambda p: natural(str(p))
    )
    named = [(path, path.relative_to(root).as_posix()) for path in paths]
    return Listing(root, tuple(one for path, name in named for one in _among_others(path, name, dataset)))


def _in_tree(root: Path, hidden: set[str]) -> Iterator[Sequence]:
    """Folder by folder, each before its subfolders."""
    folders = [root]
    while folders:
        folder = folders.pop()
        name = "" if folder == root else folder.relative_to(root).as_posix()
        files, inside = _entries(folder)
        if hidden:
            files = [one for one in files if os.path.realpath(folder / one) not in hidden]
        yield from _of_folder(name, folder, files)
        folders += [folder / one for one in sorted(inside, key=natural, reverse=True)]


def _entries(folder: Path) -> tuple[list[str], list[str]]:
    """Names of the files and of the folders in a folder."""
    files: list[str] = []
    folders: list[str] = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                if not entry.name.startswith("."):
                    (folders if entry.is_dir(follow_symlinks=False) else files).append(entry.name)
    except OSError as problem:
        raise DataError(
            f"Cannot list {folder}: {problem.strerror}. Allow reading it, or give the other folders."
        ) from problem
    return files, folders


def _of_folder(name: str, folder: Path, files: Iterable[str], *, named: bool = False) -> Iterator[Sequence]:
    """The sequences of files in a folder; arrays of numpy only if each is named, because others may hold anything."""
    kinds = [(os.path.splitext(one)[1].lower(), one) for one in sorted(files, key=natural)]
    image_suffixes = (*IMAGE_SUFFIXES, ".npy") if named else IMAGE_SUFFIXES
    stacks = {one for suffix, one in kinds if suffix in image_suffixes and is_stack(folder / one)}
    images = tuple(one for suffix, one in kinds if suffix in image_suffixes and one not in stacks)
    if images:
        yield Sequence(name, folder, images)
    for suffix, one in kinds:
        if suffix in FILM_SUFFIXES or one in stacks:
            yield Sequence(f"{name}/{one}" if name else one, folder / one)


def _of_files(paths: Iterable[Path], hidden: set[str], root: Path) -> Listing:
    """Files of images and recordings, grouped by their parent folder."""
    wanted = [path for path in map(_absolute, paths) if os.path.realpath(path) not in hidden]
    wanted = [path for path in wanted if _is_frames(path)]
    inside: dict[Path, list[str]] = {}
    for path in wanted:
        inside.setdefault(path.parent, []).append(path.name)
    sequences: list[Sequence] = []
    for folder in sorted(inside, key=lambda one: natural(one.as_posix())):
        name = "" if folder == root else folder.relative_to(root).as_posix()
        sequences += _of_folder(name, folder, inside[folder], named=True)
    return Listing(root, tuple(sequences))


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))


def _is_frames(path: Path) -> bool:
    suffix = path.suffix.lower()
    return path.is_file() and (suffix in (*IMAGE_SUFFIXES, *FILM_SUFFIXES) or is_npy(path))
