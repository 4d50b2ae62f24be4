"""Folders that are written completely or not at all, and the files in them."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from gelform.errors import DataError
from gelform.foundations.checks import check_image
from gelform.foundations.npz_files import locked_folder, sweep
from gelform.foundations.pictures import picture_bytes
from gelform.foundations.tables import table_text


@contextmanager
def written_whole(target: Path) -> Iterator[Path]:
    """A temporary folder next to `target`; it gets that name if the block ends without an error, else it is deleted."""
    try:
        if target.exists() and (not target.is_dir() or any(target.iterdir())):
            raise DataError(
                f"Expected a new or empty folder, got {target}, which holds something. Choose another name."
            )
        target.parent.mkdir(parents=True, exist_ok=True)
        sweep(target.parent, target.name)
        partial = Path(tempfile.mkdtemp(prefix=f".{target.name}.partial-", dir=target.parent))
    except OSError as error:
        raise DataError(f"Cannot write into {target.parent}: {error.strerror or error}.") from error
    try:
        with locked_folder(partial):
            check_room(partial)
            yield partial
            with suppress(OSError):  # a file system without times
                os.utime(partial)  # it has no lock from now on; `sweep` spares it for a minute
        partial.chmod(0o777 & ~_umask())
        if target.exists():
            target.rmdir()
        partial.rename(target)
    except OSError as error:
        raise DataError(
            f"Cannot write {target}: {error.strerror or error}. Nothing of it was kept."
        ) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)  # if it did not get its name


def check_room(folder: Path) -> None:
    """Write a few kilobytes into a folder and delete them: a full disk raises OSError before the work, not after."""
    with tempfile.TemporaryFile(dir=folder) as probe:
        probe.write(bytes(16_384))  # several blocks of any file system


def write_sensor_toml(path: Path, name: str, mm_per_px: float, serial: str = "") -> None:
    """Write a minimal `sensor.toml`: a name, the width of a pixel, mm, and the serial number if there is one."""
    import tomlkit  # imported here, because most commands import this module and write no such file

    unit = {"serial": serial} if serial else {}
    content = tomlkit.dumps({"name": name, "mm_per_px": float(mm_per_px), **unit})
    path.write_text(content, encoding="utf-8")


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


def write_npz(path: Path, arrays: Mapping[str, ArrayLike]) -> None:
    """Write named arrays, compressed."""
    members: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
    with path.open("wb") as file:
        np.savez_compressed(file, **members)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
