"""Simulated presses with their truth, as files: a single press, or a data set of any size.

Several processes write a data set; its bytes do not depend on their number.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.exchange.exporters.folders import (
    write_csv,
    write_npz,
    write_png,
    write_sensor_toml,
    written_whole,
)
from gelform.foundations.checks import check_positive
from gelform.foundations.processes import interrupt_held, worker_processes
from gelform.foundations.progress import Progress, no_progress
from gelform.simulate import (
    Indenter,
    SimulatedPress,
    SimulatedSensor,
    Twin,
    simulate_background,
    simulate_press,
)
from gelform.simulate.sensor.sensor import settings_from_sensor
from gelform.simulate.sets import ball_press_of_set, check_balls

N_PER_MM3 = (
    0.1  # N per mm^3 of displaced gel: 0.4 MPa over 4 mm of thickness, as springs side by side (Winkler)
)


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

    Raises
    ------
    DataError
        The folder is not empty or cannot be written.
    ValueError
        The press is impossible; see `simulate_press`.
    """
    from gelform import __version__

    rng = np.random.default_rng(seed)
    press = simulate_press(sensor, indenter, depth_mm=depth_mm, rng=rng)
    background = simulate_background(sensor, rng) if twin is None else twin.background
    if twin is not None:
        press = twin.rendered(press, rng)
    parameters = {
        "sensor": settings_from_sensor(sensor),
        "like": None if twin is None else twin.look.name,
        "seed": seed,
        "gelform_version": __version__,
    }
    target = Path(folder)
    with written_whole(target) as partial:
        write_png(partial / "background.png", background)
        write_png(partial / "image.png", press.image)
        write_truth(partial / "truth.npz", press, {"seed": seed}, mm_per_px=np.float64(sensor.mm_per_px))
        text = json.dumps(parameters, indent=1, sort_keys=True)
        (partial / "parameters.json").write_text(text + "\n", encoding="utf-8")
        write_sensor_toml(partial / "sensor.toml", sensor.name, sensor.mm_per_px)
    return target


def write_truth(path: Path, press: SimulatedPress, meta: Mapping[str, Any], **arrays: Any) -> None:
    """Write the truth of a press as .npz; `meta` is added to its pose as JSON, `arrays` to its arrays."""
    pose = {
        "depth_mm": press.press_depth_mm,
        "center_mm": list(press.center_mm),
        "spin_deg": press.pose.spin_deg,
        "tilt_deg": list(press.pose.tilt_deg),
        "time_s": press.time_s,
    }
    members: dict[str, Any] = {
        **arrays,
        **truth_from_press(press),
        "albedo": press.albedo,
        "shadowed": press.shadowed,
        "saturated": press.saturated,
        "markers_px": press.markers_px,
        "markers_shift_mm": press.markers_shift_mm,
        "meta": np.array(json.dumps({**meta, **pose, "indenter": repr(press.indenter)}, sort_keys=True)),
    }
    write_npz(path, members)


def truth_from_press(press: SimulatedPress) -> dict[str, NDArray[Any]]:
    """The saved truth of a simulated press: depth_mm, gradients (float32), contact."""
    return {
        "depth_mm": press.depth_mm.astype(np.float32),
        "gradients": press.gradients.astype(np.float32),
        "contact": press.contact,
    }


COLUMNS = ("image", "ball_diameter_mm", "center_x_px", "center_y_px", "contact_radius_px")


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

    def background(self) -> NDArray[np.uint8]:
        """The image of the gel at rest."""
        if self.twin is not None:
            return self.twin.background
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(0,)))
        return np.asarray(simulate_background(self.sensor, rng), dtype=np.uint8)

    def parameters(self) -> dict[str, Any]:
        """All parameters, for JSON."""
        from gelform import __version__

        return {
            "sensor": settings_from_sensor(self.sensor),
            "ball_diameters_mm": list(self.ball_diameters_mm),
            "count": self.count,
            "seed": self.seed,
            "oversample": self.oversample,
            "like": None if self.twin is None else self.twin.look.name,
            "gelform_version": __version__,
        }


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
    complete or not at all.

    Raises
    ------
    DataError
        The folder is not empty or cannot be written.
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
            known.append({"image": row["image"], "object": f"ball {row[COLUMNS[1]]} mm", "force_n": load})
            rows.append(row)
            progress(len(rows), presses.count, "simulating")
        write_csv(partial / "presses.csv", rows)
        if loads:
            write_csv(partial / "loads.csv", known)
        text = json.dumps(presses.parameters(), indent=1, sort_keys=True)
        (partial / "parameters.json").write_text(text + "\n", encoding="utf-8")
        write_sensor_toml(partial / "sensor.toml", presses.sensor.name, presses.sensor.mm_per_px)
    return target


def _rows_of_simulated(presses: SetOfPresses, folder: Path, workers: int) -> Iterator[dict[str, str]]:
    """Write each press, in this process or in several; yields the lines of presses.csv in order."""
    numbers: Sequence[int] = range(presses.count)
    if workers == 1:
        for k in numbers:
            yield _write_press(presses, folder, k)
        return
    with worker_processes(workers) as pool:
        with interrupt_held():
            jobs = [pool.submit(_write_press, presses, folder, k) for k in numbers]
        for job in jobs:
            yield job.result()


def _write_press(presses: SetOfPresses, folder: Path, k: int) -> dict[str, str]:
    press = presses.press(k)
    write_png(folder / f"images/{k:04d}.png", press.image)
    write_truth(folder / f"truth/{k:04d}.npz", press, {"number": k, "seed": presses.seed})
    x, y = press.center_px
    numbers = (f"{press.ball_diameter_mm:.6g}", f"{x:.4f}", f"{y:.4f}", f"{press.contact_radius_px:.4f}")
    volume_mm3 = float(press.depth_mm[press.contact].sum(dtype=np.float64)) * presses.sensor.mm_per_px**2
    load = {"force_n": f"{N_PER_MM3 * volume_mm3:.6g}"}
    return dict(zip(COLUMNS, (f"images/{k:04d}.png", *numbers))) | load
