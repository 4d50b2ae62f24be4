"""The Reconstruction record: what one frame gave; saved, loaded and shown."""

from __future__ import annotations

import base64
import html
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import cached_property
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.background.change import Finding
from gelform.checks import check_finite, check_map, check_mm_per_px, check_number, check_within
from gelform.errors import DataError, GelformError
from gelform.normals import normals_from_gradients
from gelform.npz_files import read_npz, write_npz

KIND = "gelform result"
FORMAT_VERSION = 3  # 1: in mm; 2: in pixels; 3: either, and gradients are those of the solved depth
MAX_BYTES = 4 * 2**30
_OPTIONAL = ("depth_sigma_mm", "gradients_sigma", "observed_gradients")
_MAPS = ("gradients", "confidence", "contact", "known", *_OPTIONAL)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What one frame gave.

    Attributes
    ----------
    depth : (H, W) float32, 0 at rest, positive where pressed; finite everywhere. In mm, or in widths of a pixel
        where mm_per_px is None: read depth_mm or depth_px, which say which
    depth_sigma_mm : (H, W) float32, mm, one standard deviation, or None
    gradients : (H, W, 2) float32, slopes dz/dx and dz/dy of the solved depth, mm/mm
    gradients_sigma : (H, W, 2) float32, their standard deviation, or None
    observed_gradients : (H, W, 2) float32, slopes as the color model read them, without the bias of untouched pixels:
        what the depth was solved from. None in results of format versions 1 and 2, whose `gradients` they are
    confidence : (H, W) float32, 0-1
    contact : (H, W) bool, where something touches
    known : (H, W) bool; False where the depth was filled without information
    mm_per_px : float or (x, y), mm; None where the calibration has no scale
    mm_per_px_sigma : its standard deviation, mm, or None; not part of depth_sigma_mm
    zero : what depth 0 is: "untouched", "border", "mean"
    solver : the method that integrated
    curl_rms : RMS of `dp/dy - dq/dx` of the observed slopes, per pixel: how far they are from those of a surface
    health : findings that a user should know, each with its figure
    index, time_s, wall_time_ns : of the frame, or None
    calibration_digest : of the calibration that was used
    albedo_source : gives the albedo when it is asked for; not saved
    """

    depth: NDArray[np.float32]
    depth_sigma_mm: NDArray[np.float32] | None
    gradients: NDArray[np.float32]
    gradients_sigma: NDArray[np.float32] | None
    confidence: NDArray[np.float32]
    contact: NDArray[np.bool_]
    known: NDArray[np.bool_]
    mm_per_px: float | tuple[float, float] | None
    mm_per_px_sigma: float | None = None
    observed_gradients: NDArray[np.float32] | None = None
    zero: str = "untouched"
    solver: str = ""
    curl_rms: float = 0.0
    health: tuple[Finding, ...] = ()
    index: int | None = None
    time_s: float | None = None
    wall_time_ns: int | None = None
    calibration_digest: str = ""
    albedo_source: Callable[[], NDArray[np.float32]] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        shape = np.shape(self.depth)
        if len(shape) != 2:
            raise ValueError(f"Expected depth of shape (H, W), got {shape}.")
        for name in _MAPS:
            wanted = (*shape, 2) if "gradients" in name else shape
            values = getattr(self, name)
            if np.shape(values) != wanted and not (values is None and name in _OPTIONAL):
                raise ValueError(f"Expected {name} of shape {wanted}, as depth, got {np.shape(values)}.")

    @cached_property
    def normals(self) -> NDArray[np.float32]:
        """Unit normals (H, W, 3), n_z > 0, of the gradients."""
        return normals_from_gradients(self.gradients)

    @cached_property
    def albedo(self) -> NDArray[np.float32] | None:
        """Reflectance (H, W) relative to the gel at rest, where the color model is photometric stereo.

        None for other models, which do not tell a darker gel from a steeper one, and for loaded results.
        """
        return None if self.albedo_source is None else self.albedo_source()

    @property
    def depth_mm(self) -> NDArray[np.float32]:
        """Depth (H, W), mm, 0 at rest, positive where pressed; finite everywhere.

        Raises
        ------
        GelformError
            The calibration has no scale: there is depth_px only.
        """
        if self.mm_per_px is None:
            raise GelformError(
                "The scale of this calibration is unknown, so there is no depth_mm. Read depth_px, the depth in "
                "widths of a pixel, or import the calibration again with the width of a pixel on the gel: "
                "gelform import ... --mm-per-px F."
            )
        return self.depth

    @property
    def depth_px(self) -> NDArray[np.float32]:
        """Depth (H, W) in widths of a pixel: depth_mm / mm_per_px, and all there is without a scale.

        Raises
        ------
        GelformError
            The pixels are not square.
        """
        if self.mm_per_px is None:
            return self.depth
        pitch_x, pitch_y = check_mm_per_px(self.mm_per_px)
        if pitch_x != pitch_y:
            raise GelformError(
                f"Expected square pixels for a depth in pixels, got mm_per_px={self.mm_per_px}."
            )
        return (self.depth / np.float32(pitch_x)).astype(np.float32)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the maps."""
        height, width = self.confidence.shape
        return height, width

    @property
    def peak_mm(self) -> float:
        """The deepest point, mm."""
        return float(self.depth_mm.max())

    def __repr__(self) -> str:
        figures = ", ".join(f"{name}: {value}" for name, value in self._figures().items())
        return f"Reconstruction({figures})"

    def _repr_html_(self) -> str:
        """What a notebook shows: the depth as a small picture beside its figures; nothing is fetched."""
        picture = base64.b64encode(_depth_png(self.depth)).decode("ascii")
        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>"
            for name, value in [*self._figures().items(), *((f.name, f.message) for f in self.health)]
        )
        return (
            "<div style='display:flex;gap:1em;align-items:flex-start'>"
            f"<img alt='depth' src='data:image/png;base64,{picture}'/><table>{rows}</table></div>"
        )

    def _figures(self) -> dict[str, str]:
        height, width = self.shape
        if self.mm_per_px is None:
            return {
                "height x width": f"{height}x{width} px, scale unknown",
                "depth": f"{self.depth_px.min():.2f} to {self.depth_px.max():.2f} px",
                "contact": f"{np.count_nonzero(self.contact)} px",
                "zero": self.zero,
                "solver": self.solver,
            }
        pitch = np.broadcast_to(self.mm_per_px, 2)
        area = np.count_nonzero(self.contact) * float(pitch[0] * pitch[1])
        return {
            "height x width": f"{height}x{width} px, {height * pitch[1]:.1f}x{width * pitch[0]:.1f} mm",
            "depth": f"{self.depth_mm.min():.3f} to {self.peak_mm:.3f} mm",
            "contact": f"{area:.1f} mm^2",
            "zero": self.zero,
            "solver": self.solver,
        }


