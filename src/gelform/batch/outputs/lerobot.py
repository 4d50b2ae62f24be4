"""A LeRobot data set (version 3.0) with depth: copies of the input's files, and a lossless video for each episode.

If loads were calibrated, the tables of frames gain the force on the gel, (3,) float32, N, and whether it is known (1 or 0).
LeRobot's tools fail on NaN, so a force that is not known is 0 there.

The videos are lossless 12-bit HEVC. The data set is in `frames/` of the output. `meta/info.json` is written last, because
LeRobot finds no data set without it. LeRobot reads 12-bit codes as `depth_min + code / 4095 x (depth_max - depth_min)`
meters and rounds to whole mm. With 0 and 4.095 m a code equals its number of "mm", which are um here: v = 1000 + depth
in um is recovered exactly, up to 3.095 mm.
(LeRobot's own logarithmic default reaches 9 mm, in steps of 1.5 to 4 um.)
"""

from __future__ import annotations

import io
import json
import os
import shutil
from collections.abc import Iterator
from contextlib import ExitStack
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.outputs.files import (
    FRAMES,
    PARTS,
    OutputFile,
    PartTarget,
    PartWriter,
    RememberingFile,
    output_file,
    write_output,
)
from gelform.errors import DataError, cannot, needed
from gelform.exchange.exporters.surface import UNKNOWN
from gelform.foundations.files import MAX_TEXT_BYTES, bytes_of, written_file
from gelform.result import Reconstruction
from gelform.robots.lerobot_depth import (
    UM_PER_MM,
    ZERO_LEVEL,
    depth_from_lerobot_levels,
    lerobot_levels_from_depth,
)
from gelform.sensors.containers import EPISODE_TABLES, INFO, STATS, lerobot_info

SUFFIX = "_depth"  # the depth feature's name ends so, after the camera's
AXES = ("x_n", "y_n", "z_n")  # of a force, along the image's axes and away from the camera
MAX_CODE = 4095  # largest 12-bit code
FILES_IN_A_CHUNK = 1000  # LeRobot's own default
EPISODES = "lerobot"  # folder next to the records of parts: entries of each episode for the tables
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
Episodes = dict[str, dict[int, dict[str, Any]]]  # camera -> episode -> entries of its part
Vectors = dict[str, dict[int, NDArray[np.float64]]]  # feature -> episode -> (frames, 3)
ENCODER, PIXELS, PRESET, X265 = "libx265", "gray12le", "ultrafast", "lossless=1"
KEY_FRAMES = 2  # distance of key frames, as in LeRobot's own videos, for quick access to any frame


