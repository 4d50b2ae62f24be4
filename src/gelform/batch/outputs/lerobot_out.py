"""A LeRobot data set (version 3.0) with depth: the input's files, copied, and a feature more in its tables.

`frames/` of the output is the data set. `meta/info.json`, without which LeRobot finds none, comes last.
"""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gelform.batch.extras import needed
from gelform.batch.inputs.lerobot_set import EPISODES as EPISODE_TABLES
from gelform.batch.inputs.lerobot_set import INFO, STATS, lerobot_info
from gelform.batch.outputs.lerobot_video import EPISODES, QUANTILES, SUFFIX, VIDEO_PATH, place_of_video
from gelform.batch.outputs.places import FRAMES, PARTS, OutputFile, output_file, write_output
from gelform.errors import DataError
from gelform.npz_files import written_file

LISTED = f"{PARTS}/{EPISODES}/files.json"
Episodes = dict[str, dict[int, dict[str, Any]]]  # camera -> episode -> what its part said


def check_lerobot_source(source: Path, keys: set[str]) -> None:
    """Refuse an input to which no depth can be added, before anything is done.

    Raises
    ------
    DataError
        It is no LeRobot data set, keeps its videos elsewhere, or has the feature already.
    """
    if not (source / INFO).is_file():
        raise DataError(
            f"Expected a LeRobot data set as input of the format lerobot, got {source}, which has no {INFO}. Write "
            "another format."
        )
    info = lerobot_info(source)
    if info.get("video_path") not in (None, VIDEO_PATH):
        raise DataError(f"Expected videos at {VIDEO_PATH} in {source}, got {info['video_path']}.")
    for key in sorted(keys):
        if key + SUFFIX in info["features"]:
            raise DataError(f"{source} has {key}{SUFFIX} already. Write another format, or remove it there.")


def write_lerobot_set(output: Path, files: list[str], source: Path) -> None:
    """Write all of the data set but the depth videos, which the parts wrote.

    Parameters
    ----------
    output : folder of the batch
    files : that the parts wrote
    source : the data set that was read; nothing in it is changed

    Raises
    ------
    DataError
        It cannot be read, or the disk is full.
    """
    episodes, root, done = _episodes(output, files), output / FRAMES, []
    for path in _to_copy(source):
        done.append(_copied(source / path, root / path, output))
    for path in sorted((source / EPISODE_TABLES).glob("*/*.parquet")):
        done.append(write_output(output, root / path.relative_to(source), _table(path, episodes)))
    if (source / STATS).is_file():
        stats = json.loads((source / STATS).read_bytes())
        more = {key + SUFFIX: _in_lists(_together(list(of.values()))) for key, of in episodes.items()}
        done.append(write_output(output, root / STATS, _json({**stats, **more})))
    info = lerobot_info(source)
    features = {key + SUFFIX: next(iter(of.values()))["feature"] for key, of in episodes.items()}
    info |= {"features": {**info["features"], **features}, "video_path": VIDEO_PATH}
    done.append(write_output(output, root / INFO, _json(info)))
    write_output(output, output / LISTED, _json([vars(one) for one in done]))


def set_files(output: Path) -> list[OutputFile]:
    """What `write_lerobot_set` wrote; nothing where it did not end."""
    try:
        return [OutputFile(**one) for one in json.loads((output / LISTED).read_bytes())]
    except (OSError, ValueError, TypeError):
        return []


def names_of_set(output: Path) -> set[str]:
    """Their paths below the output."""
    return {one.path for one in set_files(output)}


def set_is_missing(output: Path) -> bool:
    """Whether one of them is not there in its full size."""
    files = set_files(output)
    return not files or any(not _has_size(output / one.path, one.bytes) for one in files)


def wrong_file_of_set(output: Path, files: list[str]) -> Path | None:
    """The first of those files that is missing or was altered, or their list."""
    written = set_files(output)
    for file in written:
        try:
            same = output_file(output, output / file.path) == file
        except OSError:
            same = False
        if not same:
            return output / file.path
    return None if written else output / LISTED


