"""A listing in parts: the pieces of work that are done, recorded and repeated as wholes."""

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
    """Some images of a sequence, or all of a video or a recording; small, so that it can be sent to another process.

    Attributes
    ----------
    number : its place in the plan, from 0; it belongs to no shard
    sequence : the name of the sequence that it is a part of
    path : the folder of its images, the video, or the recording
    start : place of its first image in the sequence
    images : names of its images; empty for a video or a recording
    names : what each image's output is called, without its ending
    first : the first images of the sequence, where they make its background
    total : frames of the whole sequence; 0 where they are not counted yet
    dataset, offset : where the sequence is in a larger file (see `Sequence`); empty for images, videos and recordings
    count : frames of such a part
    rate_hz : frames a second of a LeRobot data set; else 0
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

    @property
    def frames(self) -> int:
        """How many there are in the part; 0 where they are not counted yet."""
        return len(self.images) or self.count

    def input_digest(self) -> str:
        """SHA-256 of its files' names and sizes: another one means that a file was replaced, and the part is done again."""
        sha = hashlib.sha256(os.fsencode(self.sequence))
        for path in self._files():
            try:
                size = os.stat(path).st_size
            except OSError:
                size = -1  # reading it says why
            sha.update(os.fsencode(f"\n{os.path.basename(path)} {size}"))
        sha.update(
            os.fsencode(f"\n{self.dataset} {self.offset} {self.start} {self.count}") if self.dataset else b""
        )
        return sha.hexdigest()

    def _files(self) -> list[str]:
        """As text: there may be millions."""
        folder = os.fspath(self.path)
        if self.images:
            return [f"{folder}/{one}" for one in (*self.first, *self.images)]
        if self.dataset and self.path.is_dir():
            return [f"{folder}/{self.dataset}/{name}" for name in NODES]
        return sorted(f"{folder}/{one}" for one in os.listdir(folder)) if self.path.is_dir() else [folder]


def plan_of(listing: Listing, part_frames: int, background_frames: int = 0) -> list[Part]:
    """All parts, of so many images at most, in the order of the listing; with the first frames that make a background."""
    parts: list[Part] = []
    for sequence in listing.sequences:
        pieces = _ranges if sequence.dataset else _pieces
        for piece in pieces(sequence, part_frames):
            where: dict[str, Any] = {"number": len(parts), "sequence": sequence.name, "path": sequence.path}
            first = sequence.images[:background_frames]
            total = len(sequence.images) or sequence.count
            parts.append(Part(**where, **piece, first=first, total=total))
    return parts


def shard_of(parts: Several[Part], shard: tuple[int, int]) -> list[Part]:
    """The parts of shard i of N, counted from 1 (DataError): every N-th, so that long sequences are spread."""
    number, count = shard
    if not 1 <= number <= count:
        raise DataError(f"Expected a shard from 1/{count} to {count}/{count}, got {number}/{count}.")
    return list(parts[number - 1 :: count])


def _pieces(sequence: Sequence, part_frames: int) -> Iterator[dict[str, Any]]:
    """Of images, or all of a film; a name is the stem, where no other image of the sequence has the same."""
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
    """Of a dataset; one that cannot be read is one part, which says why."""
    inside = {"dataset": sequence.dataset, "offset": sequence.offset, "rate_hz": sequence.rate_hz}
    for start in range(0, max(1, sequence.count), part_frames):
        yield {**inside, "start": start, "count": min(part_frames, sequence.count - start)}
