"""A sequence of frames, and the order of names."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Sequence:
    """Frames that belong together: the images of one folder, a video, a recording, or an episode in a larger file.

    Attributes
    ----------
    name : its path below the input, with /; empty for the input's own folder
    path : the folder of its images, the video, the recording, or the HDF5 file, Zarr store or LeRobot video
    images : names of the images in natural order; empty for all others, of which a video's frames are not counted yet
    dataset : path inside the file or store; of LeRobot the camera; empty for images, videos and recordings
    offset, count : which frames of the dataset; count is 0 where the file cannot be read, which reading it says
    rate_hz : frames a second of LeRobot's episodes; 0 of all others
    """

    name: str
    path: Path
    images: tuple[str, ...] = ()
    dataset: str = ""
    offset: int = 0
    count: int = 0
    rate_hz: int = 0


def natural(name: str) -> tuple[list[str | int], str]:
    """Sorts image2 before image10."""
    return [int(part) if part.isdecimal() else part for part in re.split(r"(\d+)", name)], name
