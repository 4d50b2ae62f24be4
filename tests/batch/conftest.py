"""A small data set: two folders of images of a gel that is known exactly, one of them with what is no frame."""

import json

import cv2
import numpy as np
import pytest

from made.small_gel import SHAPE, Touch, calibration, image_of, save

COUNT = 4  # images in each folder
KEY, STORED, FPS = "observation.images.gel", "observation.images.still", 30
EPISODES = (3, 4, 2)  # frames of LeRobot's


@pytest.fixture(scope="session")
def images():
    """Images of touches at several depths."""
    return [image_of(Touch(depth_mm=0.2 + 0.05 * k, seed=k)) for k in range(COUNT)]


@pytest.fixture
def tree(tmp_path, images):
    """in/frame*.png and in/day2/frame*.png; the tenth comes after the second."""
    for folder in (tmp_path / "in", tmp_path / "in" / "day2"):
        folder.mkdir()
        for number, image in zip((1, 2, 10, 11), images):
            save(folder / f"frame{number}.png", image)
    return tmp_path / "in"


@pytest.fixture
def broken_tree(tree, images):
    """The same with a truncated image, one of another size, an empty one and a text among them."""
    whole = (tree / "frame1.png").read_bytes()
    (tree / "cut.png").write_bytes(whole[: len(whole) // 2])
    (tree / "empty.png").write_bytes(b"")
    (tree / "text.png").write_text("no picture at all\n")
    save(tree / "wide.png", np.hstack([images[0], images[0]]))
    return tree


@pytest.fixture(scope="session")
def cal():
    return calibration()


@pytest.fixture
def film(tmp_path, images):
    """A video of the touches, without loss."""
    path = tmp_path / "press.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), 25, SHAPE[::-1])
    if not writer.isOpened():
        pytest.skip("this build of OpenCV cannot write FFV1")
    for image in images:
        writer.write(np.ascontiguousarray(image[..., ::-1]))
    writer.release()
    return path


@pytest.fixture
def visible():
    """Every file of an output that is no leftover, with its bytes."""

    def files(folder):
        paths = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
        return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}

    return files


@pytest.fixture
def lerobot(tmp_path, images):
    """A LeRobot data set with the same touches as a video and as images in its tables; gives the folder and the frames.

    The video holds all episodes, the second table the last one.
    """
    pytest.importorskip("av", reason="the extra lerobot is not installed")
    pytest.importorskip("pyarrow", reason="the extra lerobot is not installed")
    root, frames = tmp_path / "set", [images[k % len(images)] for k in range(sum(EPISODES))]
    encoded(root / f"videos/{KEY}/chunk-000/file-000.mp4", frames)
    told = {"video.codec": "h264", "video.pix_fmt": "gbrp", "video.crf": 0, "video.fps": FPS}
    features = {
        KEY: {"dtype": "video", "shape": [*SHAPE, 3], "names": ["height", "width", "channels"], "info": told},
        STORED: {"dtype": "image", "shape": [*SHAPE, 3], "names": ["height", "width", "channels"]},
        "action": {"dtype": "float32", "shape": [2], "names": None},
    }
    paths = {
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    info = {"codebase_version": "v3.0", "fps": FPS, "features": features, **paths}
    (root / "meta").mkdir()
    (root / "meta/info.json").write_text(json.dumps(info))
    (root / "meta/stats.json").write_text(json.dumps({"action": {"mean": [0.0, 0.0]}}))
    rows = list(episode_rows())
    as_parquet(root / "meta/episodes/chunk-000/file-000.parquet", rows[::-1])
    for file, episodes in enumerate(((0, 1), (2,))):
        cells = [cell for k in episodes for cell in data_rows(rows[k], frames)]
        as_parquet(root / f"data/chunk-000/file-{file:03d}.parquet", cells, row_group_size=2)
    return root, frames


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


@pytest.fixture
def encode():
    """Writes a video of frames."""
    return encoded
