"""Files of results: one `.npz` without pickles; newer versions of gelform keep reading them."""

from __future__ import annotations

from dataclasses import asdict
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError
from gelform.foundations.checks import (
    check_finite,
    check_is,
    check_map,
    check_mm_per_px,
    check_number,
    check_within,
)
from gelform.foundations.findings import Finding
from gelform.foundations.npz_files import damaged, read_npz, write_npz
from gelform.image.markers import MarkerFlow
from gelform.result.maps import BESIDE_DEPTH, MAPS
from gelform.result.record import Reconstruction

KIND = "gelform result"
FORMAT_VERSION = 1
MAX_BYTES = 4 * 2**30  # bytes that a file may declare: far beyond any frame's result
OPTIONAL = "outside_change"  # that earlier files lack
MARKERS = "markers_"  # before the names of the arrays of a `MarkerFlow`
BOOLEAN = {f"{MARKERS}seen", *(one.name for one in MAPS.values() if one.dtype == "bool")}
_META = (
    "mm_per_px_sigma",
    "zero",
    "solver",
    "curl_rms",
    "health",
    "outside_change",
    "index",
    "time_s",
    "wall_time_ns",
    "calibration_digest",
)


def save_result(result: Reconstruction, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write a result as one `.npz` without pickles, under a temporary name first.

    `numpy.load` reads its maps by name, and `mm_per_px`; `load_result` reads everything. A result without a scale
    holds `depth_px` instead of `depth_mm` and `mm_per_px`.

    Raises
    ------
    DataError
        The file exists and `overwrite` is False, or it cannot be written.
    """
    check_map(check_is(result, Reconstruction, "result").depth, "depth")  # refuses NaN, which is no depth
    maps = {one.name: getattr(result, one.name) for one in BESIDE_DEPTH}
    arrays = {name: values for name, values in maps.items() if values is not None}
    if result.mm_per_px is None:
        arrays["depth_px"] = result.depth
    else:
        arrays |= {"depth_mm": result.depth, "mm_per_px": np.asarray(result.mm_per_px, dtype=np.float64)}
    if result.markers is not None:
        arrays |= {MARKERS + name: values for name, values in result.markers.arrays().items()}
    meta = {name: getattr(result, name) for name in _META}
    meta["health"] = [asdict(finding) for finding in result.health]
    write_npz(path, arrays, meta, kind=KIND, version=FORMAT_VERSION, overwrite=overwrite, error=DataError)


def load_result(path: str | PathLike[str]) -> Reconstruction:
    """Read a result.

    Raises
    ------
    DataError
        The file is missing, truncated, altered, no result, or of a newer format; the message says which.
    """
    arrays, meta = read_npz(
        path, kind=KIND, newest_version=FORMAT_VERSION, max_bytes=MAX_BYTES, error=DataError
    )
    with damaged(path, "a result", "Reconstruct again.", DataError):
        _check_contents(arrays, meta)
        dots = {name.removeprefix(MARKERS): arrays[name] for name in arrays if name.startswith(MARKERS)}
        mm_per_px = _pitch(arrays["mm_per_px"]) if "depth_px" not in arrays else None
        settings = {name: meta[name] for name in _META if name != OPTIONAL or name in meta}
        settings["health"] = tuple(Finding(**finding) for finding in meta["health"])
        maps: dict[str, Any] = {one.name: arrays.get(one.name) for one in BESIDE_DEPTH}
        return Reconstruction(
            depth=arrays["depth_px" if mm_per_px is None else "depth_mm"],
            mm_per_px=mm_per_px,
            markers=MarkerFlow(**dots, mm_per_px=mm_per_px) if dots else None,
            **maps,
            **settings,
        )


def _check_contents(arrays: dict[str, NDArray[Any]], meta: dict[str, Any]) -> None:
    """Refuse NaN, arrays of other types and settings of the wrong kind; the record checks the shapes."""
    for name, array in arrays.items():
        wanted = np.bool_ if name in BOOLEAN else np.floating
        if not np.issubdtype(array.dtype, wanted):
            raise TypeError(f"Expected {name} of another type, got {array.dtype}.")
        check_finite(array, name)
    for name in ("zero", "solver", "calibration_digest"):
        if not isinstance(meta[name], str):
            raise TypeError(f"Expected {name} as text, got {type(meta[name]).__name__}.")
    check_within(meta["curl_rms"], "curl_rms", 0, np.inf)
    for name in ("mm_per_px_sigma", "index", "time_s", "wall_time_ns", OPTIONAL):
        if meta.get(name) is not None:
            check_number(meta[name], name)
    for finding in meta["health"]:
        if not isinstance(finding["name"], str) or not isinstance(finding["message"], str):
            raise TypeError("Expected findings with a name and a message.")
        check_number(finding["figure"], "figure")


def _pitch(stored: NDArray[Any]) -> float | tuple[float, float]:
    x, y = check_mm_per_px(stored)
    return x if stored.ndim == 0 else (x, y)
