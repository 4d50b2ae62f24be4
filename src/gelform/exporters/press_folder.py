"""Writers: a press folder as calibration reads it; written whole or not at all."""

from __future__ import annotations

import csv
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import check_image, check_mm_per_px, check_positive
from gelform.errors import DataError
from gelform.progress import Progress, no_progress
from gelform.simulate import SimulatedPresses


def save_press_folder(
    folder: str | os.PathLike[str],
    *,
    background: ArrayLike,
    images: Sequence[ArrayLike],
    ball_diameters_mm: Sequence[float],
    mm_per_px: float,
    name: str,
    centers_px: Sequence[tuple[float, float]] | None = None,
    contact_radii_px: Sequence[float] | None = None,
    truths: Sequence[Mapping[str, ArrayLike]] | None = None,
    progress: Progress = no_progress,
) -> Path:
    """Write presses of balls as the folder that `calibrate` reads.

    Writes background.png, presses.csv, sensor.toml, images/0000.png, ... and, with `truths`,
    truth/0000.npz, ... into a temporary folder beside the wanted one and renames it when all is there.

    Parameters
    ----------
    folder : path, new or empty
    background : (H, W, 3) RGB, 0-255
    images : N times (H, W, 3) uint8, RGB
    ball_diameters_mm : N numbers
    mm_per_px : float, mm
    name : str, of the sensor
    centers_px, contact_radii_px : N labels, known for simulated presses
    truths : N times named arrays, such as depth_mm and gradients
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        The folder holds something already or cannot be written.
    ValueError
        Lists of different lengths, images of different sizes, numbers that are not positive.
    """
    target = Path(folder)
    rows = _rows(len(images), ball_diameters_mm, centers_px, contact_radii_px)
    if truths is not None and len(truths) != len(images):
        raise ValueError(f"Expected {len(images)} truths, one per image, got {len(truths)}.")
    pitch = check_mm_per_px(mm_per_px)[0]
    shape = check_image(background, name="background").shape[:2]
    with written_whole(target) as partial:
        _write_png(partial / "background.png", background, shape)
        (partial / "images").mkdir()
        for k, image in enumerate(images):
            _write_png(partial / rows[k]["image"], image, shape)
            if truths is not None:
                (partial / "truth").mkdir(exist_ok=True)
                _write_npz(partial / "truth" / f"{k:04d}.npz", truths[k])
            progress(k + 1, len(images), "writing presses")
        _write_csv(partial / "presses.csv", rows)
        (partial / "sensor.toml").write_text(
            f"name = {toml_string(name)}\nmm_per_px = {pitch!r}\n", encoding="utf-8"
        )
    return target


def save_simulated_presses(
    folder: str | os.PathLike[str],
    simulated: SimulatedPresses,
    *,
    truth: bool = True,
    progress: Progress = no_progress,
) -> Path:
    """Write what `simulate_ball_presses` gave as a press folder with labels and truth."""
    presses = simulated.presses
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


def truth_from_press(press: Any) -> dict[str, NDArray[Any]]:
    """The truth of a simulated press as it is saved: depth_mm, gradients (float32), contact."""
    return {
        "depth_mm": press.depth_mm.astype(np.float32),
        "gradients": press.gradients.astype(np.float32),
        "contact": press.contact,
    }


@contextmanager
def written_whole(target: Path) -> Iterator[Path]:
    """A temporary folder beside `target` that takes its name when the block ends well, else vanishes."""
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise DataError(
                f"Expected a new or empty folder, got {target}, which holds something. Choose another name."
            )
        target.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.partial-", dir=target.parent))
    except OSError as error:
        raise DataError(f"Cannot write into {target.parent}: {error.strerror or error}.") from error
    try:
        yield partial
        partial.chmod(0o777 & ~_umask())
        if target.exists():
            target.rmdir()
        partial.rename(target)
    except OSError as error:
        shutil.rmtree(partial, ignore_errors=True)
        raise DataError(f"Cannot write {target}: {error.strerror or error}. Nothing was kept.") from error
    except BaseException:
        shutil.rmtree(partial, ignore_errors=True)
        raise


def toml_string(text: str) -> str:
    """A TOML basic string."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


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
        if values is not None and len(values) != count:
            raise ValueError(f"Expected {count} {what}, one per image, got {len(values)}.")
    rows = []
    for k in range(count):
        diameter = check_positive(diameters_mm[k], "ball_diameter_mm")
        row = {"image": f"images/{k:04d}.png", "ball_diameter_mm": f"{diameter:.6g}"}
        if centers_px is not None:
            row |= {"center_x_px": f"{centers_px[k][0]:.4f}", "center_y_px": f"{centers_px[k][1]:.4f}"}
        if radii_px is not None:
            row |= {"contact_radius_px": f"{radii_px[k]:.4f}"}
        rows.append(row)
    return rows


def _write_csv(path: Path, rows: Sequence[Mapping[str, str]]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


def _write_png(path: Path, image: ArrayLike, shape: tuple[int, ...]) -> None:
    pixels = check_image(image, shape=(shape[0], shape[1]), name=path.name)
    if pixels.dtype != np.uint8:
        pixels = np.rint(pixels).astype(np.uint8)
    done, encoded = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))
    if not done:
        raise DataError(f"Cannot encode {path.name} as PNG.")
    path.write_bytes(encoded.tobytes())


def _write_npz(path: Path, arrays: Mapping[str, ArrayLike]) -> None:
    members: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
    with path.open("wb") as file:
        np.savez_compressed(file, **members)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
