"""Sequences of frames in files that hold many of them: HDF5, Zarr, and a LeRobot data set."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, needed
from gelform.foundations.files import MAX_TEXT_BYTES, bytes_of

BLOCK_BYTES, BLOCK_FRAMES = 1 << 26, 64  # limits of one read: bytes and frames
MAX_CHUNK_BYTES = 2**30  # decompressed
MAX_FRAMES = 10**7  # of a sequence: two days at 60 per second; more is a damaged number
# Bytes of frames per stored byte: deflate reaches 1032, and a camera's frames never come near it.
MAX_PACKING = 2000
DAMAGED = (OSError, ValueError, RuntimeError)  # errors of h5py and zarr for a chunk that cannot be decoded
HDF5_SUFFIXES = (
    ".h5",
    ".hdf5",
)  # robomimic's data/demo_0/obs/CAMERA, ALOHA's observations/images/CAMERA, or any
NODES, ZIPPED = (".zgroup", ".zarray", "zarr.json"), ".zarr.zip"
ENDS = "meta/episode_ends"  # next to data/CAMERA, in the layout of diffusion policies
Shapes = Mapping[str, tuple[tuple[int, ...], str]]  # path inside -> (shape, dtype)


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
    """

    name: str
    path: Path
    images: tuple[str, ...] = ()
    dataset: str = ""
    offset: int = 0
    count: int = 0
    rate_hz: int = 0

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


def matching(path: Path, there: Shapes, wanted: str) -> list[str]:
    """The datasets that match a pattern such as "data/*/obs/gelsight"; * matches one name. DataError if none does."""
    parts = wanted.strip("/").split("/")
    found = [one for one in there if wanted and _matches(one.split("/"), parts)]
    if found:
        return found
    said = f"Expected {wanted} in {path}, got none" if wanted else f"{path} may hold several datasets"
    raise DataError(f"{said}. Give one with --dataset; there {_listed(there)}.")


