"""A recording as a folder of images with their times, written and read; needs no extra."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from gelform.errors import DataError
from gelform.image.frame import Frame
from gelform.sensors.playback import Playback
from gelform.sensors.recordings.facts import (
    RecordingFacts,
    RecordingSummary,
    encoded_from_frame,
    image_from_encoded,
    playback_of,
    reduction_in,
    unwritable,
)

TIMES, FACTS, COLUMNS = "frames.csv", "recording.json", "index,time_s,wall_time_ns,image"
SUFFIX = {"png": ".png", "jpeg": ".jpg"}


class FolderRecording:
    """A folder that is being written: one image per frame, `frames.csv` with the times, `recording.json`.

    Each line of `frames.csv` is written after its image and handed to the system at once. A recorder that is killed loses
    only the current frame.

    Parameters
    ----------
    path : a new or empty folder
    facts : of the camera
    attached : attached files by name: `attachments_of`

    Raises
    ------
    DataError
        The folder is not empty or cannot be written.
    """

    def __init__(
        self, path: Path, facts: RecordingFacts, attached: Mapping[str, bytes] | None = None
    ) -> None:
        self.path = path
        was_there = path.exists()
        try:
            path.mkdir(parents=True, exist_ok=True)
            if any(path.iterdir()):
                raise DataError(f"{path} is there already and not empty. Give another name, or empty it.")
            self._facts = json.loads(facts.to_json())
            self._write_facts(finished=False)
            for name, content in (attached or {}).items():
                (path / name).write_bytes(content)
            self._times = (path / TIMES).open("x", encoding="ascii", newline="\n")
            self._times.write(COLUMNS + "\n")
            self._times.flush()
        except OSError as problem:
            for name in (f".{FACTS}", FACTS, TIMES, *(attached or ())):
                (path / name).unlink(missing_ok=True)
            if not was_there and path.is_dir():
                path.rmdir()
            raise DataError(f"Cannot write {path}: {problem.strerror}.") from problem
        self._first_s: float | None = None

    def write(self, frame: Frame) -> int:
        """Add a frame; return its size in bytes."""
        self._first_s = frame.time_s if self._first_s is None else self._first_s
        picture_format, content = encoded_from_frame(frame)
        name = f"{frame.index:08d}{SUFFIX[picture_format]}"
        time_s = frame.time_s - self._first_s
        try:
            (self.path / name).write_bytes(content)
            self._times.write(f"{frame.index},{time_s:.6f},{frame.wall_time_ns},{name}\n")
            self._times.flush()
        except OSError as problem:
            raise unwritable(self.path, problem) from problem
        return len(content)

    def flush_if_due(self) -> None:
        """Nothing to do: every frame is written at once."""

    def close(self) -> None:
        """Close the table and mark the recording as finished."""
        if self._times.closed:
            return
        try:
            self._times.close()
            self._write_facts(finished=True)
        except OSError as problem:
            raise unwritable(self.path, problem) from problem

    def _write_facts(self, *, finished: bool) -> None:
        """Replace recording.json in one step, so that it stays readable if the recorder is killed."""
        fresh = self.path / f".{FACTS}"
        fresh.write_text(json.dumps({**self._facts, "finished": finished}), encoding="utf-8")
        os.replace(fresh, self.path / FACTS)


def is_recorded_folder(path: Path) -> bool:
    """Whether a folder was written by a FolderRecording."""
    return (path / FACTS).is_file() and (path / TIMES).is_file()


def recorded_folder_playback(path: Path, *, paced: bool = False) -> Playback:
    """The frames of a recorded folder, with `time_s` counted from the first.

    DataError: its tables are damaged; in a loop: an image is missing or damaged.
    """
    facts = facts_of_folder(path)
    reduction = reduction_in(facts.settings)
    return playback_of(facts, lambda: (frame_of_row(path, row, reduction) for row in rows_of(path)), paced)


def facts_of_folder(path: Path) -> RecordingFacts:
    """The facts of a recorded folder about its camera; DataError if they are damaged."""
    return RecordingFacts.from_json((path / FACTS).read_text(encoding="utf-8"), str(path / FACTS))


def folder_summary(path: Path) -> RecordingSummary:
    """Count the frames of a recorded folder without reading them; the recorder marked at its end that it was finished."""
    text = (path / FACTS).read_text(encoding="utf-8")
    facts = RecordingFacts.from_json(text, str(path / FACTS))
    lines = _lines(path)
    whole = [_row(path, line) for line in lines if line.endswith("\n")]
    duration_s = whole[-1][0] - whole[0][0] if whole else 0.0
    finished = bool(json.loads(text).get("finished")) and len(whole) == len(lines)
    return RecordingSummary(facts, len(whole), duration_s, finished)


def _lines(path: Path) -> list[str]:
    """The lines of the table below its header; the last one lacks its line end if the recorder was killed."""
    lines = (path / TIMES).read_text(encoding="ascii", errors="replace").splitlines(keepends=True)
    if not lines or lines[0].strip() != COLUMNS:
        raise DataError(f"Expected the columns {COLUMNS} in {path / TIMES}, got {lines[:1]}.")
    return lines[1:]


def _row(path: Path, line: str) -> tuple[float, int, int, str]:
    """(time_s, wall_time_ns, index, image name) of a line."""
    try:
        index, time_s, wall_time_ns, name = line.strip().split(",")
        return float(time_s), int(wall_time_ns), int(index), Path(name).name
    except ValueError as problem:
        raise DataError(f"{path / TIMES} is damaged: {line.strip()!r} is no line of it.") from problem


def rows_of(path: Path) -> Iterator[tuple[float, int, int, str]]:
    """(time_s, wall_time_ns, index, image name) of each frame; a line without its line end is skipped."""
    for line in _lines(path):
        if not line.endswith("\n"):
            return  # the recorder was killed while writing this line
        yield _row(path, line)


def frame_of_row(path: Path, row: tuple[float, int, int, str], reduction: int) -> Frame:
    """The frame of a row; DataError if its image is missing or damaged."""
    time_s, wall_time_ns, index, name = row
    file = path / name
    try:
        content = file.read_bytes()
    except OSError as problem:
        raise DataError(f"Cannot read {problem.filename}: {problem.strerror}.") from problem
    image = image_from_encoded(content, reduction, str(file))
    return Frame(image, time_s, wall_time_ns, index, content if file.suffix == ".jpg" else None)
