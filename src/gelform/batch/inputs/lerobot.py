"""Frames of a LeRobot data set (version 3.0): consecutive episodes in mp4 files or tables, listed in Parquet."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.inputs.containers import Sequence, leads_out, matching
from gelform.errors import DataError, needed
from gelform.foundations.whole_files import MAX_TEXT_BYTES, bytes_of

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


def lerobot_sequences(root: Path, wanted: str) -> list[Sequence]:
    """A sequence for each episode of each matching camera, from videos or images; DataError if there is none."""
    info = lerobot_info(root)
    cameras = {
        key: (tuple(feature["shape"]), feature["dtype"])
        for key, feature in info["features"].items()
        if feature.get("dtype") in _PLACES and not _is_depth(feature)
    }
    return [
        Sequence(
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


def lossy_warnings(root: Path, sequences: Iterable[Sequence]) -> tuple[str, ...]:
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
