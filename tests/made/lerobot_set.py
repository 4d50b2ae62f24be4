"""A LeRobot data set, version 3.0: one camera as a video, and the same images in its tables."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np

KEY, STORED, FPS = "observation.images.gel", "observation.images.still", 30
EPISODES = (3, 4, 2)  # frames of each


def write_lerobot_set(root: Path, frames: list[np.ndarray]) -> None:
    """Write a set of as many images (H, W, 3), uint8, as the episodes have.

    The video holds all episodes, the second table the last one. Needs the extra `data`.
    """
    shape = frames[0].shape
    told = {"video.codec": "h264", "video.pix_fmt": "gbrp", "video.crf": 0, "video.fps": FPS}
    features = {
        KEY: {"dtype": "video", "shape": [*shape], "names": ["height", "width", "channels"], "info": told},
        STORED: {"dtype": "image", "shape": [*shape], "names": ["height", "width", "channels"]},
        "action": {"dtype": "float32", "shape": [2], "names": None},
    }
    paths = {
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    info = {"codebase_version": "v3.0", "fps": FPS, "features": features, **paths}
    (root / "meta").mkdir(parents=True)
    (root / "meta/info.json").write_text(json.dumps(info))
    (root / "meta/stats.json").write_text(json.dumps({"action": {"mean": [0.0, 0.0]}}))
    encoded(root / f"videos/{KEY}/chunk-000/file-000.mp4", frames)
    rows = list(episode_rows())
    as_parquet(root / "meta/episodes/chunk-000/file-000.parquet", rows[::-1])
    for file, episodes in enumerate(((0, 1), (2,))):
        cells = [cell for k in episodes for cell in data_rows(rows[k], frames)]
        as_parquet(root / f"data/chunk-000/file-{file:03d}.parquet", cells, row_group_size=2)


def encoded(path, frames, codec="libx264rgb", pixels="rgb24", **options):
    """Write a video of frames, without loss."""
    import av

    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as file:
        stream = file.add_stream(codec, rate=FPS, options=options or {"crf": "0", "g": "4"})
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = pixels
        for frame in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())


def as_parquet(path, rows, **how):
    """Write dicts as a table."""
    import pyarrow
    from pyarrow import parquet

    path.parent.mkdir(parents=True, exist_ok=True)
    parquet.write_table(pyarrow.Table.from_pylist(rows), path, **how)


def episode_rows():
    """What LeRobot's table says of each episode."""
    begin = 0
    for k, length in enumerate(EPISODES):
        video = {"chunk_index": 0, "file_index": 0, "from_timestamp": begin / FPS, "to_timestamp": 0.0}
        yield {
            "episode_index": k,
            "length": length,
            "data/chunk_index": 0,
            "data/file_index": int(k == 2),
            "dataset_from_index": begin,
            "dataset_to_index": begin + length,
            **{f"videos/{KEY}/{name}": value for name, value in video.items()},
        }
        begin += length


def data_rows(episode, frames):
    """Rows of LeRobot's table of frames, each with its image as PNG."""
    for k in range(episode["length"]):
        index = episode["dataset_from_index"] + k
        _, png = cv2.imencode(".png", np.ascontiguousarray(frames[index][..., ::-1]))
        cell = {"bytes": png.tobytes(), "path": None}
        where = {"episode_index": episode["episode_index"], "frame_index": k, "index": index}
        yield {STORED: cell, "action": [0.0, 1.0], "timestamp": k / FPS, **where}