class LerobotVideo(PartWriter):
    """Writes an episode's depth as a lossless video, and its statistics and feature for the tables of the data set.

    DataError: av was built without the encoder.
    """

    def __init__(self, target: PartTarget) -> None:
        super().__init__(target)
        self._av, self._open = needed("av", "data", "LeRobot"), ExitStack()
        self._key, self._episode = episode_of(target.part.film.name)
        self._path = target.output / FRAMES / video_path(self._key + SUFFIX, self._episode)
        self._counts = np.zeros(MAX_CODE + 1, dtype=np.int64)
        self._forces: list[NDArray[np.float64] | None] = []  # of each frame so far

    def prepared(self, result: Reconstruction) -> tuple[NDArray[np.uint16], NDArray[np.float64] | None]:
        """The levels, 1000 + depth in um, and the force (3,), N; None if no loads were calibrated."""
        levels = lerobot_levels_from_depth(result.depth_mm)
        if levels.max() > MAX_CODE:
            raise DataError(
                f"Expected depth up to {(MAX_CODE - ZERO_LEVEL) / UM_PER_MM:.3f} mm, which LeRobot's 12 bits hold in steps "
                f"of 1 um, got {result.depth_mm.max():.3f} mm. Look at the frame: gels are not pressed so deep."
            )
        return levels, None if result.force_model is None else result.force.vector_n

    def add(self, name: str, index: int, prepared: Any | None) -> dict[str, Any]:
        """Encode the next frame; level 0 (unknown) and no force for a frame with an error."""
        levels, force = prepared or (np.full(self._target.shape, UNKNOWN, np.uint16), None)
        height, width = self._target.shape
        frame = self._av.VideoFrame(width, height, PIXELS)
        plane = frame.planes[0]  # its rows may be longer than the image's
        np.frombuffer(plane, dtype="<u2").reshape(-1, plane.line_size // 2)[:height, :width] = levels
        frame.pts, frame.time_base = len(self._forces), Fraction(1, self._target.part.film.rate_hz)
        self._file.mux(self._stream.encode(frame))
        self._handle.check()
        self._counts += np.bincount(levels.ravel(), minlength=MAX_CODE + 1)
        self._forces.append(force)
        return self._row(self._path, prepared)

    def __enter__(self) -> LerobotVideo:
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with ExitStack() as opened:
            self._handle = RememberingFile(opened.enter_context(written_file(self._path, overwrite=True)))
            opened.callback(self._handle.check)
            # "bitexact": no random identifiers.
            video = self._av.open(self._handle, "w", format="mp4", options={"fflags": "bitexact"})
            self._file = opened.enter_context(video)
            options = {
                "g": str(KEY_FRAMES),
                "preset": PRESET,
                "x265-params": f"{X265}:bframes=0:pools=none:frame-threads=1:log-level=none",
            }
            rate_hz = self._target.part.film.rate_hz
            try:
                self._stream = self._file.add_stream(ENCODER, rate=rate_hz, options=options)
            except self._av.codec.codec.UnknownCodecError as problem:
                raise DataError(
                    f"This build of av has no encoder {ENCODER}. Install the wheel: pip install av."
                ) from problem
            self._stream.height, self._stream.width = self._target.shape
            self._stream.pix_fmt = PIXELS
            self._stream.thread_count = 1  # the same bytes each time, and no threads besides the workers
            self._open = opened.pop_all()
        return self

    def __exit__(self, *error: Any) -> None:
        if error[0] is None:
            self._file.mux(self._stream.encode())
        self._open.__exit__(*error)  # a full disk becomes a DataError of `written_file`
        if error[0] is None:
            target, count = self._target, len(self._forces)
            self.files.append(output_file(target.output, self._path))
            unknown, forces = np.full(len(AXES), np.nan), list[list[float | None]]()
            if any(force is not None for force in self._forces):
                rows = (unknown if force is None else force for force in self._forces)
                forces = [[one if np.isfinite(one) else None for one in row.tolist()] for row in rows]
            facts = {
                "key": self._key,
                "episode_index": self._episode,
                "length": count,
                "feature": self._feature(),
                "stats": statistics(self._counts, count),
                "forces": forces,  # (3,) of each frame; empty if no loads were calibrated
            }
            path = target.output / PARTS / EPISODES / f"{target.part.film.name}.json"
            self.files.append(write_output(target.output, path, json.dumps(facts).encode()))

    def _feature(self) -> dict[str, Any]:
        """The entry of the depth in `meta/info.json`: LeRobot's keys, and the origin of the depth."""
        height, width = self._target.shape
        video = {
            "height": height,
            "width": width,
            "codec": "hevc",
            "pix_fmt": PIXELS,
            "channels": 1,
            "fps": self._target.part.film.rate_hz,
            "extra_options": {"x265-params": X265},
            "g": KEY_FRAMES,
            "preset": PRESET,
            "fast_decode": 0,
            "video_backend": "pyav",
            "depth_min": 0.0,
            "depth_max": MAX_CODE / 1000,
            "shift": 0.0,
            "use_log": False,
        }
        ours = {**self._target.facts, "encoding": "1000 + depth in um, which LeRobot calls mm; 0: unknown"}
        info = {f"video.{name}": value for name, value in video.items()}
        info |= {"has_audio": False, "is_depth_map": True, "depth_unit": "mm"}
        info |= {f"gelform.{name}": value for name, value in ours.items()}
        names = ["height", "width", "channels"]
        return {"dtype": "video", "shape": [height, width, 1], "names": names, "info": info}


def episode_of(sequence: str) -> tuple[str, int]:
    """The camera and the episode in the name of a LeRobot sequence; DataError for another name."""
    key, separator, number = sequence.rpartition("/episode_")
    if not (key and separator and number.isdecimal()):
        raise DataError(
            f"Expected an episode of a LeRobot data set, got {sequence or 'a folder of images'}. Write another format."
        )
    return key, int(number)


def force_key(key: str) -> str:
    """The name of the force on the gel of a camera."""
    return "observation.force." + key.removeprefix("observation.images.")


def video_path(key: str, episode: int) -> str:
    """The path of an episode's video below the data set."""
    chunk, file = divmod(episode, FILES_IN_A_CHUNK)
    return VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file)


