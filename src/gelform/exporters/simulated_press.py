"""One simulated press with its truth, as files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.exporters.folders import write_npz, write_png, write_sensor_toml, written_whole
from gelform.simulate import (
    Indenter,
    SimulatedPress,
    SimulatedSensor,
    Twin,
    simulate_background,
    simulate_press,
)
from gelform.simulate.sensor.sensor import settings_from_sensor


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

    With a `twin` the images are the twin's, and `sensor` is its sensor. The folder appears whole or not at all.

    Raises
    ------
    DataError
        The folder holds something already or cannot be written.
    ValueError
        A press that cannot be; see `simulate_press`.
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
    """Write everything that is true of a press as .npz; `meta` joins its pose as JSON, `arrays` its arrays."""
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
    """The truth of a simulated press as it is saved: depth_mm, gradients (float32), contact."""
    return {
        "depth_mm": press.depth_mm.astype(np.float32),
        "gradients": press.gradients.astype(np.float32),
        "contact": press.contact,
    }
