"""The input of a batch: its films are listed without opening them, split into parts, and read frame by frame."""

from __future__ import annotations

import glob
import hashlib
import os
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice, takewhile
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from gelform import Calibration, background_from_frames
from gelform.calibration.presses.press_set import file_of, table_rows
from gelform.errors import DataError, GelformError, cannot, reason
from gelform.foundations.checks import check_image, check_path
from gelform.foundations.files import way_for
from gelform.image.agreement import background_digest
from gelform.image.view import MAX_PIXELS, Frame, image_from_frame
from gelform.sensors.containers import (
    NODES,
    ContainerError,
    FilmRef,
    films_in_container,
    films_inside,
    is_container,
    is_data_set,
    is_lerobot_set,
    lossy_warnings,
    natural,
)
from gelform.sensors.files import FILM_SUFFIXES, is_stack, read_background
from gelform.sensors.films import film_of
from gelform.sensors.mcap import end_missing, refuse_bag
from gelform.sensors.pictures import IMAGE_SUFFIXES


@dataclass(frozen=True)
class Listing:
    """All sequences of an input below one folder, in natural order.

    Attributes
    ----------
    root : the folder that the sequences' names are relative to
    sequences : in the order of the work
    searched : whether every folder below `root` belongs to the input
    warnings : messages about the input for the user
    bgr : whether its frames are blue, green, red, as OpenCV writes an array
    """

    root: Path
    sequences: tuple[FilmRef, ...]
    searched: bool = False
    warnings: tuple[str, ...] = ()
    bgr: bool = False

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
    if path.exists() and is_data_set(path):
        inside = tuple(films_inside(path, path.name, dataset))
        if is_lerobot_set(path):
            return Listing(path, inside, searched=True, warnings=lossy_warnings(path, inside))
        return Listing(path.parent, inside)
    absolute = Path(os.path.abspath(path))
    root, searched = absolute.parent, False
    if path.is_dir():
        root, searched, what = path, True, f"the folder {path}"
        films = tuple(_in_tree(path, hidden, dataset))
    elif path.exists():
        what, films = f"the file {path}", tuple(_of_files([path], hidden, "", root))
    elif glob.has_magic(str(path)):
        # The folder below which the pattern searches: names do not depend on the number of matches.
        root = Path(*takewhile(lambda one: not glob.has_magic(one), root.parts))
        searched, what = "**" in path.parts, f"the pattern {path}"
        matches = [Path(one) for one in glob.glob(str(path), recursive=True)]
        films = tuple(_of_files(matches, hidden, dataset, root))
    else:
        raise DataError(f"No file or folder {path}. Check the path; put a pattern in quotes.")
    if not films:
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
    recordings = [film.path for film in films if film.path.suffix.lower() == ".mcap"]
    return Listing(root, films, searched, tuple(filter(None, map(end_missing, recordings))))


def _in_tree(root: Path, hidden: set[str], dataset: str) -> Iterator[FilmRef]:
    """The films of each folder before those of the folders in it; with a dataset those of HDF5 and Zarr alone."""
    folders = [root]
    while folders:
        folder = folders.pop()
        files: list[str] = []
        inside: list[str] = []
        with (
            cannot(f"list {folder}", "Allow reading it, or give the other folders."),
            os.scandir(folder) as entries,
        ):
            for entry in entries:
                if not entry.name.startswith("."):
                    (inside if entry.is_dir(follow_symlinks=False) else files).append(entry.name)
        if dataset:
            containers = [one for one in (*files, *inside) if is_container(folder / one)]
            for one in sorted(containers, key=natural):
                yield from _among_others(folder / one, root, dataset)
            inside = [one for one in inside if one not in containers]
        else:
            shown = [one for one in files if not hidden or os.path.realpath(folder / one) not in hidden]
            yield from _of_folder(root, folder, shown)
        folders += [folder / one for one in sorted(inside, key=natural, reverse=True)]


def _among_others(path: Path, root: Path, dataset: str) -> list[FilmRef]:
    """The films of a container; one that cannot be read is a film whose only row holds the error."""
    name = path.relative_to(root).as_posix()
    try:
        return films_in_container(path, name, dataset)
    except ContainerError:
        return [FilmRef(name, path, dataset=dataset)]


