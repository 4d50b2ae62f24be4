"""A press folder that grows during pressing: the background first, then one image per press."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.files import edited_toml
from gelform.errors import DataError, cannot
from gelform.foundations.files import made_folder, written_file
from gelform.foundations.pictures import picture_bytes
from gelform.image.background import background_from_frames
from gelform.image.view import View
from gelform.sensors.files import SensorSettings
from gelform.sensors.grabber import Grabber
from gelform.sensors.profiles import profile_named
from gelform.sensors.source import Source


class TakenPresses:
    """Writes a press folder image by image, so that a later failure loses no image.

    DataError: the folder is not empty, or cannot be written.
    """

    def __init__(self, folder: Path, settings: SensorSettings, ball_diameter_mm: float) -> None:
        self.folder, self.ball_diameter_mm = folder, ball_diameter_mm
        self.count = 0
        self._rest: NDArray[np.float32] | None = None
        self._limit: NDArray[np.float64] | None = None  # gray levels, least difference of a touched pixel
        with cannot(f"write {folder}"):
            if any(made_folder(folder).iterdir()):
                raise DataError(f"Expected a new or empty folder, got {folder}. Choose another name.")
            (folder / "images").mkdir()
        self._write("sensor.toml", toml_of_settings(settings).encode())
        self._write_table()

    def take_background(self, images: Sequence[NDArray[np.uint8]]) -> None:
        """Keep images (H, W, 3) uint8 RGB of the gel at rest; a DataError if they disagree, because something moved."""
        average = background_from_frames(images)
        self._rest = average.background
        self._limit = np.maximum(6.0 * np.asarray(average.noise), 4.0)
        (self.folder / "background").mkdir(exist_ok=True)
        for k, image in enumerate(images):
            self._write(f"background/{k:02d}.png", picture_bytes(image))

    def take_press(self, image: NDArray[np.uint8]) -> str:
        """Keep an image (H, W, 3) uint8 RGB of a press, and return its name in the folder.

        DataError: nothing is pressed.
        """
        if self._rest is None:
            raise DataError("Expected the background before the presses.")
        if (np.abs(image - self._rest) > self._limit).any(axis=-1).mean() < 0.002:  # of the pixels
            raise DataError("Nothing is pressed: the image shows the gel at rest.")
        name = f"images/{self.count:04d}.png"
        self._write(name, picture_bytes(image))
        self.count += 1
        self._write_table()
        return name

    def drop_last(self) -> str | None:
        """Remove the last press; return its name, or None without one."""
        if self.count == 0:
            return None
        self.count -= 1
        self._write_table()
        name = f"images/{self.count:04d}.png"
        (self.folder / name).unlink()
        return name

    def _write_table(self) -> None:
        rows = "".join(f"images/{k:04d}.png,{self.ball_diameter_mm:.6g}\n" for k in range(self.count))
        self._write("presses.csv", f"image,ball_diameter_mm\n{rows}".encode())

    def _write(self, name: str, content: bytes) -> None:
        """Write a file so that it is complete, or the previous one."""
        with written_file(self.folder / name, overwrite=True) as handle:
            handle.write(content)


def settings_of(
    source: Source | Grabber,
    frame_shape: tuple[int, int],
    make: str | None = None,
    mm_per_px: float | None = None,
) -> SensorSettings:
    """What is known of a source's sensor: the make's scale and view of frames (H, W), and the serial number.

    A given scale takes the place of the make's; one of them is needed. ValueError: the make is unknown.
    """
    view, sigma, name = View(), None, source.name
    if make is not None:
        profile = profile_named(make)
        view, name = profile.view(frame_shape), profile.name
        if mm_per_px is None:
            mm_per_px, sigma = profile.mm_per_px, profile.mm_per_px_sigma
    assert mm_per_px is not None
    return SensorSettings(name, mm_per_px, sigma, make=make or "", serial=source.serial or "", view=view)


def toml_of_settings(settings: SensorSettings) -> str:
    """The text of a sensor.toml with the settings."""
    top: dict[str, Any] = {"name": settings.name, "mm_per_px": settings.mm_per_px}
    if settings.mm_per_px_sigma is not None:
        top["mm_per_px_sigma"] = settings.mm_per_px_sigma
    top |= {name: text for name in ("make", "serial", "gel_id") if (text := getattr(settings, name))}
    tables: dict[tuple[str, ...], Mapping[str, Any]] = {(): top}
    tables |= {("view",): settings.view.to_dict(), ("camera",): settings.camera}
    return edited_toml("", {path: table for path, table in tables.items() if table})