def statistics(counts: NDArray[np.int64], frames: int) -> dict[str, float]:
    """Minimum, maximum, mean, standard deviation, number of frames and quantiles, from the counts of levels."""
    levels, total = np.arange(len(counts)), max(1, int(counts.sum()))
    there = np.flatnonzero(counts)
    if not len(there):
        return {"count": 0}
    mean = float(counts @ levels) / total
    below = np.cumsum(counts)
    quantiles = {name: float(np.searchsorted(below, part * total)) for name, part in QUANTILES.items()}
    return {
        "min": float(there[0]),
        "max": float(there[-1]),
        "mean": mean,
        "std": float(np.sqrt(counts @ (levels - mean) ** 2 / total)),
        "count": frames,
        **quantiles,
    }


def check_lerobot_source(source: Path, keys: set[str]) -> None:
    """Refuse (DataError), before any work, an input to which depth cannot be added."""
    if not (source / INFO).is_file():
        raise DataError(
            f"Expected a LeRobot data set as input of the format lerobot, got {source}, which has no {INFO}. Write "
            "another format."
        )
    info = lerobot_info(source)
    if info.get("video_path") not in (None, VIDEO_PATH):
        raise DataError(f"Expected videos at {VIDEO_PATH} in {source}, got {info['video_path']}.")
    for key in sorted(keys):
        for name in (key + SUFFIX, force_key(key)):
            if name in info["features"]:
                raise DataError(f"{source} has {name} already. Write another format, or remove it there.")


def write_lerobot_set(output: Path, files: list[str], source: Path) -> list[OutputFile]:
    """Write all of the data set except the depth videos, which the parts wrote; the source stays unchanged."""
    root, done, episodes = output / FRAMES, list[OutputFile](), Episodes()
    for name in files:
        if name.endswith(".json"):
            facts = json.loads((output / name).read_bytes())
            episodes.setdefault(facts["key"], {})[facts["episode_index"]] = facts
    forces = _forces(episodes)
    for path in _to_copy(source):
        original, target = source / path, root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        if forces and path.parts[0] == "data" and path.suffix == ".parquet":
            _write_with_forces(original, target, forces)
        # A copy of an interrupted run is kept if its bytes are equal.
        elif not target.is_file() or output_file(root, target) != output_file(source, original):
            whole = written_file(target, overwrite=True)
            with cannot(f"copy {original}"), original.open("rb") as file, whole as copy:
                shutil.copyfileobj(file, copy, 1 << 20)
        done.append(output_file(output, target))
    for path in sorted((source / EPISODE_TABLES).glob("*/*.parquet")):
        done.append(write_output(output, root / path.relative_to(source), _table(path, episodes, forces)))
    if (source / STATS).is_file():
        stats = json.loads(bytes_of(source / STATS, "statistics of a data set", MAX_TEXT_BYTES))
        of_all = {key: _together([one["stats"] for one in of.values()]) for key, of in episodes.items()}
        more = {key + SUFFIX: _in_lists(one) for key, one in of_all.items()}
        more |= {key: _of_vectors(np.concatenate(list(of.values()))) for key, of in forces.items()}
        done.append(write_output(output, root / STATS, _json({**stats, **more})))
    info = lerobot_info(source)
    features = {key + SUFFIX: next(iter(of.values()))["feature"] for key, of in episodes.items()}
    features |= {key: {"dtype": "float32", "shape": [len(AXES)], "names": [*AXES]} for key in forces}
    info |= {"features": {**info["features"], **features}, "video_path": VIDEO_PATH}
    done.append(write_output(output, root / INFO, _json(info)))
    return done


def _to_copy(source: Path) -> Iterator[Path]:
    """Every file of the data set to copy unchanged, below its root; hidden files are skipped."""
    for folder, folders, files in os.walk(source):
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        here = Path(folder).relative_to(source)
        if here.as_posix() == EPISODE_TABLES:
            folders.clear()
            continue
        for name in sorted(files):
            if not name.startswith(".") and (here / name).as_posix() not in (INFO, STATS):
                yield here / name


def _forces(episodes: Episodes) -> Vectors:
    """The force on each camera's gel, 0 where it is not known, and whether it is; empty if no loads were calibrated."""
    vectors: Vectors = {}
    for key, of in episodes.items():
        if any(one["forces"] for one in of.values()):
            unknown = [[None] * len(AXES)]
            force = {
                number: np.array(one["forces"] or unknown * one["length"], dtype=np.float64)
                for number, one in of.items()
            }
            vectors[force_key(key)] = {number: np.nan_to_num(rows) for number, rows in force.items()}
            known = {number: np.isfinite(rows).astype(float) for number, rows in force.items()}
            vectors[f"{force_key(key)}_known"] = known
    return vectors


