"""Folders that appear completely or not at all: simulated presses, press folders, and a press that moves, with its motion.

Several processes write a data set; its bytes do not depend on their number.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike

from gelform import __version__
from gelform.arrays import Array, Image
from gelform.errors import DataError, Progress, cannot, needed, no_progress
from gelform.foundations.checks import (
    check_image,
    check_is,
    check_list,
    check_mm_per_px,
    check_numbers,
    check_path,
    check_positive,
)
from gelform.foundations.files import locked_folder, picture_bytes, sweep, table_text
from gelform.foundations.processes import interrupt_held, worker_processes
from gelform.image.view import Frame
from gelform.sensors.files import SensorSettings
from gelform.sensors.mcap import McapRecording
from gelform.sensors.playback import RecordingFacts
from gelform.simulate import (
    Indenter,
    Pose,
    SimulatedPress,
    SimulatedPresses,
    SimulatedSensor,
    Twin,
    simulate_background,
    simulate_press,
    simulate_sequence,
)
from gelform.simulate.press import ball_press_of_set, check_balls
from gelform.simulate.sensor import settings_from_sensor


@contextmanager
def written_whole(target: Path) -> Iterator[Path]:
    """A temporary folder next to `target`; it gets that name if the block ends without an error, else it is deleted."""
    with cannot(f"write into {target.parent}"):
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise DataError(
                f"Expected a new or empty folder, got {target}, which holds something. Choose another name."
            )
        target.parent.mkdir(parents=True, exist_ok=True)
        sweep(target.parent, target.name)
        partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.partial-", dir=target.parent))
    try:
        with cannot(f"write {target}", "Nothing of it was kept."):
            with locked_folder(partial):
                check_room(partial)
                yield partial
                with suppress(OSError):  # a file system without times
                    os.utime(partial)  # it has no lock from now on; `sweep` spares it for a minute
            mask = os.umask(0)  # the one way to ask for it
            os.umask(mask)
            partial.chmod(0o777 & ~mask)
            if target.exists():
                target.rmdir()
            partial.rename(target)
    finally:
        shutil.rmtree(partial, ignore_errors=True)  # if it did not get its name


def check_room(folder: Path) -> None:
    """Write a few kilobytes into a folder and delete them: a full disk raises OSError before the work, not after."""
    with tempfile.TemporaryFile(dir=folder) as probe:
        probe.write(bytes(16_384))  # several blocks of any file system


def toml_of_settings(settings: SensorSettings) -> str:
    """The text of a `sensor.toml`: name, scale, unit, gel, view and the camera's settings, as far as known."""
    import tomlkit  # imported here, because most commands import this module and write no such file

    known = ("mm_per_px_sigma", "make", "serial", "gel_id", "gel_thickness_mm")
    content: dict[str, Any] = {"name": settings.name, "mm_per_px": settings.mm_per_px}
    content |= {name: value for name in known if (value := getattr(settings, name)) not in (None, "")}
    tables = {"view": settings.view.to_dict(), "camera": dict(settings.camera)}
    return tomlkit.dumps(content | {name: table for name, table in tables.items() if table})


