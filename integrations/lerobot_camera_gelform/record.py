"""Record a dataset of the simulated sensor with LeRobot's own parts, read it back, and print the differences as JSON.

python record.py [SECONDS]     # 5 s by default; needs lerobot[dataset] and this package
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path
from typing import Any

import draccus
import numpy as np
from lerobot.cameras import CameraConfig, make_cameras_from_configs
from lerobot.datasets import LeRobotDataset
from lerobot.utils.feature_utils import hw_to_dataset_features
from lerobot.utils.import_utils import register_third_party_plugins

RATE_HZ, NAME = 30, "finger"
COLOR_KEY, DEPTH_KEY = f"observation.images.{NAME}", f"observation.images.{NAME}_depth"
SAVED, WRITER_THREADS = "tactile/press", 4  # as in lerobot-record
PRESSED_MM = 0.2
LOOKED_AT = 5  # every fifth frame is reconstructed from the recorded color


def camera_of(settings: dict[str, Any]) -> Any:
    """The camera that LeRobot finds, parses and makes from settings."""
    register_third_party_plugins()
    config = draccus.decode(CameraConfig, {"type": "gelform", "fps": RATE_HZ, **settings})
    return make_cameras_from_configs({NAME: config})[NAME]


def record(
    root: Path, seconds: float, rgb_encoder: Any = None
) -> tuple[dict[str, Any], list[Any], list[Any]]:
    """Record a dataset; return figures of the recording, and its colors and depths (mm, as reconstructed)."""
    from lerobot_camera_gelform import gelform_camera

    camera = camera_of({"warn_lossy_rgb": False})
    shape = (camera.height, camera.width)
    features = hw_to_dataset_features({NAME: (*shape, 3), f"{NAME}_depth": (*shape, 1)}, "observation")
    dataset = LeRobotDataset.create(
        SAVED, RATE_HZ, features, root=root, rgb_encoder=rgb_encoder, image_writer_threads=WRITER_THREADS
    )
    encoded, depths = gelform_camera._levels, []

    def noted(seen: Any) -> Any:
        depths.append(seen.result.depth_mm)
        return encoded(seen)

    colors, times, timeouts = [], [], 0
    with camera:
        wait_for_press(camera)
        gelform_camera._levels = noted  # the depth before it is rounded to whole um
        while len(times) < round(seconds * RATE_HZ):
            try:
                color, levels = camera.async_read(), camera.async_read_depth()
            except TimeoutError:
                timeouts += 1
                continue
            times.append(time.perf_counter())
            colors.append(color)
            dataset.add_frame({COLOR_KEY: color, DEPTH_KEY: levels, "task": "press"})
    gelform_camera._levels = encoded
    dataset.save_episode()
    dataset.finalize()
    rate_hz = (len(times) - 1) / (times[-1] - times[0])
    slowest_ms = 1e3 * float(np.diff(times).max())
    said = {"frames": len(times), "rate_hz": rate_hz, "slowest_ms": slowest_ms, "timeouts": timeouts}
    return said, colors, depths


def wait_for_press(camera: Any) -> None:
    """Wait until the simulated ball touches the gel, so that the recording contains a touch."""
    depth_mm = np.zeros(1)
    while depth_mm.max() < PRESSED_MM:
        depth_mm = (camera.async_read_depth(5000) - 1000.0) / 1000


def read_back(root: Path, colors: list[Any], depths: list[Any]) -> dict[str, Any]:
    """The differences between the recorded data and the data that LeRobot reads."""
    from gelform.robots import depth_from_lerobot_levels

    dataset = LeRobotDataset(SAVED, root=root, return_uint8=True)
    assert len(dataset) == len(depths)
    wrong_um, came = [], []
    for index, depth_mm in enumerate(depths):
        item = dataset[index]
        levels = item[DEPTH_KEY].numpy().reshape(depth_mm.shape)
        wrong_um.append(1e3 * (depth_from_lerobot_levels(levels).astype(float) - depth_mm))
        came.append(np.moveaxis(item[COLOR_KEY].numpy(), 0, -1))
    differ = max(int(np.abs(one.astype(int) - color).max()) for one, color in zip(came, colors, strict=True))
    return {
        "depth_rms_um": rms(wrong_um),
        "depth_worst_um": float(np.abs(wrong_um).max()),
        "deepest_mm": float(max(depth.max() for depth in depths)),
        "color_worst_level": differ,
        **lost_with_color(colors, came),
    }


def lost_with_color(colors: list[Any], came: list[Any]) -> dict[str, float]:
    """Errors of slopes (degrees) and depth (um) in contact, RMS, reconstructed from the color that LeRobot reads."""
    import gelform

    reconstruct = gelform.Reconstructor(camera_of({}).calibration)
    degrees, micrometers = [], []
    for color, other in list(zip(colors, came, strict=True))[::LOOKED_AT]:
        first, second = reconstruct.from_image(color), reconstruct.from_image(np.ascontiguousarray(other))
        if first.contact.any():
            chord = np.linalg.norm((first.normals - second.normals)[first.contact], axis=-1)
            degrees.append(np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1))))
            micrometers.append(1e3 * (second.depth_mm - first.depth_mm)[first.contact])
    if not degrees:
        raise SystemExit("Nothing was pressed while it was recorded. Record for longer.")
    return {"color_slope_deg": rms(degrees), "color_depth_um": rms(micrometers)}


def rms(parts: list[Any]) -> float:
    """Root of the mean square of all values."""
    values = np.concatenate([np.ravel(part) for part in parts])
    return float(np.sqrt(np.mean(values.astype(float) ** 2)))


def measured(seconds: float, rgb_encoder: Any = None) -> dict[str, Any]:
    """Record and read back; all figures, and the versions."""
    import lerobot

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "set"
        said, colors, depths = record(root, seconds, rgb_encoder)
        videos = {"color_kb": COLOR_KEY, "depth_kb": DEPTH_KEY}
        sizes = {
            name: sum(path.stat().st_size for path in root.glob(f"videos/{key}/**/*.mp4")) / 1e3 / len(colors)
            for name, key in videos.items()
        }
        return {"lerobot": lerobot.__version__, **said, **read_back(root, colors, depths), **sizes}


if __name__ == "__main__":
    from lerobot_camera_gelform import lossless_rgb_encoder

    print(json.dumps({"lossless": measured(5.0, lossless_rgb_encoder()), "default": measured(1.5)}))