def _write_with_forces(path: Path, target: Path, forces: Vectors) -> None:
    """Write a table of frames with the force on each camera's gel; one row group is in memory at a time."""
    parquet, pyarrow = (needed(name, "data", "LeRobot") for name in ("pyarrow.parquet", "pyarrow"))
    vector = pyarrow.list_(pyarrow.float32(), len(AXES))
    with parquet.ParquetFile(path) as file:
        # The metadata repeat the features for Hugging Face's reader, which takes them from the schema without.
        kept = {k: v for k, v in (file.schema_arrow.metadata or {}).items() if k != b"huggingface"}
        schema = pyarrow.schema([*file.schema_arrow, *(pyarrow.field(key, vector) for key in forces)], kept)
        with (
            written_file(target, overwrite=True) as copy,
            parquet.ParquetWriter(copy, schema) as writer,
        ):
            for group in range(file.num_row_groups):
                table = file.read_row_group(group)
                rows = list(zip(table["episode_index"].to_pylist(), table["frame_index"].to_pylist()))
                for key, of in forces.items():
                    column = [of[episode][frame].tolist() for episode, frame in rows]
                    table = table.append_column(key, pyarrow.array(column, vector))
                writer.write_table(table.cast(schema))


def _of_vectors(rows: NDArray[np.float64]) -> dict[str, Any]:
    """Statistics of vectors (frames, 3), in LeRobot's shapes."""
    measures: dict[str, Any] = {"min": np.min, "max": np.max, "mean": np.mean, "std": np.std}
    figures: dict[str, Any] = {name: measure(rows, axis=0).tolist() for name, measure in measures.items()}
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0).tolist()
    return {**figures, "count": [len(rows)], **dict(zip(QUANTILES, quantiles))}


def _table(path: Path, episodes: Episodes, forces: Vectors) -> bytes:
    """A table of episodes with the places, times and statistics of their depth, and those of their forces."""
    parquet, pyarrow = (needed(name, "data", "LeRobot") for name in ("pyarrow.parquet", "pyarrow"))
    table, content = parquet.read_table(path), io.BytesIO()
    numbers, columns = table["episode_index"].to_pylist(), []
    for key, of in episodes.items():
        columns.append([_columns(key + SUFFIX, of[number]) for number in numbers])
    for key, vectors in forces.items():
        of_force = [_of_vectors(vectors[number]) for number in numbers]
        columns.append([{f"stats/{key}/{name}": one for name, one in row.items()} for row in of_force])
    for rows in columns:
        for name in rows[0] if rows else ():
            table = table.append_column(name, pyarrow.array([row[name] for row in rows]))
    parquet.write_table(table, content)
    return content.getvalue()


def _columns(key: str, facts: dict[str, Any]) -> dict[str, Any]:
    """Place, times and statistics of an episode's depth."""
    chunk, file = divmod(facts["episode_index"], FILES_IN_A_CHUNK)
    duration_s = facts["length"] / facts["feature"]["info"]["video.fps"]
    return {
        f"videos/{key}/chunk_index": chunk,
        f"videos/{key}/file_index": file,
        f"videos/{key}/from_timestamp": 0.0,
        f"videos/{key}/to_timestamp": duration_s,
        **{f"stats/{key}/{name}": value for name, value in _in_lists(facts["stats"]).items()},
    }


def _together(episodes: list[dict[str, float]]) -> dict[str, float]:
    """Statistics of all episodes by LeRobot's rules: quantiles are means of the episodes' quantiles."""
    stats = [one for one in episodes if one["count"]]
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
    """In LeRobot's shapes: one value of one channel as (1, 1, 1), the count as (1,)."""
    return {name: [int(value)] if name == "count" else [[[value]]] for name, value in stats.items()}


def _json(content: Any) -> bytes:
    return (json.dumps(content, indent=4, ensure_ascii=False) + "\n").encode()


def read_lerobot(path: Path, index: int) -> NDArray[np.float32]:
    """Depth of a frame, mm, read back from the video; its codes differ from those of `exporters.surface`."""
    with needed("av", "data", "LeRobot").open(str(path)) as file:
        frames = file.decode(file.streams.video[0])
        codes = next(islice(frames, index, None)).to_ndarray(format=PIXELS)
    return depth_from_lerobot_levels(codes)