def _has_size(path: Path, size: int) -> bool:
    try:
        return path.stat().st_size == size
    except OSError:
        return False


def _episodes(output: Path, files: list[str]) -> Episodes:
    episodes: Episodes = {}
    for name in files:
        if name.endswith(".json"):
            said = json.loads((output / name).read_bytes())
            episodes.setdefault(said["key"], {})[said["episode_index"]] = said
    return episodes


def _to_copy(source: Path) -> Iterator[Path]:
    """Every file of the data set that stays as it is, below its root; hidden ones are no part of it."""
    for folder, folders, files in os.walk(source):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        here = Path(folder).relative_to(source)
        if here.as_posix() == EPISODE_TABLES:
            folders.clear()
            continue
        for name in sorted(files):
            if not name.startswith(".") and (here / name).as_posix() not in (INFO, STATS):
                yield here / name


def _copied(path: Path, target: Path, output: Path) -> OutputFile:
    """A copy; one that is there already, of a run that was ended, is kept where it has the same bytes."""
    if target.is_file() and _sha256(path) == _sha256(target):
        return output_file(output, target)
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        with path.open("rb") as file, written_file(target, overwrite=True) as copy:
            shutil.copyfileobj(file, copy, 1 << 20)
    except OSError as problem:
        raise DataError(f"Cannot copy {path}: {problem.strerror or problem}.") from problem
    return output_file(output, target)


def _sha256(path: Path) -> str:
    return output_file(path.parent, path).sha256


def _table(path: Path, episodes: Episodes) -> bytes:
    """A table of episodes with the places, times and statistics of their depth."""
    parquet = needed("pyarrow.parquet", "lerobot", "LeRobot")
    pyarrow = needed("pyarrow", "lerobot", "LeRobot")
    table, content = parquet.read_table(path), io.BytesIO()
    numbers = table["episode_index"].to_pylist()
    for key, of in episodes.items():
        rows = [_columns(key + SUFFIX, of[number]) for number in numbers]
        for name in rows[0] if rows else ():
            table = table.append_column(name, pyarrow.array([row[name] for row in rows]))
    parquet.write_table(table, content)
    return content.getvalue()


def _columns(key: str, said: dict[str, Any]) -> dict[str, Any]:
    chunk, file = place_of_video(said["episode_index"])
    rate_hz = said["feature"]["info"]["video.fps"]
    where = {
        "chunk_index": chunk,
        "file_index": file,
        "from_timestamp": 0.0,
        "to_timestamp": said["length"] / rate_hz,
    }
    stats = {f"stats/{key}/{name}": value for name, value in _in_lists(said["stats"]).items()}
    return {**{f"videos/{key}/{name}": value for name, value in where.items()}, **stats}


def _together(episodes: list[dict[str, Any]]) -> dict[str, float]:
    """Statistics of all episodes by LeRobot's rules: quantiles are means of the episodes' quantiles."""
    stats = [one["stats"] for one in episodes if one["stats"]["count"]]
    count = sum(one["count"] for one in stats)

    def mean(values: list[float]) -> float:
        return sum(one["count"] * value for one, value in zip(stats, values)) / count

    middle = mean([one["mean"] for one in stats])
    squares = mean([one["std"] ** 2 + (one["mean"] - middle) ** 2 for one in stats])
    return {
        "min": min(one["min"] for one in stats),
        "max": max(one["max"] for one in stats),
        "mean": middle,
        "std": squares**0.5,
        "count": count,
        **{name: mean([one[name] for one in stats]) for name in QUANTILES},
    }


def _in_lists(stats: dict[str, float]) -> dict[str, Any]:
    """As LeRobot has them: one value of one channel, (1, 1, 1); the count (1,)."""
    return {name: [int(value)] if name == "count" else [[[value]]] for name, value in stats.items()}


def _json(content: Any) -> bytes:
    return (json.dumps(content, indent=4, ensure_ascii=False) + "\n").encode()
