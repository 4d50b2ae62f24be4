"""A press folder that grows during pressing: the background first, then one image per press."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.toml_text import edited_toml
from gelform.errors import DataError
from gelform.image.background import background_from_frames
from gelform.image.view import View
from gelform.sensors.files import SensorSettings
from gelform.sensors.grabber import Grabber
from gelform.sensors.profiles import profile_named
from gelform.sensors.source import Source

BACKGROUND, TABLE, SETTINGS, IMAGES = "background", "presses.csv", "sensor.toml", "images"
# A press is visible if this fraction of the pixels differs by so many standard deviations of the background, and levels.
LEAST_FRACTION, LEAST_SIGMAS, LEAST_LEVELS = 0.002, 6.0, 4.0


class TakenPresses:
    """Writes a press folder image by image, so that a later failure loses no image.

    DataError: the folder is not empty, or cannot be written.
    """

    def __init__(self, folder: Path, settings: SensorSettings, ball_diameter_mm: float) -> None:
        self.folder, self.ball_diameter_mm = folder, ball_diameter_mm
        self.count = 0
        self._rest: NDArray[np.float32] | None = None
        self._noise: NDArray[np.float64] | None = None
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if any(folder.iterdir()):
                raise DataError(f"Expected a new or empty folder, got {folder}. Choose another name.")
            (folder / SETTINGS).write_text(toml_of_settings(settings), encoding="utf-8")
            (folder / IMAGES).mkdir()
            self._write_table()
        except OSError as problem:
            raise DataError(f"Cannot write {folder}: {problem.strerror}.") from problem

    def take_background(self, images: Sequence[NDArray[np.uint8]]) -> None:
        """Keep images (H, W, 3) uint8 RGB of the gel at rest; a DataError if they disagree, because something moved."""
        average = background_from_frames(images)
        self._rest, self._noise = average.background, np.asarray(average.noise)
        (self.folder / BACKGROUND).mkdir(exist_ok=True)
        for k, image in enumerate(images):
            self._write(self.folder / BACKGROUND / f"{k:02d}.png", image)

    def take_press(self, image: NDArray[np.uint8]) -> str:
        """Keep an image (H, W, 3) uint8 RGB of a press, and return its name in the folder.

        DataError: nothing is pressed.
        """
        if self._rest is None or self._noise is None:
            raise DataError("Expected the background before the presses.")
        apart = np.abs(image - self._rest)
        limit = np.maximum(LEAST_SIGMAS * self._noise, LEAST_LEVELS)
        fraction = float((apart > limit).any(axis=-1).mean())
        if fraction < LEAST_FRACTION:
            raise DataError("Nothing is pressed: the image shows the gel at rest.")
        name = f"{IMAGES}/{self.count:04d}.png"
        self._write(self.folder / name, image)
        self.count += 1
        self._write_table()
        return name

    def drop_last(self) -> str | None:
        """Remove the last press; return its name, or None without one."""
        if self.count == 0:
            return None
        self.count -= 1
        self._write_table()
        name = f"{IMAGES}/{self.count:04d}.png"
        (self.folder / name).unlink()
        return name

    def _write_table(self) -> None:
        """Write the table anew, so that it is complete or the previous one."""
        rows = "".join(f"{IMAGES}/{k:04d}.png,{self.ball_diameter_mm:.6g}\n" for k in range(self.count))
        partial = self.folder / f".{TABLE}.partial"
        partial.write_text(f"image,ball_diameter_mm\n{rows}", encoding="ascii")
        partial.replace(self.folder / TABLE)

    def _write(self, path: Path, image: NDArray[np.uint8]) -> None:
        content = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
        try:
            path.write_bytes(content.tobytes())
        except OSError as problem:
            raise DataError(f"Cannot write {path}: {problem.strerror}.") from problem


def settings_of(
    source: Source | Grabber,
    frame_shape: tuple[int, int],
    make: str | None = None,
    mm_per_px: float | None = None,
) -> SensorSettings:
    """What is known of a source's sensor: the make's scale and view of frames (H, W), and the serial number.

    A given scale takes the place of the make's; one of them is needed. ValueError: the make is unknown.
    """
    profile = None if make is None else profile_named(make)
    view = View() if profile is None else profile.view(frame_shape)
    pitch, sigma = mm_per_px, None
    if profile is not None and mm_per_px is None:
        pitch, sigma = profile.mm_per_px, profile.mm_per_px_sigma
    assert pitch is not None
    name = source.name if profile is None else profile.name
    return SensorSettings(name, pitch, sigma, make=make or "", serial=source.serial or "", view=view)


def toml_of_settings(settings: SensorSettings) -> str:
    """The text of a sensor.toml with the settings."""
    top: dict[str, Any] = {"name": settings.name, "mm_per_px": settings.mm_per_px}
    if settings.mm_per_px_sigma is not None:
        top["mm_per_px_sigma"] = settings.mm_per_px_sigma
    top |= {name: text for name in ("make", "serial", "gel_id") if (text := getattr(settings, name))}
    tables: dict[tuple[str, ...], Mapping[str, Any]] = {(): top}
    for name, table in (("view", settings.view.to_dict()), ("camera", settings.camera)):
        if table:
            tables[(name,)] = table
    return edited_toml("", tables)
