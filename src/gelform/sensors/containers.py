"""Sequences of frames in files that hold many of them: HDF5, Zarr, and a LeRobot data set."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, needed, said
from gelform.foundations.files import MAX_TEXT_BYTES, bytes_of

BLOCK_BYTES = 1 << 26  # read at once; a chunk, which is decompressed as a whole, has at most 16 times as many
MAX_FRAMES = 10_000_000  # of a sequence: two days at 60 per second; more is a damaged number
DAMAGED = (OSError, ValueError, RuntimeError)  # errors of h5py and zarr for a chunk that cannot be decoded
NODES = (".zgroup", ".zarray", "zarr.json")  # metadata in the folder of a Zarr group or array
OF_DATA_SETS = "--dataset is of HDF5 files, Zarr stores and LeRobot data sets"
EPISODE = re.compile(r"(episode_)?\d{6}")  # last part of the name of its film
ENDS = "meta/episode_ends"  # next to data/CAMERA, in the layout of diffusion policies


@dataclass(frozen=True)
class FilmRef:
    """A film that is not open: the images of one folder, a video, a recording, or an episode in a larger file.

    Attributes
    ----------
    name : its path below the input, with /; empty for the input's own folder
    path : the folder of its images, the video, the recording, or the HDF5 file, Zarr store or LeRobot video
    images : names of the images in natural order; otherwise empty
    dataset : path inside the file or store; for LeRobot the camera; empty for images, videos and recordings
    offset : its first frame in the dataset
    count : number of frames; 0 for a video or a recording, which are not counted yet, and for an unreadable file, whose
        reading gives the error
    rate_hz : frames per second of LeRobot's episodes; otherwise 0
    bgr : whether its frames are blue, green, red, as OpenCV writes an array
    """

    name: str
    path: Path
    images: tuple[str, ...] = ()
    dataset: str = ""
    offset: int = 0
    count: int = 0
    rate_hz: int = 0
    bgr: bool = False

    def __post_init__(self) -> None:
        if self.dataset and self.count > MAX_FRAMES:
            raise DataError(
                f"{self.path} states {self.count} frames of {self.name}; at most {MAX_FRAMES:g} are read."
            )
        # Anyone may have chosen the names inside a file, and outputs are named after their inputs.
        if leads_out(self.name):
            raise DataError(
                f"{self.path} names frames {self.name}, which leads out of any folder. Do not trust this file."
            )

    @property
    def is_timed(self) -> bool:
        """Whether its frames have the times of their recording."""
        return self.rate_hz > 0 or not (self.images or self.dataset)


def leads_out(name: str) -> bool:
    """Whether a name is a path to outside the folder that it is joined to."""
    return bool(Path(name).anchor) or ".." in Path(name).parts


def natural(name: str) -> tuple[list[str | int], str]:
    """Sort key that puts image2 before image10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)], name


class ContainerError(DataError):
    """A file of frames cannot be opened."""


def matching(path: Path, there: Mapping[str, tuple[tuple[int, ...], str]], wanted: str) -> list[str]:
    """The datasets, of `there` with shape and type, that match a pattern ("data/*/obs/gelsight"); * matches one name.

    Without a pattern, the only one there is. DataError: none does. It lists the datasets.
    """
    parts = wanted.strip("/").split("/")
    if not wanted and len(there) == 1:
        return list(there)
    found = [
        one
        for one in there
        if one.count("/") == len(parts) - 1 and all(map(fnmatchcase, one.split("/"), parts))
    ]
    if found:
        return found
    listed = "are " + ", ".join(_in_words(there)) if there else "is no dataset of frames (N, H, W, 3)"
    said = (
        f"Expected {wanted} in {path}, got none"
        if wanted
        else f"{path} holds {len(there) or 'no'} datasets of frames"
    )
    raise DataError(f"{said}. Give one with --dataset; there {listed}.")


def _in_words(there: Mapping[str, tuple[tuple[int, ...], str]]) -> list[str]:
    """Each dataset with its shape and type; those that differ only in a number appear once."""
    kinds: dict[str, list[str]] = {}
    for one in there:
        kinds.setdefault(re.sub(r"\d+", "*", one), []).append(one)
    texts = []
    for pattern, (first, *more) in kinds.items():
        shape, dtype = there[first]
        count = f"{1 + len(more)}" if more else "one"
        texts.append(f"{pattern if more else first} ({count} of {dtype} {'x'.join(map(str, shape))})")
    return texts


