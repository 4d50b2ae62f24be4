"""A press folder, in the form that calibration reads, from images or from a simulated set."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from numpy.typing import ArrayLike

from gelform.exchange.exporters.folders import (
    write_csv,
    write_npz,
    write_png,
    write_sensor_toml,
    written_whole,
)
from gelform.exchange.exporters.simulated import truth_from_press
from gelform.foundations.checks import (
    check_image,
    check_is,
    check_list,
    check_mm_per_px,
    check_numbers,
    check_path,
    check_positive,
)
from gelform.foundations.progress import Progress, no_progress
from gelform.simulate import SimulatedPresses


def save_press_folder(
    folder: str | os.PathLike[str],
    *,
    background: ArrayLike,
    images: Sequence[ArrayLike],
    ball_diameters_mm: Sequence[float],
    mm_per_px: float,
    name: str,
    serial: str = "",
    centers_px: Sequence[tuple[float, float]] | None = None,
    contact_radii_px: Sequence[float] | None = None,
    truths: Sequence[Mapping[str, ArrayLike]] | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write presses of balls as the folder that `calibrate` reads.

    Writes background.png, presses.csv, sensor.toml, images/0000.png, ... and, with `truths`, truth/0000.npz, ... into a
    temporary folder, and renames that when it is complete.

    Parameters
    ----------
    folder : path, new or empty
    background : (H, W, 3) RGB, 0-255
    images : N times (H, W, 3) uint8, RGB
    ball_diameters_mm : N numbers
    mm_per_px : float, mm
    name : str, of the sensor
    serial : serial number of the camera; empty without one
    centers_px, contact_radii_px : N labels, known for simulated presses
    truths : N times named arrays, such as depth_mm and gradients
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        The folder is not empty or cannot be written.
    ValueError
        Lists differ in length, images differ in size, or numbers are not positive.
    """
    target = check_path(folder, "folder as a path")
    images = check_list(images, "images")
    rows = _rows(len(images), ball_diameters_mm, centers_px, contact_radii_px)
    if truths is not None and len(check_list(truths, "truths", Mapping)) != len(images):
        raise ValueError(f"Expected {len(images)} truths, one per image, got {len(truths)}.")
    check_is(name, str, "name")
    pitch = check_mm_per_px(mm_per_px)[0]
    height, width = check_image(background, name="background").shape[:2]
    with written_whole(target) as partial:
        write_png(partial / "background.png", background, (height, width))
        (partial / "images").mkdir()
        for k, image in enumerate(images):
            write_png(partial / rows[k]["image"], image, (height, width))
            if truths is not None:
                (partial / "truth").mkdir(exist_ok=True)
                write_npz(partial / "truth" / f"{k:04d}.npz", truths[k])
            progress(k + 1, len(images), "writing presses")
        write_csv(partial / "presses.csv", rows)
        write_sensor_toml(partial / "sensor.toml", name, pitch, serial)
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
    for what, values in (
        ("ball_diameters_mm", diameters_mm),
        ("centers_px", centers_px),
        ("contact_radii_px", radii_px),
    ):
        if values is None and what != "ball_diameters_mm":
            continue
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