def save_result(result: Reconstruction, path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Write a result as one `.npz` without pickles, under a temporary name first.

    `numpy.load` gives its maps by name, and `mm_per_px`; `load_result` gives all of it. A result without a scale
    holds `depth_px` instead of `depth_mm` and `mm_per_px`.

    Raises
    ------
    DataError
        The file is already there and `overwrite` is False, or it cannot be written.
    """
    check_map(result.depth, "depth")  # NaN is no depth
    arrays = {name: getattr(result, name) for name in _MAPS if getattr(result, name) is not None}
    if result.mm_per_px is None:
        arrays["depth_px"] = result.depth
    else:
        arrays |= {"depth_mm": result.depth, "mm_per_px": np.asarray(result.mm_per_px, dtype=np.float64)}
    meta = {name: getattr(result, name) for name in _META}
    meta["health"] = [asdict(finding) for finding in result.health]
    write_npz(path, arrays, meta, kind=KIND, version=FORMAT_VERSION, overwrite=overwrite, error=DataError)


def load_result(path: str | PathLike[str]) -> Reconstruction:
    """Read a result.

    Raises
    ------
    DataError
        The file is missing, truncated, altered, no result, or of a newer format: the message says which.
    """
    arrays, meta = read_npz(
        path, kind=KIND, newest_version=FORMAT_VERSION, max_bytes=MAX_BYTES, error=DataError
    )
    try:
        _check_contents(arrays, meta)
        scaled = "depth_px" not in arrays
        settings = {name: meta[name] for name in _META}
        settings["health"] = tuple(Finding(**finding) for finding in meta["health"])
        maps: dict[str, Any] = {name: arrays.get(name) for name in _MAPS}
        return Reconstruction(
            depth=arrays["depth_mm" if scaled else "depth_px"],
            mm_per_px=_pitch(arrays["mm_per_px"]) if scaled else None,
            **maps,
            **settings,
        )
    except KeyError as problem:
        raise DataError(f"{path} is damaged: {problem} is missing. Reconstruct again.") from problem
    except (TypeError, ValueError) as problem:
        said = (
            str(problem) if str(problem).startswith("Expected") else "what it holds does not make a result."
        )
        raise DataError(f"{path} is damaged: {said} Reconstruct again.") from problem


def _check_contents(arrays: dict[str, NDArray[Any]], meta: dict[str, Any]) -> None:
    """Refuse NaN, arrays of other types and settings of the wrong kind; the record looks at shapes itself."""
    for name, array in arrays.items():
        wanted = np.bool_ if name in ("contact", "known") else np.floating
        if not np.issubdtype(array.dtype, wanted):
            raise TypeError(f"Expected {name} of another type, got {array.dtype}.")
        check_finite(array, name)
    for name in ("zero", "solver", "calibration_digest"):
        if not isinstance(meta[name], str):
            raise TypeError(f"Expected {name} as text, got {type(meta[name]).__name__}.")
    check_within(meta["curl_rms"], "curl_rms", 0, np.inf)
    for name in ("mm_per_px_sigma", "index", "time_s", "wall_time_ns"):
        if meta[name] is not None:
            check_number(meta[name], name)
    for finding in meta["health"]:
        if not isinstance(finding["name"], str) or not isinstance(finding["message"], str):
            raise TypeError("Expected findings with a name and a message.")
        check_number(finding["figure"], "figure")


def _pitch(stored: NDArray[Any]) -> float | tuple[float, float]:
    x, y = check_mm_per_px(stored)
    return x if stored.ndim == 0 else (x, y)


_META = (
    "mm_per_px_sigma",
    "zero",
    "solver",
    "curl_rms",
    "health",
    "index",
    "time_s",
    "wall_time_ns",
    "calibration_digest",
)


def _depth_png(depth: NDArray[np.float32], width_px: int = 240) -> bytes:
    """A small picture of the depth: dark at rest, bright where deep."""
    low, high = float(depth.min()), float(depth.max())
    levels = ((depth - low) * (255 / max(high - low, 1e-9))).astype(np.uint8)
    scale = width_px / depth.shape[1]
    size = (width_px, max(1, round(depth.shape[0] * scale)))
    small = cv2.resize(levels, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    done, png = cv2.imencode(".png", cv2.applyColorMap(small, cv2.COLORMAP_VIRIDIS))
    if not done:
        raise DataError(f"OpenCV cannot encode a picture of {depth.shape[0]}x{depth.shape[1]} px as PNG.")
    return bytes(png.tobytes())