def _of_folder(
    root: Path, folder: Path, files: Iterable[str], image_suffixes: Collection[str] = IMAGE_SUFFIXES
) -> Iterator[FilmRef]:
    """The films of files in a folder: its images together, then each file of several frames."""
    kinds = [(os.path.splitext(one)[1].lower(), one) for one in sorted(files, key=natural)]
    stacks = {one for suffix, one in kinds if suffix in image_suffixes and is_stack(folder / one)}
    images = tuple(one for suffix, one in kinds if suffix in image_suffixes and one not in stacks)
    if images:
        name = "" if folder == root else folder.relative_to(root).as_posix()
        yield FilmRef(name, folder, images, count=len(images))
    for suffix, one in kinds:
        if suffix in FILM_SUFFIXES or one in stacks:
            yield FilmRef((folder / one).relative_to(root).as_posix(), folder / one)


def _of_files(paths: Iterable[Path], hidden: set[str], dataset: str, root: Path) -> Iterator[FilmRef]:
    """The films of named files, in the order of their folders; with a dataset those of HDF5 and Zarr alone.

    Arrays of numpy are images here, where each was named; in a folder they may hold anything.
    """
    named = [Path(os.path.abspath(one)) for one in paths if os.path.realpath(one) not in hidden]
    if dataset:
        for path in sorted(filter(is_container, named), key=lambda one: natural(str(one))):
            yield from _among_others(path, root, dataset)
        return
    inside: dict[Path, list[str]] = {}
    for path in named:
        if path.is_file() and path.suffix.lower() in (*IMAGE_SUFFIXES, *FILM_SUFFIXES, ".npy"):
            inside.setdefault(path.parent, []).append(path.name)
    for folder in sorted(inside, key=lambda one: natural(one.as_posix())):
        yield from _of_folder(root, folder, inside[folder], (*IMAGE_SUFFIXES, ".npy"))


@dataclass(frozen=True)
class Part:
    """Some frames of a film, or a whole video or recording; small, so that it can be sent to another process."""

    number: int  # its position in the plan, from 0; independent of shards
    film: FilmRef  # with this part's images alone
    start: int = 0  # position of its first frame in the film
    count: int = 0  # 0 if not counted yet
    names: tuple[str, ...] = ()  # of each image's output, without ending
    first: tuple[str, ...] = ()  # the first images of the film, if they make its background

    def name_of(self, index: int) -> str:
        """Name of a frame's output, without ending, by its position in the film."""
        return self.names[index - self.start] if self.names else f"{index:06d}"

    def input_digest(self) -> str:
        """SHA-256 of its files' names and sizes; if a file was replaced, it differs and the part is done again."""
        film, sha = self.film, hashlib.sha256(os.fsencode(self.film.name))
        folder, is_folder = os.fspath(film.path), film.path.is_dir()
        paths = [folder]  # as text, because there may be millions
        if film.images:
            paths = [f"{folder}/{one}" for one in (*self.first, *film.images)]
        elif film.dataset and is_folder:
            paths = [f"{folder}/{film.dataset}/{name}" for name in NODES]
        elif is_folder:
            paths = sorted(f"{folder}/{one}" for one in os.listdir(folder))
        for path in paths:
            try:
                size = os.stat(path).st_size
            except OSError:
                size = -1  # reading it gives the error
            sha.update(os.fsencode(f"\n{os.path.basename(path)} {size}"))
        if film.dataset:
            sha.update(os.fsencode(f"\n{film.dataset} {film.offset} {self.start} {self.count}"))
        return sha.hexdigest()


def plan_of(listing: Listing, part_frames: int, background_frames: int = 0) -> list[Part]:
    """All parts with at most `part_frames` frames, in the order of the listing, with the first images for a background.

    A video, a recording or an unreadable dataset is one part. An image's output has the file's stem, if that is unique in
    its film.
    """
    parts: list[Part] = []
    for film in listing.sequences:
        stems = [os.path.splitext(one)[0] for one in film.images]
        counts = Counter(stems)
        names = [one if counts[stem] > 1 else stem for one, stem in zip(film.images, stems)]
        for start in range(0, max(1, film.count), part_frames):
            stop = min(start + part_frames, film.count)
            piece = replace(film, images=film.images[start:stop], bgr=listing.bgr)
            first = film.images[:background_frames]
            parts.append(Part(len(parts), piece, start, stop - start, tuple(names[start:stop]), first))
    return parts


def shard_of(parts: Sequence[Part], shard: tuple[int, int]) -> list[Part]:
    """The parts of shard i of N, counted from 1: every N-th, which spreads long sequences. DataError if out of range."""
    number, count = shard
    if not 1 <= number <= count:
        raise DataError(f"Expected a shard from 1/{count} to {count}/{count}, got {number}/{count}.")
    return list(parts[number - 1 :: count])


