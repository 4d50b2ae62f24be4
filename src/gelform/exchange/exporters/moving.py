"""A simulated press that moves, in the files that recordings and data sets come in, with its true motion."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from gelform.arrays import Array, Image
from gelform.errors import DataError, needed
from gelform.exchange.exporters.press_folder import write_csv, written_whole
from gelform.foundations.pictures import picture_bytes
from gelform.image.frame import Frame
from gelform.sensors.playback import RecordingFacts
from gelform.sensors.recordings.mcap_writer import McapRecording
from gelform.simulate import Indenter, Pose, SimulatedSensor, Twin, simulate_sequence

Images = Sequence[Array]


def save_moving_press(
    folder: Path,
    look: SimulatedSensor | Twin,
    pressed: Indenter,
    forms: Sequence[str],
    depth_mm: float,
    seed: int,
) -> None:
    """Simulate an object that is pressed in, slides and turns; write its frames in some of `FORMS`.

    motion.csv has the object's true pose in each frame. The folder appears complete or not at all; DataError if it holds
    something or cannot be written.
    """
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 1)))
    # Frames: rest until, pressed and sliding from, until, off the gel from, last. `track` compares with the first contact,
    # so the object goes in within one frame: a contact that grows has another surface.
    steps = (5, 6, 30, 31, 35)
    deep, slid = (np.interp(range(steps[-1] + 1), steps, at) for at in ((0, 1, 1, 0, 0), (0, 0, 1, 1, 1)))
    poses = [Pose(depth_mm * d, (0.9 * s, 0.4 * s), 4.0 * s) for d, s in zip(deep, slid)]  # mm, degrees
    images: list[Image] = []
    rows: list[dict[str, str]] = []
    twin = look if isinstance(look, Twin) else None
    sensor = look.sensor if isinstance(look, Twin) else look
    for press in simulate_sequence(sensor, pressed, poses, rng=None if twin else rng):
        if press is not None:  # the camera may drop a frame
            images.append(twin.rendered(press, rng).image if twin else press.image)
            names = ("index", "depth_mm", "x_mm", "y_mm", "turn_deg")
            numbers = (len(rows), press.press_depth_mm, *press.center_mm, press.pose.spin_deg)
            rows.append({name: f"{number:.6g}" for name, number in zip(names, numbers)})
    with written_whole(folder) as partial:
        for file, write, *_ in (FORMS[form] for form in dict.fromkeys(forms)):
            write(partial / file, images, sensor.timing.frame_rate_hz)
        write_csv(partial / "motion.csv", rows)


def check_forms(forms: Sequence[str]) -> None:
    """Raise DataError, naming the extra, unless the modules that the forms need are installed."""
    for form in forms:
        for module in FORMS[form][2]:
            needed(module, FORMS[form][3], f"--as {form}")


def _write_video(path: Path, images: Images, rate_hz: float) -> None:
    height, width = images[0].shape[:2]
    video = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), rate_hz, (width, height))  # lossless
    if not video.isOpened():
        raise DataError(f"OpenCV cannot write {path.name} here: it was built without FFV1. Use --as mcap.")
    for image in images:
        video.write(np.ascontiguousarray(image[..., ::-1]))
    video.release()


def _write_mcap(path: Path, images: Images, rate_hz: float) -> None:
    recording = McapRecording(path, RecordingFacts("simulated press", rate_hz=rate_hz))
    start_ns = 1_767_225_600_000_000_000  # UTC of the first frame: 2026-01-01
    for k, image in enumerate(images):
        recording.write(Frame(image, k / rate_hz, start_ns + round(k / rate_hz * 1e9), k))
    recording.close()


def _write_hdf5(path: Path, images: Images, rate_hz: float) -> None:
    with needed("h5py", "data", "HDF5").File(path, "w") as file:
        file.create_dataset("data/demo_0/obs/gel", data=np.stack(images), compression="gzip")


def _write_lerobot(root: Path, images: Images, rate_hz: float) -> None:
    """One episode of version 3.0, with its images in the table of frames."""
    parquet, pyarrow = (needed(name, "data", "LeRobot") for name in ("pyarrow.parquet", "pyarrow"))
    camera, count, file = "observation.images.gel", len(images), "chunk-000/file-000.parquet"
    feature = {"dtype": "image", "shape": images[0].shape, "names": ["height", "width", "channels"]}
    info = {"codebase_version": "v3.0", "fps": round(rate_hz), "features": {camera: feature}}
    info["data_path"] = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
    episode = {"episode_index": 0, "length": count, "data/chunk_index": 0, "data/file_index": 0}
    episode |= {"dataset_from_index": 0, "dataset_to_index": count}
    rows = [
        {camera: {"bytes": picture_bytes(image), "path": None}, "timestamp": k / round(rate_hz)}
        | {"episode_index": 0, "frame_index": k, "index": k}
        for k, image in enumerate(images)
    ]
    for name, table in (("meta/episodes", [episode]), ("data", rows)):
        (root / name / file).parent.mkdir(parents=True)
        parquet.write_table(pyarrow.Table.from_pylist(table), root / name / file)
    (root / "meta/info.json").write_text(json.dumps(info), encoding="utf-8")


# form -> name of the file or folder, writer, modules that it needs, and their extra
FORMS: dict[str, tuple[str, Any, tuple[str, ...], str]] = {
    "video": ("moving.avi", _write_video, (), ""),
    "mcap": ("moving.mcap", _write_mcap, ("mcap.writer", "rosbags.typesys"), "mcap"),
    "hdf5": ("moving.h5", _write_hdf5, ("h5py",), "data"),
    "lerobot": ("lerobot", _write_lerobot, ("pyarrow.parquet",), "data"),
}