def write_csv(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    """Write rows with equal keys, which become the header."""
    text = table_text([list(rows[0]), *(row.values() for row in rows)])
    path.write_text(text, encoding="utf-8", newline="")


def write_png(path: Path, image: ArrayLike, shape: tuple[int, int] | None = None) -> None:
    """Write an RGB image (H, W, 3), rounded to 8 bits, as PNG; check it against a shape (H, W) if there is one."""
    pixels = check_image(image, shape=shape, name=path.name)
    if pixels.dtype != np.uint8:
        pixels = np.rint(pixels).astype(np.uint8)
    path.write_bytes(picture_bytes(pixels))


def save_simulated_press(
    folder: str | os.PathLike[str],
    sensor: SimulatedSensor,
    indenter: Indenter,
    *,
    depth_mm: float,
    seed: int = 0,
    twin: Twin | None = None,
) -> Path:
    """Simulate one press and write it: background.png, image.png, truth.npz, parameters.json, sensor.toml.

    With a `twin` the images are the twin's, and `sensor` is its sensor. The folder appears complete or not at all.

    DataError: the folder is not empty or cannot be written. ValueError: the press is impossible; see `simulate_press`.
    """
    rng = np.random.default_rng(seed)
    press = simulate_press(sensor, indenter, depth_mm=depth_mm, rng=rng)
    background = simulate_background(sensor, rng) if twin is None else twin.background
    if twin is not None:
        press = twin.rendered(press, rng)
    target = Path(folder)
    with written_whole(target) as partial:
        write_png(partial / "background.png", background)
        write_png(partial / "image.png", press.image)
        write_truth(partial / "truth.npz", press, {"seed": seed}, mm_per_px=np.float64(sensor.mm_per_px))
        _write_parameters(partial, sensor, twin, seed=seed)
    return target


def _write_parameters(folder: Path, sensor: SimulatedSensor, twin: Twin | None, **others: Any) -> None:
    """Write sensor.toml, and parameters.json with everything that determines the images."""
    like = None if twin is None else twin.look.name
    parameters = {"sensor": settings_from_sensor(sensor), "like": like, "gelform_version": __version__}
    text = json.dumps({**parameters, **others}, indent=1, sort_keys=True)
    (folder / "parameters.json").write_text(text + "\n", encoding="utf-8")
    settings = SensorSettings(sensor.name, float(sensor.mm_per_px))
    (folder / "sensor.toml").write_text(toml_of_settings(settings), encoding="utf-8")


def write_truth(path: Path, press: SimulatedPress, meta: Mapping[str, Any], **arrays: Any) -> None:
    """Write the truth of a press as .npz; `meta` is added to its pose as JSON, `arrays` to its arrays."""
    pose = {
        "depth_mm": press.press_depth_mm,
        "center_mm": list(press.center_mm),
        "spin_deg": press.pose.spin_deg,
        "tilt_deg": list(press.pose.tilt_deg),
        "time_s": press.time_s,
    }
    names = ("albedo", "shadowed", "saturated", "markers_px", "markers_shift_mm")
    maps = {**arrays, **truth_from_press(press), **{name: getattr(press, name) for name in names}}
    text = json.dumps({**meta, **pose, "indenter": repr(press.indenter)}, sort_keys=True)
    np.savez_compressed(path, **maps, meta=np.array(text))


def truth_from_press(press: SimulatedPress) -> dict[str, Any]:
    """The saved truth of a simulated press: depth_mm, gradients (float32), contact."""
    return {
        "depth_mm": press.depth_mm.astype(np.float32),
        "gradients": press.gradients.astype(np.float32),
        "contact": press.contact,
    }


@dataclass(frozen=True)
class SetOfPresses:
    """The parameters of a data set of ball presses: everything that determines its bytes.

    With a `twin` the images are the twin's, and `sensor` is its sensor.
    """

    sensor: SimulatedSensor
    ball_diameters_mm: tuple[float, ...]
    count: int
    seed: int
    oversample: int = 3
    twin: Twin | None = None

    def __post_init__(self) -> None:
        if self.count < 1 or len(self.ball_diameters_mm) == 0:
            raise ValueError(
                f"Expected count >= 1 and a ball, got {self.count} and {list(self.ball_diameters_mm)}."
            )
        if self.seed < 0:
            raise ValueError(f"Expected seed >= 0, got {self.seed}.")
        for diameter in self.ball_diameters_mm:
            check_positive(diameter, "ball_diameter_mm")
        check_balls(self.sensor, self.ball_diameters_mm)

    def press(self, k: int) -> SimulatedPress:
        """The k-th press; independent of the others."""
        press = ball_press_of_set(
            self.sensor, self.ball_diameters_mm, k, seed=self.seed, oversample=self.oversample
        )
        if self.twin is None:
            return press
        return self.twin.rendered(
            press, np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(k + 2, 0)))
        )

    def background(self) -> Image:
        """The image of the gel at rest."""
        if self.twin is not None:
            return self.twin.background
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(0,)))
        return np.asarray(simulate_background(self.sensor, rng), dtype=np.uint8)


