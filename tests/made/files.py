"""A LeRobot data set, version 3.0: one camera as a video, and the same images in its tables.

Small random networks, in plain numpy too, and files of them.

Uncompressed pictures as messages of ROS 2, and MCAP files of them, written out by hand.
"""

from __future__ import annotations

import json
import struct
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest

from gelform.slopes.color_models.networks import Layers

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


def visible(folder):
    """Every file of an output that is no leftover, with its bytes."""
    paths = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


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


def torch_file(path, arrays, *, nested=False):
    """A file of `torch.save`; the test is skipped without torch."""
    torch = pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    content = {name: torch.from_numpy(np.array(array)) for name, array in arrays.items()}
    torch.save({"epoch": 3, "state_dict": content} if nested else content, path)
    return path


def web_file(path, arrays=None):
    """A network of gsrobotics as its browser port has it, which needs no torch; random by default."""
    arrays = network_arrays((5, 64, 64, 64, 2)) if arrays is None else arrays
    np.concatenate([array.ravel() for array in arrays.values()]).astype("<f4").tofile(path)
    return path


def network_arrays(sizes, seed=0):
    """fc1.weight, fc1.bias, ... of random layers."""
    rng = np.random.default_rng(seed)
    arrays = {}
    for k, (n_in, n_out) in enumerate(pairwise(sizes), start=1):
        arrays[f"fc{k}.weight"] = rng.normal(0, n_in**-0.5, (n_out, n_in)).astype(np.float32)
        arrays[f"fc{k}.bias"] = rng.normal(0, 0.1, n_out).astype(np.float32)
    return arrays


def layers_of(sizes, seed=0):
    arrays = list(network_arrays(sizes, seed).values())
    return Layers(tuple(arrays[::2]), tuple(arrays[1::2]))


def in_numpy(layers, values):
    for k, (weight, bias) in enumerate(zip(layers.weights, layers.biases)):
        values = values @ weight.T.astype(float) + bias
        values = np.maximum(values, 0) if k + 1 < len(layers.weights) else values
    return values


def raw_message(pixels, encoding="rgb8", *, wall_time_ns=7, padding=0, frame_id="cam"):
    """sensor_msgs/Image in CDR of (H, W, 3) uint8; `padding` bytes at the end of each row."""
    height, width = pixels.shape[:2]
    rows = np.pad(pixels.reshape(height, -1), ((0, 0), (0, padding)))
    body = bytearray(struct.pack("<iI", *divmod(wall_time_ns, 10**9)))
    body += _text(frame_id, len(body))
    body += bytes(-len(body) % 4) + struct.pack("<II", height, width)
    body += _text(encoding, len(body)) + b"\0"
    body += bytes(-len(body) % 4) + struct.pack("<II", rows.shape[1], rows.size) + rows.tobytes()
    return b"\0\1\0\0" + bytes(body)


def _text(text, at):
    code = text.encode() + b"\0"
    return bytes(-at % 4) + struct.pack("<I", len(code)) + code


def image_file(path, topics, *, schema="sensor_msgs/msg/Image", before=0):
    """An MCAP file with one message on each topic, of {topic: message}; `before`: messages of joints that come first."""
    from mcap.writer import CompressionType, Writer

    with path.open("wb") as file:
        made = Writer(file, compression=CompressionType.NONE)
        made.start(profile="ros2")
        joints = made.register_schema("sensor_msgs/msg/JointState", "ros2msg", b"")
        pictures = made.register_schema(schema, "ros2msg", b"")
        other = made.register_channel("/joints", "cdr", joints)
        channels = {topic: made.register_channel(topic, "cdr", pictures) for topic in topics}
        for k in range(before):
            made.add_message(other, k, b"\0\1\0\0", k)
        for topic, messages in topics.items():
            for k, message in enumerate([messages] if isinstance(messages, bytes) else messages):
                made.add_message(channels[topic], 10**9 + k * 10**7, message, 0, 0)  # as rosbag2: no sequence
        made.finish()
    return path
