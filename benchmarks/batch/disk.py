"""A disk that becomes full during a batch, for each form of its outputs. See `batch.py`."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import Any

import gelform
from batch.faults import tree
from gelform.batch import BatchSettings, run_batch, verify_output
from gelform.errors import DataError

FORMS = ("npz", "png", "zarr", "hdf5", "lerobot")
KEY, FPS = "observation.images.gel", 30
EPISODE, EPISODES = 12, 3  # frames per episode; episodes
DISK_BYTES, SOON_BYTES = 64 << 20, 200_000  # size of the small disk; room on it that is soon used up


def disk(folder: Path, rounds: int) -> dict[str, Any]:
    """For each form: the error, the files that then differ from an undisturbed run's, and whether continuing gives that run.

    A LeRobot data set is also interrupted while its unchanged files are copied.
    """
    small = folder / "disk"
    small.mkdir()
    if not mounted(small):
        return {"left out": "a small file system cannot be mounted here"}
    subprocess.run(["umount", str(small)], check=True)
    data_set = make_lerobot_set(folder / "set", sorted((folder / "in").rglob("*.png")))
    rows = []
    for form in FORMS:
        source = data_set if form == "lerobot" else folder / "in"
        run_into(source, folder, folder / form, form)
        whole = tree(folder / form)
        rows.append(filled(source, folder, small, form, whole, SOON_BYTES))
        if form == "lerobot":
            every = size_of(folder / form) - size_of(data_set) // 2
            rows.append({**filled(source, folder, small, form, whole, every), "when": "copying the data set"})
    return {"rows": rows}


def filled(
    source: Path, folder: Path, small: Path, form: str, whole: dict[str, str], room: int
) -> dict[str, Any]:
    """A run into a disk with that many bytes of room, and the same run again with enough room."""
    with full_disk(small, room):
        said = ""
        try:
            run_into(source, folder, small / "out", form)
        except DataError as problem:
            said = str(problem).replace(f"{folder}/", "")
        there = tree(small / "out")
        altered = [name for name, digest in there.items() if whole.get(name) != digest]
        (small / "filler").unlink()
        complete = run_into(source, folder, small / "out", form)
        equal = complete and tree(small / "out") == whole and not verify_output(small / "out")[2]
    return {
        "form": form,
        "error": said,
        "files_then": len(there),
        "altered_then": altered,
        "equal_after": equal,
    }


def run_into(source: Path, folder: Path, output: Path, form: str) -> bool:
    """The same run each time; returns whether it is complete."""
    settings = BatchSettings(form, keep=("depth",), solver="dct", depth_sigma=False, part_frames=16)
    dataset = KEY if form == "lerobot" else ""
    return run_batch(source, folder / "cal.npz", output, settings, table="csv", dataset=dataset).complete


@contextmanager
def full_disk(small: Path, room: int) -> Iterator[None]:
    """A file system in memory on which the file `filler` takes all but `room` bytes."""
    assert mounted(small)
    try:
        (small / "filler").write_bytes(bytes(DISK_BYTES - room))
        yield
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)


def mounted(small: Path) -> bool:
    """Mount it, if that is allowed."""
    size = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(small)]
    return subprocess.run(size, capture_output=True).returncode == 0


def size_of(folder: Path) -> int:
    """Bytes of all files."""
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def make_lerobot_set(root: Path, images: list[Path]) -> Path:
    """A LeRobot data set (version 3.0) of some episodes of one camera, with lossless video."""
    import pyarrow
    from pyarrow import parquet

    frames = [gelform.read_image(path) for path in islice(images, EPISODE * EPISODES)]
    for path in ("meta/episodes/chunk-000", "data/chunk-000", f"videos/{KEY}/chunk-000"):
        (root / path).mkdir(parents=True)
    encode(root / f"videos/{KEY}/chunk-000/file-000.mp4", frames)
    told = {"video.codec": "h264", "video.pix_fmt": "gbrp", "video.crf": 0, "video.fps": FPS}
    names = ["height", "width", "channels"]
    features = {KEY: {"dtype": "video", "shape": [*frames[0].shape], "names": names, "info": told}}
    info = {
        "codebase_version": "v3.0",
        "fps": FPS,
        "features": features,
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4",
    }
    (root / "meta/info.json").write_text(json.dumps(info))
    (root / "meta/stats.json").write_text("{}")
    episodes = pyarrow.Table.from_pylist([episode_row(number) for number in range(EPISODES)])
    parquet.write_table(episodes, root / "meta/episodes/chunk-000/file-000.parquet")
    rows = [
        {
            "episode_index": k // EPISODE,
            "frame_index": k % EPISODE,
            "index": k,
            "timestamp": k % EPISODE / FPS,
        }
        for k in range(len(frames))
    ]
    parquet.write_table(pyarrow.Table.from_pylist(rows), root / "data/chunk-000/file-000.parquet")
    return root


def episode_row(number: int) -> dict[str, Any]:
    """The row of an episode in the table of episodes."""
    begin = EPISODE * number
    video = {"chunk_index": 0, "file_index": 0, "from_timestamp": begin / FPS, "to_timestamp": 0.0}
    return {
        "episode_index": number,
        "length": EPISODE,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": begin,
        "dataset_to_index": begin + EPISODE,
        **{f"videos/{KEY}/{name}": value for name, value in video.items()},
    }


def encode(path: Path, frames: list[Any]) -> None:
    """A lossless video of frames."""
    import av

    with av.open(str(path), "w") as file:
        stream = file.add_stream("libx264rgb", rate=FPS, options={"crf": "0", "g": "4"})
        stream.height, stream.width, stream.pix_fmt = *frames[0].shape[:2], "rgb24"
        for frame in frames:
            file.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        file.mux(stream.encode())