def blocks(dataset: Any, start: int, count: int, chunk: int) -> Iterator[NDArray[Any] | DataError]:
    """The values of a dataset for each frame of a range, or the error that prevents reading them.

    Whole chunks are read in blocks, so that no chunk is decompressed once per frame.
    """
    frame_bytes = max(1, int(np.prod(dataset.shape[1:])) * dataset.dtype.itemsize)
    length = max(1, min(chunk, BLOCK_BYTES // frame_bytes))
    for first in range(start, start + count, length):
        stop = min(first + length, start + count)
        try:
            yield from dataset[first:stop]
        except DAMAGED:
            for index in range(first, stop):
                try:
                    yield np.asarray(dataset[index])
                except DAMAGED as problem:
                    yield DataError(f"Cannot read frame {index} of {dataset.name}: {said(problem)}.")


def is_frames(shape: tuple[int, ...], dtype: Any) -> bool:
    """Whether a dataset may hold frames: (N, H, W, 3), (N, 3, H, W), or compressed ones, (N, L) or of variable length."""
    kind = np.dtype(dtype)
    if kind == np.dtype(object):
        return len(shape) == 1
    if len(shape) == 4:
        return 3 in (shape[1], shape[3]) and kind.kind in "uf"
    return len(shape) == 2 and kind == np.uint8


def is_zarr(path: Path) -> bool:
    """Whether a path is a Zarr store: a folder with its metadata, or one in a zip."""
    return path.name.endswith(".zarr.zip") or any((path / name).is_file() for name in NODES)


def is_container(path: Path) -> bool:
    """Whether a path is an HDF5 file or a Zarr store, which hold frames under a path inside."""
    # HDF5: robomimic's data/demo_0/obs/CAMERA, ALOHA's observations/images/CAMERA, or any.
    return path.suffix.lower() in (".h5", ".hdf5") or is_zarr(path)


def is_data_set(path: Path) -> bool:
    """Whether a path is an HDF5 file, a Zarr store or a LeRobot data set."""
    return is_container(path) or is_lerobot_set(path)


def films_in_container(path: Path, name: str, wanted: str) -> list[FilmRef]:
    """The film of each matching dataset, or of each episode of a Zarr store's, in natural order.

    DataError: no dataset matches, one states frames that it does not hold, or the episodes do not fit.
    """
    films: list[FilmRef] = []
    with _opened(path) as group:
        arrays, there = _datasets_in(group)
        for one in sorted(matching(path, there, wanted), key=natural):
            _check_stored(path, arrays[one])
            length = there[one][0][0]
            if not is_zarr(path) or ENDS not in arrays:
                films.append(FilmRef(f"{name}/{one}", path, dataset=one, count=length))
                continue
            ends = np.asarray(arrays[ENDS][:]).tolist()
            if sorted(ends) != ends or ends[-1:] != [length]:
                raise DataError(
                    f"Expected {ENDS} of {path} to end at the {length} frames of {one}, got {ends[-1:]}."
                )
            films += [
                FilmRef(f"{name}/{one}/{k:06d}", path, dataset=one, offset=a, count=b - a)
                for k, (a, b) in enumerate(zip([0, *ends[:-1]], ends))
            ]
    return films


Shapes = dict[str, tuple[tuple[int, ...], str]]  # shape and type of each dataset, or of each camera's frames


def _datasets_in(group: Any) -> tuple[dict[str, Any], Shapes]:
    """All arrays of an open file or store by name, and shape and type of those that may hold frames."""
    members: dict[str, Any] = {}
    if hasattr(group, "visititems"):  # of h5py
        group.visititems(members.__setitem__)
    else:
        members.update(group.members(max_depth=None))
    arrays = {inside: one for inside, one in members.items() if hasattr(one, "shape")}
    return arrays, {one: (a.shape, str(a.dtype)) for one, a in arrays.items() if is_frames(a.shape, a.dtype)}


def frames_inside(path: Path) -> list[str]:
    """What `--dataset` can name in an HDF5 file, a Zarr store or a LeRobot data set; DataError: it cannot be read."""
    if is_lerobot_set(path):
        return _in_words(_cameras_in(lerobot_info(path)))
    with _opened(path) as group:
        return _in_words(_datasets_in(group)[1])


def films_inside(path: Path, name: str, wanted: str) -> list[FilmRef]:
    """The films of an HDF5 file, a Zarr store or a LeRobot data set that match a pattern; DataError if none does.

    The name of an episode may follow that of its dataset or camera: "observation.images.gel/episode_000003".
    """
    films_of = (
        partial(films_in_lerobot_set, path)
        if is_lerobot_set(path)
        else partial(films_in_container, path, name)
    )
    try:
        return films_of(wanted)
    except DataError:
        whole, _, episode = wanted.rpartition("/")
        if not EPISODE.fullmatch(episode):
            raise
        if not (films := [film for film in films_of(whole) if film.name.endswith(f"/{episode}")]):
            raise
        return films


def values_of(film: FilmRef, start: int, count: int) -> Iterator[tuple[float, NDArray[Any] | DataError]]:
    """Time in the film, s, and what an image is made from or why there is none, for each frame of a range of a dataset."""
    if film.path.suffix == ".mp4":
        return video_frames(film.path, film.offset, start, count)
    if film.path.suffix == ".parquet":
        return stored_images(film.path, film.dataset, film.offset, start, count)
    return ((0.0, one) for one in container_values(film.path, film.dataset, film.offset + start, count))


def container_values(path: Path, dataset: str, start: int, count: int) -> Iterator[NDArray[Any] | DataError]:
    """The values of a dataset for each frame of a range, or the error that prevents reading them."""
    with _opened(path) as group:
        if dataset not in group:
            raise DataError(f"Expected {dataset} in {path}, got none.")
        values = group[dataset]
        yield from blocks(values, start, count, (values.chunks or (1,))[0])


def _check_stored(path: Path, dataset: Any) -> None:
    """Refuse a dataset that states more than its stored bytes can hold, or chunks that fill the memory; DataError."""
    if getattr(dataset, "is_virtual", False):  # whose frames are in other files
        return
    stored = dataset.nbytes_stored() if is_zarr(path) else dataset.id.get_storage_size()
    count, shape = dataset.shape[0], dataset.shape[1:]
    if dataset.nbytes > 2000 * stored:  # deflate reaches 1032, and a camera's frames never come near it
        raise DataError(
            f"{dataset.name} in {path} states {count} frames and stores {stored} bytes: they were never written. Cut it to "
            "the frames that are there."
        )
    chunk = int(np.prod(dataset.chunks or (1, *shape), dtype=object)) * dataset.dtype.itemsize
    if chunk > 16 * BLOCK_BYTES:
        raise DataError(
            f"{dataset.name} in {path} has chunks of {chunk / 1e9:.3g} GB, each of which is decompressed as a whole. Write "
            "it again in chunks of a few frames."
        )


def _opened(path: Path) -> AbstractContextManager[Any]:
    """An HDF5 file or a Zarr group; ContainerError if it is neither."""
    if not is_zarr(path):
        h5py = needed("h5py", "data", "HDF5")
        try:
            return cast("AbstractContextManager[Any]", h5py.File(path, "r"))
        except OSError as problem:
            raise ContainerError(
                f"Cannot read {path} as HDF5: {said(problem)}. It is damaged, cut off, or of another kind."
            ) from problem
    zarr = needed("zarr", "data", "Zarr")
    try:
        store = zarr.storage.ZipStore(path, mode="r") if path.suffix == ".zip" else str(path)
        return nullcontext(zarr.open_group(store, mode="r"))
    except Exception as problem:  # a dozen classes, depending on the version of zarr
        raise ContainerError(
            f"Cannot read {path} as a Zarr group: {said(problem)}. It is damaged, or of another kind."
        ) from problem


INFO, STATS, EPISODE_TABLES = "meta/info.json", "meta/stats.json", "meta/episodes"
LEROBOT_PATH = re.compile(r"([^{}]|{(video_key|(chunk|file)_index(:0\dd)?)})+")  # the format's fields alone


def is_lerobot_set(path: Path) -> bool:
    """Whether a folder is a LeRobot data set of any version."""
    return (path / INFO).is_file()


def lerobot_info(root: Path) -> dict[str, Any]:
    """The content of `meta/info.json`; DataError if it is unreadable or of another version."""
    try:
        info: dict[str, Any] = json.loads(bytes_of(root / INFO, "facts of a data set", MAX_TEXT_BYTES))
        version, _ = info["codebase_version"], (info["features"], info["fps"])
    except (OSError, ValueError, KeyError, TypeError) as problem:
        raise DataError(f"{root / INFO} cannot be read as LeRobot's: {problem!r}.") from problem
    if version != "v3.0":
        raise DataError(
            f"Expected a LeRobot data set of version v3.0, got {version} in {root}. LeRobot's own script "
            "convert_dataset_v21_to_v30 makes one of it."
        )
    return info


def lerobot_episodes(root: Path, columns: list[str]) -> list[dict[str, Any]]:
    """Rows of `meta/episodes`, ordered by episode; DataError if they are unreadable or lack a column."""
    parquet, pyarrow = (needed(name, "data", "LeRobot") for name in ("pyarrow.parquet", "pyarrow"))
    rows: list[dict[str, Any]] = []
    try:
        for path in sorted((root / EPISODE_TABLES).glob("*/*.parquet")):
            rows += parquet.read_table(path, columns=columns).to_pylist()
    except (pyarrow.ArrowException, OSError, KeyError) as problem:
        raise DataError(f"Cannot read the episodes of {root}: {said(problem)}.") from problem
    if not rows or set(rows[0]) != set(columns):
        lacking = sorted(set(columns) - set(rows[0] if rows else ()))
        raise DataError(f"Expected {', '.join(lacking)} in {root / EPISODE_TABLES}, got none.")
    return sorted(rows, key=lambda row: row["episode_index"])


def _cameras_in(info: Mapping[str, Any]) -> Shapes:
    cameras: Shapes = {}
    for key, feature in info["features"].items():
        if feature.get("dtype") in ("video", "image"):
            more = feature.get("info") or {}
            if not (more.get("is_depth_map") or more.get("video.is_depth_map")):
                cameras[key] = tuple(feature["shape"]), feature["dtype"]
    return cameras


def films_in_lerobot_set(root: Path, wanted: str) -> list[FilmRef]:
    """A film for each episode of each matching camera, from videos or images; DataError if there is none."""
    info = lerobot_info(root)
    cameras = _cameras_in(info)
    films: list[FilmRef] = []
    for key in matching(root, cameras, wanted):
        in_video = cameras[key][1] == "video"
        folder, name = (f"videos/{key}", "video_path") if in_video else ("data", "data_path")
        chunk, file = f"{folder}/chunk_index", f"{folder}/file_index"
        begin = f"{folder}/from_timestamp" if in_video else "dataset_from_index"
        pattern: Any = info.get(name)
        first: dict[str, int] = {}  # row of each table
        for row in lerobot_episodes(root, ["episode_index", "length", chunk, file, begin]):
            where = {"chunk_index": row[chunk], "file_index": row[file]}
            is_known = isinstance(pattern, str) and LEROBOT_PATH.fullmatch(pattern)
            path = pattern.format(video_key=key if in_video else "", **where) if is_known else ""
            if not is_known or leads_out(path):
                raise DataError(
                    f"Expected {name} in {root / INFO} to name files below the data set by video_key, chunk_index and "
                    f"file_index, got {pattern!r}."
                )
            at = row[begin]
            offset = round(at * info["fps"]) if in_video else at - first.setdefault(path, at)
            episode, rate_hz = f"{key}/episode_{row['episode_index']:06d}", round(info["fps"])
            films.append(FilmRef(episode, root / path, (), key, offset, row["length"], rate_hz))
    return films


def lossy_warnings(root: Path, films: Iterable[FilmRef]) -> tuple[str, ...]:
    """The measured cost of each camera's compression (`benchmarks/batch.py lossy`); nothing if it is lossless.

    LeRobot stores the images in its tables as PNG, without loss.
    """
    warnings, features = [], lerobot_info(root)["features"]
    for key in dict.fromkeys(film.dataset for film in films):
        feature = features.get(key, {})
        info = {name.removeprefix("video."): value for name, value in (feature.get("info") or {}).items()}
        codec, pixels = str(info.get("codec", "unknown codec")), str(info.get("pix_fmt", "unknown pixels"))
        crf = info.get("crf")
        exact = codec in ("h264", "hevc") and crf == 0 and pixels in ("gbrp", "rgb24")
        if feature.get("dtype") != "image" and codec != "ffv1" and not exact:
            quality = "" if crf is None else f" crf {crf}"
            warnings.append(
                f"{key} is {codec} {pixels}{quality}, with loss. Measured against the same frames without: av1 yuv420p "
                "crf 30 moves depth in contact by 27 um, h264 yuv420p crf 23 by 38 um, h264 yuv444p crf 10 by 7 um. Record "
                "without loss where depth is measured."
            )
    return tuple(warnings)


def video_frames(
    path: Path, offset: int, start: int, count: int
) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Frames of an episode that starts at frame `offset` of a video: seconds since then, and image (H, W, 3).

    Decoding starts at the key frame before frame `start` of the episode. DataError if the video ends earlier.
    """
    av = needed("av", "data", "LeRobot")
    done = 0
    try:
        with av.open(str(path)) as file:
            stream = file.streams.video[0]
            rate, base = float(stream.average_rate), float(stream.time_base)
            zero_s = offset / rate + (stream.start_time or 0) * base
            begin_s = zero_s + start / rate
            file.seek(max(0, int((begin_s - 0.5 / rate) / base)), stream=stream)
            for frame in file.decode(stream):
                if frame.time is None or frame.time < begin_s - 0.5 / rate:
                    continue
                yield frame.time - zero_s, frame.to_ndarray(format="rgb24")
                done += 1
                if done == count:
                    return
    except (av.FFmpegError, IndexError) as problem:
        raise DataError(f"Cannot read {path}: {said(problem)}.") from problem
    raise DataError(
        f"Expected {offset + start + count} frames in {path}, got {offset + start + done}. It is cut off."
    )


def stored_images(
    path: Path, key: str, offset: int, start: int, count: int
) -> Iterator[tuple[float, NDArray[np.uint8] | DataError]]:
    """Images of an episode that starts at row `offset` of a table: seconds since then, and PNG or JPEG bytes (L,).

    Only the needed row groups and columns are read. DataError if the table ends earlier, or its order contradicts the
    table of episodes.
    """
    parquet, pyarrow = (needed(name, "data", "LeRobot") for name in ("pyarrow.parquet", "pyarrow"))
    done = 0
    try:
        with parquet.ParquetFile(path) as file:
            for row in _rows(file, offset + start, count, [key, "frame_index", "timestamp"]):
                if row["frame_index"] != start + done:
                    raise DataError(
                        f"Expected frame {start + done} of an episode in row {offset + start + done} of {path}, got frame "
                        f"{row['frame_index']}. The tables of the data set do not agree: create it again."
                    )
                cell = row[key]  # LeRobot's images are {bytes, path}, of which only the bytes are used
                content = cell.get("bytes") if isinstance(cell, dict) else None
                yield (
                    float(row["timestamp"]),
                    np.frombuffer(content, dtype=np.uint8)
                    if content
                    else DataError(
                        f"Frame {start + done} in {path} has no bytes of an image. Record the data set again."
                    ),
                )
                done += 1
    except (pyarrow.ArrowException, OSError, KeyError) as problem:
        raise DataError(f"Cannot read {key} in {path}: {said(problem)}.") from problem
    if done < count:
        raise DataError(
            f"Expected {offset + start + count} rows in {path}, got {offset + start + done}. It is cut off."
        )


def _rows(file: Any, first: int, count: int, columns: list[str]) -> Iterator[dict[str, Any]]:
    """Rows of a range, from the row groups that overlap it."""
    lengths = [file.metadata.row_group(k).num_rows for k in range(file.num_row_groups)]
    ends = np.cumsum(lengths, dtype=np.int64)
    groups = [k for k, end in enumerate(ends) if end > first and end - lengths[k] < first + count]
    if not groups:
        return
    at = int(ends[groups[0]]) - lengths[groups[0]]
    for batch in file.iter_batches(32, row_groups=groups, columns=columns):  # as images they are large
        begin, stop = max(0, first - at), first + count - at
        at += len(batch)
        yield from batch.slice(begin, max(0, stop - begin)).to_pylist()