def blocks(dataset: Any, start: int, count: int, chunk: int) -> Iterator[NDArray[Any] | DataError]:
    """The values of a dataset for each frame of a range, or the error that prevents reading them.

    Whole chunks are read in blocks, so that no chunk is decompressed once per frame.
    """
    frame_bytes = max(1, int(np.prod(dataset.shape[1:])) * dataset.dtype.itemsize)
    length = max(1, min(chunk, BLOCK_FRAMES, BLOCK_BYTES // frame_bytes))
    for first in range(start, start + count, length):
        stop = min(first + length, start + count)
        try:
            yield from dataset[first:stop]
        except DAMAGED:
            yield from (_one(dataset, index) for index in range(first, stop))


def _one(dataset: Any, index: int) -> NDArray[Any] | DataError:
    try:
        return np.asarray(dataset[index])
    except DAMAGED as problem:
        return DataError(f"Cannot read frame {index} of {dataset.name}: {problem}.")


def is_frames(shape: tuple[int, ...], dtype: Any) -> bool:
    """Whether a dataset may hold frames: (N, H, W, 3), (N, 3, H, W), or compressed ones, (N, L) or of variable length."""
    kind = np.dtype(dtype)
    if kind == np.dtype(object):
        return len(shape) == 1
    if len(shape) == 4:
        return 3 in (shape[1], shape[3]) and kind.kind in "uf"
    return len(shape) == 2 and kind == np.uint8


def _matches(names: list[str], pattern: list[str]) -> bool:
    return len(names) == len(pattern) and all(fnmatchcase(a, b) for a, b in zip(names, pattern))


def _listed(there: Shapes) -> str:
    """List the datasets; those that differ only in a number appear once."""
    if not there:
        return "is no dataset of frames (N, H, W, 3)"
    kinds = Counter(re.sub(r"\d+", "*", one) for one in there)
    first = {re.sub(r"\d+", "*", one): one for one in reversed(list(there))}
    texts = []
    for pattern, count in kinds.items():
        shape, dtype = there[first[pattern]]
        name = first[pattern] if count == 1 else pattern
        texts.append(f"{name} ({count if count > 1 else 'one'} of {dtype} {_shape(shape)})")
    return "are " + ", ".join(texts)


def _shape(shape: Iterable[int]) -> str:
    return "x".join(map(str, shape))


def is_zarr(path: Path) -> bool:
    """Whether a path is a Zarr store: a folder with its metadata, or one in a zip."""
    return path.name.endswith(ZIPPED) or any((path / name).is_file() for name in NODES)


def is_container(path: Path) -> bool:
    """Whether a path is an HDF5 file or a Zarr store, which hold frames under a path inside."""
    return path.suffix.lower() in HDF5_SUFFIXES or is_zarr(path)


def films_in_container(path: Path, name: str, wanted: str) -> list[FilmRef]:
    """The film of each matching dataset, or of each episode of a Zarr store's, in natural order.

    DataError: no dataset matches, one states frames that it does not hold, or the episodes do not fit.
    """
    films: list[FilmRef] = []
    with _opened(path) as group:
        arrays = _arrays(group)
        there = {one: (a.shape, str(a.dtype)) for one, a in arrays.items() if is_frames(a.shape, a.dtype)}
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


def container_values(path: Path, dataset: str, start: int, count: int) -> Iterator[NDArray[Any] | DataError]:
    """The values of a dataset for each frame of a range, or the error that prevents reading them."""
    with _opened(path) as group:
        if dataset not in group:
            raise DataError(f"Expected {dataset} in {path}, got none.")
        values = group[dataset]
        yield from blocks(values, start, count, (values.chunks or (BLOCK_FRAMES,))[0])


def _check_stored(path: Path, dataset: Any) -> None:
    """Refuse a dataset that states more than its stored bytes can hold, or chunks that fill the memory; DataError."""
    if getattr(dataset, "is_virtual", False):  # whose frames are in other files
        return
    stored = dataset.nbytes_stored() if is_zarr(path) else dataset.id.get_storage_size()
    count, shape = dataset.shape[0], dataset.shape[1:]
    if dataset.nbytes > MAX_PACKING * stored:
        raise DataError(
            f"{dataset.name} in {path} states {count} frames and stores {stored} bytes: they were never written. Cut it to "
            "the frames that are there."
        )
    chunk = int(np.prod(dataset.chunks or (1, *shape), dtype=object)) * dataset.dtype.itemsize
    if chunk > MAX_CHUNK_BYTES:
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
                f"Cannot read {path} as HDF5: {problem}. It is damaged, cut off, or of another kind."
            ) from problem
    zarr = needed("zarr", "data", "Zarr")
    try:
        store = zarr.storage.ZipStore(path, mode="r") if path.suffix == ".zip" else str(path)
        return nullcontext(zarr.open_group(store, mode="r"))
    except Exception as problem:  # a dozen classes, depending on the version of zarr
        raise ContainerError(
            f"Cannot read {path} as a Zarr group: {problem}. It is damaged, or of another kind."
        ) from problem


def _arrays(group: Any) -> dict[str, Any]:
    """The arrays of a file or group by their paths inside."""
    found: dict[str, Any] = {}
    if hasattr(group, "visititems"):
        group.visititems(found.__setitem__)
    else:
        found.update(group.members(max_depth=None))
    return {inside: one for inside, one in found.items() if hasattr(one, "shape")}


PENALTY = "av1 yuv420p crf 30 moves depth in contact by 27 um, h264 yuv420p crf 23 by 38 um, h264 yuv444p crf 10 by 7 um"
ROWS_AT_ONCE = 32  # rows of a table with images that are read at once
INFO, STATS, EPISODES, VERSION = "meta/info.json", "meta/stats.json", "meta/episodes", "v3.0"


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
    if version != VERSION:
        raise DataError(
            f"Expected a LeRobot data set of version {VERSION}, got {version} in {root}. LeRobot's own script "
            "convert_dataset_v21_to_v30 makes one of it."
        )
    return info


def lerobot_episodes(root: Path, columns: list[str]) -> list[dict[str, Any]]:
    """Rows of `meta/episodes`, ordered by episode; DataError if they are unreadable or lack a column."""
    parquet = needed("pyarrow.parquet", "data", "LeRobot")
    pyarrow = needed("pyarrow", "data", "LeRobot")
    rows: list[dict[str, Any]] = []
    try:
        for path in sorted((root / EPISODES).glob("*/*.parquet")):
            rows += parquet.read_table(path, columns=columns).to_pylist()
    except (pyarrow.ArrowException, OSError, KeyError) as problem:
        raise DataError(f"Cannot read the episodes of {root}: {problem}.") from problem
    if not rows or set(rows[0]) != set(columns):
        lacking = sorted(set(columns) - set(rows[0] if rows else ()))
        raise DataError(f"Expected {', '.join(lacking)} in {root / EPISODES}, got none.")
    return sorted(rows, key=lambda row: row["episode_index"])


def films_in_lerobot_set(root: Path, wanted: str) -> list[FilmRef]:
    """A film for each episode of each matching camera, from videos or images; DataError if there is none."""
    info = lerobot_info(root)
    cameras = {
        key: (tuple(feature["shape"]), feature["dtype"])
        for key, feature in info["features"].items()
        if feature.get("dtype") in _PLACES and not _is_depth(feature)
    }
    return [
        FilmRef(
            f"{key}/episode_{episode:06d}",
            root / path,
            dataset=key,
            offset=offset,
            count=length,
            rate_hz=round(info["fps"]),
        )
        for key in matching(root, cameras, wanted)
        for episode, path, offset, length in _PLACES[cameras[key][1]](root, info, key)
    ]


def _is_depth(feature: dict[str, Any]) -> bool:
    info = feature.get("info") or {}
    return bool(info.get("is_depth_map") or info.get("video.is_depth_map"))


def _in_videos(root: Path, info: dict[str, Any], key: str) -> Iterator[tuple[int, str, int, int]]:
    """For each episode: number, video below the data set, its first frame in the video, number of frames."""
    chunk, file, begin = (f"videos/{key}/{name}" for name in ("chunk_index", "file_index", "from_timestamp"))
    for row in lerobot_episodes(root, ["episode_index", "length", chunk, file, begin]):
        path = _file_of(root, info, "video_path", video_key=key, chunk_index=row[chunk], file_index=row[file])
        yield row["episode_index"], path, round(row[begin] * info["fps"]), row["length"]


def _in_tables(root: Path, info: dict[str, Any], key: str) -> Iterator[tuple[int, str, int, int]]:
    """The same for a table, whose rows are consecutive episodes."""
    columns = ["data/chunk_index", "data/file_index", "dataset_from_index"]
    first: dict[str, int] = {}
    for row in lerobot_episodes(root, ["episode_index", "length", *columns]):
        path = _file_of(root, info, "data_path", chunk_index=row[columns[0]], file_index=row[columns[1]])
        begin = row["dataset_from_index"]
        yield row["episode_index"], path, begin - first.setdefault(path, begin), row["length"]


def _file_of(root: Path, info: dict[str, Any], pattern: str, **names: Any) -> str:
    """A file below the data set; DataError unless the set's pattern has the format's fields and stays below it."""
    path = info.get(pattern)
    if isinstance(path, str) and re.fullmatch(r"([^{}]|{(video_key|(chunk|file)_index(:0\dd)?)})+", path):
        path = path.format(**{"video_key": "", **names})
        if not leads_out(path):
            return path
    raise DataError(
        f"Expected {pattern} in {root / INFO} to name files below the data set by video_key, chunk_index and "
        f"file_index, got {info.get(pattern)!r}."
    )


_PLACES = {"video": _in_videos, "image": _in_tables}


def compression_of(root: Path, key: str) -> str:
    """Codec, pixel format and quality of a camera's video, such as "av1 yuv420p crf 30"; empty if lossless.

    LeRobot stores the images in its tables as PNG, without loss.
    """
    feature = lerobot_info(root)["features"].get(key, {})
    if feature.get("dtype") == "image":
        return ""
    info = {name.removeprefix("video."): value for name, value in (feature.get("info") or {}).items()}
    codec, pixels = str(info.get("codec", "unknown codec")), str(info.get("pix_fmt", "unknown pixels"))
    crf = info.get("crf")
    if codec == "ffv1" or (codec in ("h264", "hevc") and crf == 0 and pixels in ("gbrp", "rgb24")):
        return ""
    return f"{codec} {pixels}" + ("" if crf is None else f" crf {crf}")


def lossy_warnings(root: Path, sequences: Iterable[FilmRef]) -> tuple[str, ...]:
    """The measured cost of each camera's compression (`benchmarks/batch.py lossy`); nothing if it is lossless."""
    said = []
    for key in dict.fromkeys(one.dataset for one in sequences):
        if coded := compression_of(root, key):
            said.append(
                f"{key} is {coded}, with loss. Measured against the same frames without: {PENALTY}. Record "
                "without loss where depth is measured."
            )
    return tuple(said)


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
        raise DataError(f"Cannot read {path}: {problem}.") from problem
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
    parquet = needed("pyarrow.parquet", "data", "LeRobot")
    pyarrow = needed("pyarrow", "data", "LeRobot")
    done = 0
    try:
        with parquet.ParquetFile(path) as file:
            for row in _rows(file, offset + start, count, [key, "frame_index", "timestamp"]):
                if row["frame_index"] != start + done:
                    raise DataError(
                        f"Expected frame {start + done} of an episode in row {offset + start + done} of {path}, got frame "
                        f"{row['frame_index']}. The tables of the data set do not agree: create it again."
                    )
                yield float(row["timestamp"]), _bytes_of(row[key], path, start + done)
                done += 1
    except (pyarrow.ArrowException, OSError, KeyError) as problem:
        raise DataError(f"Cannot read {key} in {path}: {problem}.") from problem
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
    for batch in file.iter_batches(ROWS_AT_ONCE, row_groups=groups, columns=columns):
        begin, stop = max(0, first - at), first + count - at
        at += len(batch)
        yield from batch.slice(begin, max(0, stop - begin)).to_pylist()


def _bytes_of(value: Any, path: Path, index: int) -> NDArray[np.uint8] | DataError:
    """The bytes of a cell; LeRobot's images are {bytes, path}, of which only the bytes are used."""
    content = value.get("bytes") if isinstance(value, dict) else None
    if not content:
        return DataError(f"Frame {index} in {path} has no bytes of an image. Record the data set again.")
    return np.frombuffer(content, dtype=np.uint8)