def save_simulated_set(
    folder: str | os.PathLike[str],
    presses: SetOfPresses,
    *,
    workers: int = 1,
    loads: bool = False,
    progress: Progress = no_progress,
) -> Path:
    """Write ball presses as a press folder with labels, truth and all parameters.

    With `loads` also loads.csv: the load of each press on a gel of springs side by side, 0.1 N for each mm^3.

    Writes background.png, presses.csv, sensor.toml, parameters.json, images/0000.png and truth/0000.npz, ... (depth_mm,
    gradients, contact, albedo, shadowed, saturated, markers_px, markers_shift_mm, and `meta`: pose, seed, number).
    Each press has its own random stream, so the bytes do not depend on the number of workers. The folder appears
    complete or not at all. DataError: it is not empty or cannot be written.
    """
    if workers < 1:
        raise ValueError(f"Expected workers >= 1, got {workers}.")
    target = Path(folder)
    with written_whole(target) as partial:
        for name in ("images", "truth"):
            (partial / name).mkdir()
        write_png(partial / "background.png", presses.background())
        rows, known = [], []
        for row in _rows_of_simulated(presses, partial, workers):
            load = row.pop("force_n")
            ball = f"ball {row['ball_diameter_mm']} mm"
            known.append({"image": row["image"], "object": ball, "force_n": load})
            rows.append(row)
            progress(len(rows), presses.count, "simulating")
        write_csv(partial / "presses.csv", rows)
        if loads:
            write_csv(partial / "loads.csv", known)
        kept = {name: getattr(presses, name) for name in ("ball_diameters_mm", "count", "seed", "oversample")}
        _write_parameters(partial, presses.sensor, presses.twin, **kept)
    return target


def _rows_of_simulated(presses: SetOfPresses, folder: Path, workers: int) -> Iterator[dict[str, str]]:
    """Write each press, in this process or in several; yields the lines of presses.csv in order, with each load."""
    if workers == 1:
        for k in range(presses.count):
            yield _write_press(presses, folder, k)
        return
    with worker_processes(workers) as pool:
        with interrupt_held():
            jobs = [pool.submit(_write_press, presses, folder, k) for k in range(presses.count)]
        for job in jobs:
            yield job.result()


def _write_press(presses: SetOfPresses, folder: Path, k: int) -> dict[str, str]:
    press = presses.press(k)
    write_png(folder / f"images/{k:04d}.png", press.image)
    write_truth(folder / f"truth/{k:04d}.npz", press, {"number": k, "seed": presses.seed})
    volume_mm3 = float(press.depth_mm[press.contact].sum(dtype=np.float64)) * presses.sensor.mm_per_px**2
    return {
        "image": f"images/{k:04d}.png",
        "ball_diameter_mm": f"{press.ball_diameter_mm:.6g}",
        "center_x_px": f"{press.center_px[0]:.4f}",
        "center_y_px": f"{press.center_px[1]:.4f}",
        "contact_radius_px": f"{press.contact_radius_px:.4f}",
        # 0.4 MPa over 4 mm of thickness, as springs side by side (Winkler).
        "force_n": f"{0.1 * volume_mm3:.6g}",
    }