def frames_of_part(
    part: Part, most_pixels: float = MAX_PIXELS
) -> Iterator[tuple[int, Frame | BaseException]]:
    """Position in the film, and frame or error, of each frame of a part; larger pictures are not decoded.

    A video ends at its first unreadable frame. Images of a folder have no times.
    """
    index = part.start
    try:
        film = film_of(part.film, most_pixels)
        for frame in film.each(
            0 if part.film.images else part.start, part.count
        ):  # it has this part's images alone
            yield index, frame
            index += 1
    except (GelformError, OSError, MemoryError) as problem:
        for missed in range(index, max(part.start + part.count, index + 1)):
            yield missed, problem


def image_of_calibration(frame: Frame, calibration: Calibration) -> NDArray[Any]:
    """The image (H, W, 3) of a frame, through the calibration's view; DataError for a frame of another size."""
    try:
        image = image_from_frame(frame.image, calibration.view)
        return check_image(image, shape=calibration.image_shape, name="frame")
    except ValueError as problem:
        raise DataError(str(problem)) from problem


def background_of_film(part: Part, count: int, calibration: Calibration | None = None) -> NDArray[Any]:
    """The average (H, W, 3) of the first readable frames of a part's film; without a calibration, as the camera gave them.

    DataError if none is readable, one has another size, or they differ because something touches the gel.
    """
    film = replace(part.film, images=part.first)
    beginning = replace(part, film=film, start=0, count=min(count, film.count), names=())
    most_pixels = MAX_PIXELS if calibration is None else calibration.most_pixels
    first = [one for _, one in islice(frames_of_part(beginning, most_pixels), count)]
    frames = [one for one in first if isinstance(one, Frame)]
    if not frames:
        why = next((reason(one) for one in first if not isinstance(one, Frame)), "there is none.")
        raise DataError(f"No background: none of the first {count} frames can be read: {why}")
    images = (one.image if calibration is None else image_of_calibration(one, calibration) for one in frames)
    return background_from_frames(images).background


@dataclass(frozen=True)
class Backgrounds:
    """Files of the gel at rest, each an image or a folder of several."""

    of_all: Path | None = None  # for every sequence
    by_sequence: Mapping[str, Path] = field(default_factory=dict)  # for each that a table names

    @property
    def files(self) -> list[Path]:
        """All files."""
        return [*self.by_sequence.values()] + ([] if self.of_all is None else [self.of_all])

    def read(self, sequences: Collection[str], calibration: Calibration) -> tuple[NDArray[Any] | None, str]:
        """The image (H, W, 3) for all sequences, if there is one, and a digest of all; DataError for unknown sequences."""
        if self.of_all is not None:
            image = background_of_file(self.of_all, calibration)
            return image, background_digest(image)
        if not self.by_sequence:
            return None, ""
        there = self.by_sequence.keys()
        for said, names in (
            ("The table of backgrounds has no row for", set(sequences) - there),
            ("The table of backgrounds names, and the input lacks,", there - set(sequences)),
        ):
            if names:
                named = ", ".join(repr(one) for one in sorted(names)[:3])
                more = f" and {len(names) - 3} more" if len(names) > 3 else ""
                raise DataError(f"{said} {named}{more}. Names are those of the table frames.csv of a batch.")
        sha = hashlib.sha256()
        for name, path in sorted(self.by_sequence.items()):
            sha.update(f"{name}\0{background_digest(background_of_file(path, calibration))}\n".encode())
        return None, sha.hexdigest()


def backgrounds_of(path: Path | None) -> Backgrounds:
    """Read `--background`: an image, a folder of several, or a CSV table of `sequence,background` (DataError if neither).

    Paths in a table are relative to its folder; sequences have their names in the batch's own table.
    """
    if path is None or path.suffix.lower() != ".csv":
        return Backgrounds(path)
    rows = [row for _, row in table_rows(path, ("sequence", "background"))]
    if not rows:
        raise DataError(
            f"Expected rows with the columns sequence and background in {path}. Name an image of the untouched "
            "gel for each sequence."
        )
    paths = {row["sequence"]: path.parent / file_of(path.parent, row["background"]) for row in rows}
    if len(paths) < len(rows):
        raise DataError(f"Expected each sequence once in {path}, got {len(rows)} rows of {len(paths)}.")
    return Backgrounds(by_sequence=paths)


def background_of_file(path: Path, calibration: Calibration) -> NDArray[Any]:
    """The background image (H, W, 3) from a file, through the calibration's view; DataError if that fails."""
    try:
        return image_of_calibration(Frame(read_background(path), 0.0, 0, 0), calibration)
    except GelformError as problem:
        raise DataError(f"The background {path}: {problem}") from problem
