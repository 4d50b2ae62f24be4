"""A listing split into parts: the units that are done, recorded and repeated as a whole."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterator
from collections.abc import Sequence as Several
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gelform.batch.inputs.containers import NODES, Sequence
from gelform.batch.inputs.listing import Listing
from gelform.errors import DataError


@dataclass(frozen=True)
class Part:
    """Some images of a sequence, or a whole video or recording; small, so that it can be sent to another process.

    Attributes
    ----------
    number : its position in the plan, from 0; independent of shards
    sequence : the name of its sequence
    path : the folder of its images, the video, or the recording
    start : position of its first image in the sequence
    images : names of its images; empty for a video or a recording
    names : name of each image's output, without ending
    first : the first images of the sequence, if they make its background
    total : frames of the whole sequence; 0 if not counted yet
    dataset, offset : place of the sequence in a larger file (see `Sequence`); empty for images, videos and recordings
    count : frames of such a part
    rate_hz : frames per second of a LeRobot data set; else 0
    bgr : whether its channels are in the order blue, green, red
    """

    number: int
    sequence: str
    path: Path
    start: int = 0
    images: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    first: tuple[str, ...] = ()
    total: int = 0
    dataset: str = ""
    offset: int = 0
    count: int = 0
    rate_hz: int = 0
    bgr: bool = False

    @property
    def frames(self) -> int:
        """Number of frames in the part; 0 if not counted yet."""
        return len(self.images) or self.count

    def input_digest(self) -> str:
        """SHA-256 of its files' names and sizes; if a file was replaced, it differs and the part is done again."""
        sha = hashlib.sha256(os.fsencode(self.sequence))
        for path in self._files():
            try:
                size = os.stat(path).st_size
            except OSError:
                size = -1  # reading it gives the error
            sha.update(os.fsencode(f"\n{os.path.basename(path)} {size}"))
        sha.update(
            os.fsencode(f"\n{self.dataset} {self.offset} {self.start} {self.count}") if self.dataset else b""
        )
        return sha.hexdigest()

    def _files(self) -> list[str]:
        """Paths as text, because there may be millions."""
        folder = os.fspath(self.path)
        if self.images:
            return [f"{folder}/{one}" for one in (*self.first, *self.images)]
        if self.dataset and self.path.is_dir():
            return [f"{folder}/{self.dataset}/{name}" for name in NODES]
        return sorted(f"{folder}/{one}" for one in os.listdir(folder)) if self.path.is_dir() else [folder]


def plan_of(listing: Listing, part_frames: int, background_frames: int = 0, bgr: bool = False) -> list[Part]:
    """All parts with at most `part_frames` images, in the order of the listing, with the first frames for a background."""
    parts: list[Part] = []
    for sequence in listing.sequences:
        pieces = _ranges if sequence.dataset else _pieces
        for piece in pieces(sequence, part_frames):
            where: dict[str, Any] = {"number": len(parts), "sequence": sequence.name, "path": sequence.path}
            first = sequence.images[:background_frames]
            total = len(sequence.images) or sequence.count
            parts.append(Part(**where, **piece, first=first, total=total, bgr=bgr))
    return parts


def shard_of(parts: Several[Part], shard: tuple[int, int]) -> list[Part]:
    """The parts of shard i of N, counted from 1: every N-th, which spreads long sequences. DataError if out of range."""
    number, count = shard
    if not 1 <= number <= count:
        raise DataError(f"Expected a shard from 1/{count} to {count}/{count}, got {number}/{count}.")
    return list(parts[number - 1 :: count])


def _pieces(sequence: Sequence, part_frames: int) -> Iterator[dict[str, Any]]:
    """Pieces of a folder of images, or a whole video. A name is the file's stem if that is unique in the sequence."""
    if not sequence.images:
        yield {}
    stems = [os.path.splitext(one)[0] for one in sequence.images]
    counts = Counter(stems)
    names = [one if counts[stem] > 1 else stem for one, stem in zip(sequence.images, stems)]
    for start in range(0, len(names), part_frames):
        stop = start + part_frames
        yield {
            "start": start,
            "images": sequence.images[start:stop],
            "names": tuple(names[start:stop]),
        }


def _ranges(sequence: Sequence, part_frames: int) -> Iterator[dict[str, Any]]:
    """Ranges of a dataset; an unreadable dataset is one part, whose reading gives the error."""
    inside = {"dataset": sequence.dataset, "offset": sequence.offset, "rate_hz": sequence.rate_hz}
    for start in range(0, max(1, sequence.count), part_frames):
        yield {**inside, "start": start, "count": min(part_frames, sequence.count - start)}