def save_press_folder(
    folder: str | os.PathLike[str],
    *,
    background: ArrayLike,
    images: Sequence[ArrayLike],
    ball_diameters_mm: Sequence[float],
    mm_per_px: float,
    name: str,
    settings: SensorSettings | None = None,
    centers_px: Sequence[tuple[float, float]] | None = None,
    contact_radii_px: Sequence[float] | None = None,
    truths: Sequence[Mapping[str, ArrayLike]] | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write presses of balls as the folder that `calibrate` reads.

    Writes background.png, presses.csv, sensor.toml, images/0000.png, ... and, with `truths`, truth/0000.npz, ... into a
    temporary folder, and renames that when it is complete. The background and each image are (H, W, 3) RGB, 0-255; `name` is
    the sensor's; `settings` holds what else is known of it, such as its serial number. Centers and radii are labels, known
    for simulated presses; each of `truths` is arrays by name, such as depth_mm.

    DataError: the folder is not empty or cannot be written.
    ValueError: lists differ in length, images differ in size, or numbers are not positive.
    """
    target = check_path(folder, "folder as a path")
    images = check_list(images, "images")
    rows = _rows(len(images), ball_diameters_mm, centers_px, contact_radii_px)
    if truths is not None and len(check_list(truths, "truths", Mapping)) != len(images):
        raise ValueError(f"Expected {len(images)} truths, one per image, got {len(truths)}.")
    check_is(name, str, "name")
    if settings is not None:
        check_is(settings, SensorSettings, "settings")
    pitch = check_mm_per_px(mm_per_px)[0]
    height, width = check_image(background, name="background").shape[:2]
    with written_whole(target) as partial:
        write_png(partial / "background.png", background, (height, width))
        (partial / "images").mkdir()
        for k, image in enumerate(images):
            write_png(partial / rows[k]["image"], image, (height, width))
            if truths is not None:
                (partial / "truth").mkdir(exist_ok=True)
                np.savez_compressed(partial / f"truth/{k:04d}.npz", **dict[str, Any](truths[k]))
            progress(k + 1, len(images), "writing presses")
        write_csv(partial / "presses.csv", rows)
        own = replace(settings or SensorSettings(name, pitch), name=name, mm_per_px=pitch)
        (partial / "sensor.toml").write_text(toml_of_settings(own), encoding="utf-8")
    return target


def save_simulated_presses(
    folder: str | os.PathLike[str],
    simulated: SimulatedPresses,
    *,
    truth: bool = True,
    progress: Progress = no_progress,
) -> Path:
    """Write the result of `simulate_ball_presses` as a press folder with labels and truth."""
    presses = check_is(simulated, SimulatedPresses, "simulated").presses
    return save_press_folder(
        folder,
        background=simulated.background,
        images=[press.image for press in presses],
        ball_diameters_mm=[press.ball_diameter_mm for press in presses],
        mm_per_px=simulated.sensor.mm_per_px,
        name=simulated.sensor.name,
        centers_px=[press.center_px for press in presses],
        contact_radii_px=[press.contact_radius_px or 0.0 for press in presses],
        truths=[truth_from_press(press) for press in presses] if truth else None,
        progress=progress,
    )


def _rows(
    count: int,
    diameters_mm: Sequence[float],
    centers_px: Sequence[tuple[float, float]] | None,
    radii_px: Sequence[float] | None,
) -> list[dict[str, str]]:
    """The lines of presses.csv."""
    if count == 0:
        raise ValueError("Expected at least one image, got none.")
    given = {"ball_diameters_mm": diameters_mm, "centers_px": centers_px, "contact_radii_px": radii_px}
    for what, values in given.items():
        if values is not None or what == "ball_diameters_mm":
            length = len(check_list(values, what))
            if length != count:
                raise ValueError(f"Expected {count} {what}, one per image, got {length}.")
    rows = []
    for k in range(count):
        diameter = check_positive(diameters_mm[k], "ball_diameter_mm")
        row = {"image": f"images/{k:04d}.png", "ball_diameter_mm": f"{diameter:.6g}"}
        if centers_px is not None:
            x, y = check_numbers(centers_px[k], "each of centers_px", 2)
            row |= {"center_x_px": f"{x:.4f}", "center_y_px": f"{y:.4f}"}
        if radii_px is not None:
            row |= {"contact_radius_px": f"{radii_px[k]:.4f}"}
        rows.append(row)
    return rows


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
