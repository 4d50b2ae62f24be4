"""Depth as LeRobot's videos: HEVC of 12 bits without loss, one file per episode, and what its tables say of it.

LeRobot reads 12-bit codes as `depth_min + code / 4095 x (depth_max - depth_min)` metres and rounds to whole mm. With 0 and
4.095 m a code is its number of "mm", which here are um: v = 1000 + depth in um comes back as it went in, up to 3.095 mm.
(LeRobot's own logarithmic default reaches 9 mm, in steps of 1.5 to 4 um.)
"""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.extras import needed
from gelform.batch.outputs.places import FRAMES, PARTS, OutputFile, Place, output_file
from gelform.batch.outputs.video_file import Codec, VideoFile
from gelform.errors import DataError
from gelform.reconstruction import Reconstruction
from gelform.robots.lerobot_depth import UM_PER_MM, ZERO_LEVEL, lerobot_levels_from_depth

SUFFIX = "_depth"  # of the feature, as of the camera's
MAX_CODE = 4095
FILES_IN_A_CHUNK = 1000
EPISODES = "lerobot"  # folder beside the records of parts: what the tables are to say of each episode
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
X265 = "lossless=1"
KEY_FRAMES = 2  # every other frame, as LeRobot's own videos: any frame is quick to reach
CODEC = Codec(
    "libx265",
    "gray12le",
    "mp4",
    {
        "g": str(KEY_FRAMES),
        "preset": "ultrafast",
        "x265-params": f"{X265}:bframes=0:pools=none:frame-threads=1:log-level=none",
    },
)


class LerobotVideo:
    """Writes an episode's video, and its statistics and feature for the tables of the data set (see `lerobot_out`)."""

    def __init__(self, place: Place) -> None:
        self.files: list[OutputFile] = []
        self._place = place
        self._key, self._episode = episode_of(place.part.sequence)
        self._path = place.output / FRAMES / video_path(self._key + SUFFIX, self._episode)
        self._counts = np.zeros(MAX_CODE + 1, dtype=np.int64)
        self._length = 0
        av = needed("av", "lerobot", "LeRobot")
        self._video = VideoFile(av, self._path, place.shape, CODEC, place.part.rate_hz)

    def prepared(self, result: Reconstruction) -> NDArray[np.uint16]:
        """The levels, 1000 + depth in um."""
        levels = lerobot_levels_from_depth(result.depth_mm)
        if levels.max() > MAX_CODE:
            raise DataError(
                f"Expected depth up to {(MAX_CODE - ZERO_LEVEL) / UM_PER_MM:.3f} mm, which LeRobot's 12 bits hold in steps "
                f"of 1 um, got {result.depth_mm.max():.3f} mm. Look at the frame: gels are not pressed so deep."
            )
        return levels

    def add(self, name: str, index: int, prepared: NDArray[np.uint16] | None) -> dict[str, Any]:
        """Encode the next frame; level 0, unknown, where it has an error."""
        levels = np.zeros(self._place.shape, dtype=np.uint16) if prepared is None else prepared
        self._video.add(levels)
        self._counts += np.bincount(levels.ravel(), minlength=MAX_CODE + 1)
        self._length += 1
        return {} if prepared is None else {"output": self._place.name_of(self._path)}

    def __enter__(self) -> LerobotVideo:
        self._video.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._video.__exit__(*error)
        if error[0] is None:
            facts = {
                "key": self._key,
                "episode_index": self._episode,
                "length": self._length,
                "feature": self._feature(),
                "stats": statistics(self._counts, self._length),
            }
            path = self._place.output / PARTS / EPISODES / f"{self._place.part.sequence}.json"
            self.files.append(output_file(self._place.output, self._path))
            self.files.append(self._place.write(path, json.dumps(facts).encode()))

    def _feature(self) -> dict[str, Any]:
        """What `meta/info.json` says of the depth: LeRobot's entries, and where it comes from."""
        height, width = self._place.shape
        video = {"height": height, "width": width, "codec": "hevc", "pix_fmt": CODEC.pix_fmt, "channels": 1}
        encoder = {
            "g": KEY_FRAMES,
            "preset": CODEC.options["preset"],
            "fast_decode": 0,
            "video_backend": "pyav",
        }
        codes = {"depth_min": 0.0, "depth_max": MAX_CODE / 1000, "shift": 0.0, "use_log": False}
        more = {"fps": self._place.part.rate_hz, "extra_options": {"x265-params": X265}}
        said = {f"video.{name}": value for name, value in {**video, **more, **encoder, **codes}.items()}
        ours = {f"gelform.{name}": value for name, value in self._place.facts.items()}
        ours["gelform.encoding"] = "1000 + depth in um, which LeRobot calls mm; 0: unknown"
        info = {**said, "has_audio": False, "is_depth_map": True, "depth_unit": "mm", **ours}
        names = ["height", "width", "channels"]
        return {"dtype": "video", "shape": [height, width, 1], "names": names, "info": info}


def episode_of(sequence: str) -> tuple[str, int]:
    """The camera and the episode that a sequence of a LeRobot data set is named for.

    Raises
    ------
    DataError
        It is none.
    """
    key, found, number = sequence.rpartition("/episode_")
    if not (key and found and number.isdecimal()):
        raise DataError(
            f"Expected an episode of a LeRobot data set, got {sequence or 'a folder of images'}. Write another format."
        )
    return key, int(number)


def place_of_video(episode: int) -> tuple[int, int]:
    """Chunk and file of an episode's video."""
    return divmod(episode, FILES_IN_A_CHUNK)


def video_path(key: str, episode: int) -> str:
    """Of an episode's video, below the data set."""
    chunk, file = place_of_video(episode)
    return VIDEO_PATH.format(video_key=key, chunk_index=chunk, file_index=file)


def statistics(counts: NDArray[np.int64], frames: int) -> dict[str, float]:
    """Least, greatest, mean, standard deviation, number of frames and quantiles of levels that were counted."""
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
