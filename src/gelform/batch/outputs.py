"""One frame's result as a file, under a temporary name first; what the table says of it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.batch.settings import BatchSettings
from gelform.errors import DataError
from gelform.exporters.quantised import levels_from_depth
from gelform.npz_files import write_npz, written_file
from gelform.reconstruction import Reconstruction, save_result

KIND, VERSION = "gelform maps", 1
_NAMES = {"depth": "depth_mm", "depth_sigma": "depth_sigma_mm"}


def writer_of(result: Reconstruction, settings: BatchSettings) -> Callable[[Path], None]:
    """What writes a result to a path, whole or not at all; whatever the result itself forbids is said before.

    Raises
    ------
    DataError
        Depth beyond 16 bits, or a map that this calibration does not give; the writer: the disk is full.
    """
    if settings.form == "png":
        return _png_writer(levels_from_depth(result.depth_mm, result.known))
    if settings.keep == ("all",):
        return lambda path: save_result(result, path, overwrite=True)
    arrays = {_NAMES.get(name, name): _map(result, _NAMES.get(name, name)) for name in settings.keep}
    arrays["mm_per_px"] = np.asarray(result.mm_per_px, dtype=np.float64)
    meta = {"calibration_digest": result.calibration_digest, "index": result.index}
    return lambda path: write_npz(path, arrays, meta, kind=KIND, version=VERSION, overwrite=True)


def facts_of(result: Reconstruction) -> dict[str, Any]:
    """Deepest point (mm), area (mm^2) and volume (mm^3) of all contacts, their number, and the findings' names."""
    return {
        "deepest_mm": result.peak_mm,
        "contact_mm2": float(sum(one.area_mm2 or 0.0 for one in result.contacts)),
        "volume_mm3": float(sum(one.volume_mm3 or 0.0 for one in result.contacts)),
        "contacts": len(result.contacts),
        "findings": " ".join(dict.fromkeys(finding.name for finding in result.health)),
    }


def size_and_digest(path: Path) -> tuple[int, str]:
    """Bytes and SHA-256 of a file."""
    content = path.read_bytes()
    return len(content), hashlib.sha256(content).hexdigest()


def _map(result: Reconstruction, name: str) -> NDArray[Any]:
    values = getattr(result, name)
    if values is None:
        raise DataError(f"This calibration gives no {name}. Leave it out of --keep.")
    return np.asarray(values)


def _png_writer(levels: NDArray[np.uint16]) -> Callable[[Path], None]:
    done, encoded = cv2.imencode(".png", levels, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    if not done:
        raise DataError(f"OpenCV cannot encode {levels.shape[0]}x{levels.shape[1]} levels as PNG.")

    def write(path: Path) -> None:
        with written_file(path, overwrite=True) as file:
            file.write(encoded.tobytes())

    return write
