"""The maps of a result that a batch keeps, as they are written; what the table says of a result."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.batch.settings import BatchSettings
from gelform.errors import DataError
from gelform.exporters.quantised import MM_PER_LEVEL, UNKNOWN, ZERO_LEVEL, levels_from_depth
from gelform.reconstruction import Reconstruction
from gelform.reconstruction.maps import KEPT_MAPS, MAPS, ResultMap

LEVELS = {"unit": "mm", "scale_factor": MM_PER_LEVEL, "add_offset": -ZERO_LEVEL * MM_PER_LEVEL}


def maps_of(result: Reconstruction, settings: BatchSettings) -> dict[str, NDArray[Any]]:
    """The kept maps by their names in files, (H, W) or with axes behind; depth as uint16 levels where the settings say so.

    Raises
    ------
    DataError
        Depth beyond 16 bits, or a map that this calibration does not give.
    """
    if settings.dtype == "uint16":
        return {"depth_mm": levels_from_depth(result.depth_mm, result.known)}
    return {one.name: _map(result, one.name) for one in _kept(settings)}


def blank_maps(settings: BatchSettings, shape: tuple[int, int]) -> dict[str, NDArray[Any]]:
    """The maps of a frame that could not be done: NaN, False, or level 0, which means unknown."""
    if settings.dtype == "uint16":
        return {"depth_mm": np.full(shape, UNKNOWN, dtype=np.uint16)}
    blank = {"bool": False, "float32": np.nan}
    return {one.name: np.full((*shape, *one.axes), blank[one.dtype], one.dtype) for one in _kept(settings)}


def attributes_of(name: str, settings: BatchSettings) -> dict[str, Any]:
    """Unit of a map, and how levels are turned to mm: scale_factor x level + add_offset, the names of the CF conventions."""
    if settings.dtype == "uint16":
        return dict(LEVELS)
    return {"unit": MAPS[name].unit}


def facts_of(result: Reconstruction) -> dict[str, Any]:
    """Deepest point (mm, and its pixel), area (mm^2) and volume (mm^3) of all contacts, their number, findings' names."""
    depth_mm = result.depth_mm
    deepest_y, deepest_x = divmod(int(depth_mm.argmax()), depth_mm.shape[1])
    return {
        "deepest_mm": float(depth_mm[deepest_y, deepest_x]),
        "deepest_x_px": deepest_x,
        "deepest_y_px": deepest_y,
        "contact_mm2": float(sum(one.area_mm2 or 0.0 for one in result.contacts)),
        "volume_mm3": float(sum(one.volume_mm3 or 0.0 for one in result.contacts)),
        "contacts": len(result.contacts),
        "health": " ".join(dict.fromkeys(finding.name for finding in result.health)),
    }


def check_names(sequences: Iterable[str], settings: BatchSettings) -> None:
    """Refuse folders that are called as the arrays beside them would be.

    Raises
    ------
    DataError
        The message names the folder.
    """
    if settings.form not in ("zarr", "hdf5"):
        return
    arrays = {one.name for one in KEPT_MAPS.values()}
    for sequence in sequences:
        if taken := arrays & set(sequence.split("/")):
            raise DataError(
                f"The input {sequence} would lie where an array {taken.pop()} does. Rename it, or write npz."
            )


def _kept(settings: BatchSettings) -> list[ResultMap]:
    return [KEPT_MAPS[name] for name in settings.keep]


def _map(result: Reconstruction, name: str) -> NDArray[Any]:
    values = getattr(result, name)
    if values is None:
        raise DataError(f"This calibration gives no {name}. Leave it out of --keep.")
    return np.asarray(values)
