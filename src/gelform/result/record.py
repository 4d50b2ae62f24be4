"""Reconstruction: the result of one frame, its numbers, and its file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields
from os import PathLike
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import MIB, Array, Map, Mask
from gelform.depth.contact import Contact, at_least, contacts_of, may_be_deeper
from gelform.depth.force import Force, ForceModel, force_from_result
from gelform.errors import DataError, Finding, GelformError
from gelform.foundations.checks import (
    check_finite,
    check_is,
    check_map,
    check_mask,
    check_mm_per_px,
    check_number,
    check_within,
)
from gelform.foundations.files import damaged, picture_bytes, read_npz, shown_in_notebook, write_npz
from gelform.foundations.pool import once
from gelform.image.markers import MarkerFlow
from gelform.image.view import THUMBNAIL_PX
from gelform.result.maps import BESIDE_DEPTH, MAPS, ResultMaps
from gelform.result.shape import ShapeErrors
from gelform.slopes.normals import normals_of


@dataclass(frozen=True)
class ResultNumbers:
    """Numbers of one result: lengths in mm, or in widths of a pixel without a scale. Depth is that of known pixels."""

    peak: float  # largest depth
    lowest: float
    x_px: int  # place of the largest depth
    y_px: int
    area: float  # of all contacts
    volume: float  # of the gel displaced in them
    contacts: int
    contact_px: int
    at_least: bool = False  # whether unknown pixels are deeper than the deepest known one, or next to it

    @property
    def over_time(self) -> dict[str, float]:
        """The numbers that are plotted over time."""
        return {"peak": self.peak, "area": self.area, "volume": self.volume}


@dataclass(frozen=True, eq=False)
class Reconstruction(ResultMaps):
    """The result of one frame. What is not its depth is computed on first use, if a Reconstructor made it.

    Attributes
    ----------
    depth : (H, W) float32, 0 at rest, positive where pressed; finite everywhere. In mm, or in widths of a pixel
        if mm_per_px is None; depth_mm and depth_px have a fixed unit
    depth_sigma_mm : (H, W) float32, mm, one standard deviation, or None
    gradients : (H, W, 2) float32, slopes dz/dx and dz/dy of the solved depth, mm/mm
    gradients_sigma : (H, W, 2) float32, their standard deviation, or None
    observed_gradients : (H, W, 2) float32, slopes from the color model, without the bias of pixels at rest; the
        depth was solved from them. None in results of format versions 1 and 2, where `gradients` holds them
    confidence : (H, W) float32, 0-1
    contact : (H, W) bool, True where something touches
    known : (H, W) bool; False where the depth was filled without information
    mm_per_px : float or (x, y), mm; None if the calibration has no scale
    mm_per_px_sigma : standard deviation of mm_per_px, mm, or None; not part of depth_sigma_mm
    zero : the reference of depth 0: "untouched" (pixels at rest), "border", "mean" or "set" (an earlier result)
    solver : the solver that ran
    curl_rms : RMS of `dp/dy - dq/dx` of the observed slopes, per pixel; 0 for the slopes of a surface
    health : findings, each with its figure
    markers : displacements of the gel's markers; None if the gel has none
    outside_change : median color change outside the contact over its mean inside, which is large for soft objects; None
        without a contact
    inside_change : mean color change inside the contact, RMS of a channel; None without a contact
    index, time_s, wall_time_ns : of the frame, or None
    calibration_digest : digest of the calibration that was used
    force_model : converts the result to `force`; None if no loads were calibrated. Not saved
    shape_errors : how the errors of the depth hang together; None if unknown, also in results of earlier files
    albedo_source : function that computes `albedo` on demand; not saved
    """

    mm_per_px: float | tuple[float, float] | None
    mm_per_px_sigma: float | None = None
    zero: str = "untouched"
    solver: str = ""
    # Without an attribute of the class, which would hide that a value is still to be computed.
    curl_rms: float = field(default_factory=float)
    health: tuple[Finding, ...] = field(default_factory=tuple)
    markers: MarkerFlow | None = None
    outside_change: float | None = field(default_factory=lambda: None)
    inside_change: float | None = field(default_factory=lambda: None)
    index: int | None = None
    time_s: float | None = None
    wall_time_ns: int | None = None
    calibration_digest: str = ""
    force_model: ForceModel | None = field(default=None, repr=False)
    shape_errors: ShapeErrors | None = field(default_factory=lambda: None, repr=False)
    albedo_source: Callable[[], Map] | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        shape = np.shape(self.depth)
        if len(shape) != 2:
            raise ValueError(f"Expected depth of shape (H, W), got {shape}.")
        own = vars(self)
        own["_later"] = later = {name: value for name, value in own.items() if isinstance(value, once)}
        for name in later:
            del own[name]
        for one in BESIDE_DEPTH:
            if one.name in later:
                continue
            values, wanted = getattr(self, one.name), (*shape, *one.axes)
            if np.shape(values) != wanted and not (values is None and one.optional):
                raise ValueError(f"Expected {one.name} of shape {wanted}, as depth, got {np.shape(values)}.")

    def __getattr__(self, name: str) -> Any:
        """Compute what is not there yet."""
        if (later := vars(self).get("_later", {}).get(name)) is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        vars(self)[name] = value = later()
        return value

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the content of a file: everything but the sources."""
        values = {one.name: getattr(self, one.name) for one in fields(self)}
        return {**values, "_later": {}, "albedo_source": None}

    def changed(self, **changes: Any) -> Reconstruction:
        """A copy with other values, which may be `once`; what nobody has asked for stays to be computed, once for both."""
        own, later = vars(self), vars(self)["_later"]
        values = {one.name: later.get(one.name, own.get(one.name)) for one in fields(self)}
        return type(self)(**{**values, **changes})

    @once
    def normals(self) -> Map:
        """Unit normals (H, W, 3), n_z > 0, of the gradients."""
        return normals_of(np.ascontiguousarray(self.gradients, np.float32))

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """The connected regions of `contact`, each with its measures; the largest first.

        They are computed on demand from contact and depth, so results of every file format have them.
        """
        return self._labeled[0]

    @once
    def numbers(self) -> ResultNumbers | None:
        """The deepest point, and the area and volume of all contacts; None if depth is known in no pixel."""
        known, depth, found = self.known, self.depth, self.contacts
        if not known.any():
            return None
        every = bool(known.all())
        y, x = divmod(int((depth if every else np.where(known, depth, -np.inf)).argmax()), depth.shape[1])
        lowest = float((depth if every else np.where(known, depth, np.inf)).min())
        touched = sum(one.area_px for one in found)
        if self.mm_per_px is None:
            area, volume = float(touched), float(depth[self.contact].sum(dtype=np.float64))
        else:
            area = float(sum(one.area_mm2 or 0.0 for one in found))
            volume = float(sum(one.volume_mm3 or 0.0 for one in found))
        deeper = not every and may_be_deeper(~known & self.contact, depth, (x, y))
        return ResultNumbers(float(depth[y, x]), lowest, x, y, area, volume, len(found), touched, deeper)

    @property
    def contact_labels(self) -> NDArray[np.uint16]:
        """The number (H, W) of each pixel's contact, as in `Contact.label`; 0 where nothing touches."""
        return self._labeled[1]

    @once
    def _labeled(self) -> tuple[tuple[Contact, ...], NDArray[np.uint16]]:
        maps = np.ascontiguousarray(self.contact), np.ascontiguousarray(self.depth, np.float32)
        pitch = None if self.mm_per_px is None else check_mm_per_px(self.mm_per_px)
        return contacts_of(*maps, pitch, self.known)

    @once
    def force(self) -> Force:
        """The force on the gel, N, each part with its standard deviation, or None and the reason."""
        return force_from_result(self, self.force_model)

    @once
    def albedo(self) -> Map | None:
        """Reflectance (H, W) relative to the gel at rest, if the color model is photometric stereo.

        None for other models, which cannot distinguish a darker gel from a steeper one, and for loaded results.
        """
        return None if self.albedo_source is None else self.albedo_source()

    def depth_difference_sigma(self, region: ArrayLike | None = None) -> Map:
        """Standard deviation (H, W), mm, of the depth minus its mean over a region, that is, of the shape.

        Depth is measured from gel at rest, and most of its error is common to all pixels of a contact. That part is in
        `depth_sigma_mm`, but not in a difference of two depths of the contact. The call takes as long as a frame.

        Parameters
        ----------
        region : (H, W) bool; all of `contact` by default

        Raises
        ------
        GelformError
            The calibration states no deviation of slopes, or the result is of a file that lacks `shape_errors`.
        ValueError, TypeError
            No mask of that shape, or one without a pixel.
        """
        if self.shape_errors is None or self.depth_sigma_mm is None:
            raise GelformError(
                "Expected a result that says how errors of depth hang together. An earlier gelform did not save that, "
                "and an imported calibration does not state it. Reconstruct the frame again, with a calibration of balls."
            )
        pixels = check_mask(self.contact if region is None else region, shape=self.shape, name="region")
        sigma = self.shape_errors.difference_sigma(pixels)
        return np.asarray(np.maximum(sigma, self.depth_sigma_mm, out=sigma, where=~self.known))

    @property
    def depth_mm(self) -> Map:
        """Depth (H, W), mm, 0 at rest, positive where pressed; finite everywhere.

        Raises
        ------
        GelformError
            The calibration has no scale; use depth_px.
        """
        if self.mm_per_px is None:
            raise GelformError(
                "The scale of this calibration is unknown, so there is no depth_mm. Read depth_px, the depth in "
                "widths of a pixel, or import the calibration again with the width of a pixel on the gel: "
                "gelform import ... --mm-per-px F."
            )
        return self.depth

    @property
    def depth_px(self) -> Map:
        """Depth (H, W) in widths of a pixel: depth_mm / mm_per_px; available without a scale too.

        Raises
        ------
        GelformError
            The pixels are not square.
        """
        if self.mm_per_px is None:
            return self.depth
        pitch_x, pitch_y = check_mm_per_px(self.mm_per_px)
        if pitch_x != pitch_y:
            raise GelformError(f"Expected square pixels for depth in pixels, got mm_per_px={self.mm_per_px}.")
        return (self.depth / np.float32(pitch_x)).astype(np.float32)

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W) of the maps."""
        height, width = self.confidence.shape
        return height, width

    @property
    def peak_mm(self) -> float:
        """The largest depth of the known pixels, mm; NaN if none is known."""
        return float(self.depth_mm.max(where=self.known, initial=-np.inf)) if self.known.any() else np.nan

    def __repr__(self) -> str:
        return f"Reconstruction({', '.join(f'{name}: {value}' for name, value in self._figures().items())})"

    def _repr_html_(self) -> str:
        """A notebook's view of the result: a small picture of the depth and its figures; nothing is fetched."""
        findings = ((finding.name, finding.message) for finding in self.health)
        rows = (*self._figures().items(), *findings)
        return shown_in_notebook("depth", _depth_png(self.depth, self.known), rows)

    def _figures(self) -> dict[str, str]:
        height, width = self.shape
        size, unit, digits = "scale unknown", "px", 2
        if self.mm_per_px is not None:
            x, y = check_mm_per_px(self.mm_per_px)
            size, unit, digits = f"{height * y:.1f}x{width * x:.1f} mm", "mm", 3
        depth = contacts = "unknown"
        if (found := self.numbers) is not None:
            depth = f"{found.lowest:.{digits}f} to {at_least(found.at_least)}{found.peak:.{digits}f} {unit}"
            area = f"{found.contact_px} px" if unit == "px" else f"{round(found.area, 1)} mm^2"
            together = " together" if found.contacts > 1 else ""
            contacts = f"{found.contacts} of {area}{together}" if found.contacts else "none"
        return {
            "height x width": f"{height}x{width} px, {size}",
            "depth": depth,
            "contacts": contacts,
            **({} if self.markers is None else {"markers": self.markers.in_words()}),
            "zero": self.zero,
            "solver": self.solver,
        }


def _depth_png(depth: Map, known: Mask) -> bytes:
    """A small picture of the depth: dark at rest, bright where deep, hatched where unknown."""
    low, high = (float(depth[known].min()), float(depth[known].max())) if known.any() else (0.0, 0.0)
    levels = np.clip((depth - low) * (255 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)
    scale = THUMBNAIL_PX / depth.shape[1]
    size = (THUMBNAIL_PX, max(1, round(depth.shape[0] * scale)))
    small = cv2.resize(levels, size, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR)
    colors = np.asarray(cv2.applyColorMap(small, cv2.COLORMAP_VIRIDIS))
    row, col = np.ogrid[: size[1], : size[0]]
    hatch = np.where((row + col) % 8 < 2, np.uint8(150), np.uint8(225))
    unknown = cv2.resize(known.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) == 0
    colors[unknown] = hatch[unknown][:, np.newaxis]
    return picture_bytes(colors[..., ::-1])  # OpenCV colors are BGR


KIND, FORMAT_VERSION = "gelform result", 1
OPTIONAL = "outside_change", "inside_change"  # that earlier files lack
MARKERS = "markers_"  # before the names of the arrays of a `MarkerFlow`
SHAPE, SHAPE_MAPS = "shape_errors", ("variance", "common_mm")  # of `ShapeErrors`; the rest is in the settings
_META = (
    "mm_per_px_sigma", "zero", "solver", "curl_rms", "health", "index", "time_s", "wall_time_ns", "calibration_digest",
    *OPTIONAL,
)  # fmt: skip


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
    if result.shape_errors is not None:
        of_shape = dict(vars(result.shape_errors))
        arrays |= {f"{SHAPE}_{name}": of_shape.pop(name) for name in SHAPE_MAPS}
        meta[SHAPE] = of_shape
    write_npz(path, arrays, meta, kind=KIND, version=FORMAT_VERSION, overwrite=overwrite, error=DataError)


def load_result(path: str | PathLike[str]) -> Reconstruction:
    """Read a result.

    Raises
    ------
    DataError
        The file is missing, truncated, altered, no result, or of a newer format; the message says which.
    """
    most = 4 * 1024 * MIB  # bytes that a file may declare: far beyond any frame's result
    arrays, meta = read_npz(path, kind=KIND, newest_version=FORMAT_VERSION, max_bytes=most, error=DataError)
    with damaged(path, "a result", "Reconstruct again.", DataError):
        _check_contents(arrays, meta)
        dots = {name.removeprefix(MARKERS): arrays[name] for name in arrays if name.startswith(MARKERS)}
        mm_per_px: float | tuple[float, float] | None = None
        if "depth_px" not in arrays:
            x, y = check_mm_per_px(arrays["mm_per_px"])
            mm_per_px = x if arrays["mm_per_px"].ndim == 0 else (x, y)
        settings = {name: meta[name] for name in _META if name not in OPTIONAL or name in meta}
        settings["health"] = tuple(Finding(**finding) for finding in meta["health"])
        maps: dict[str, Any] = {one.name: arrays.get(one.name) for one in BESIDE_DEPTH}
        of_shape = None
        if SHAPE in meta:
            kept: dict[str, Any] = {name: arrays[f"{SHAPE}_{name}"] for name in SHAPE_MAPS}
            of_shape = ShapeErrors(**kept, **meta[SHAPE])
        return Reconstruction(
            depth=arrays["depth_px" if mm_per_px is None else "depth_mm"],
            mm_per_px=mm_per_px,
            markers=MarkerFlow(**dots, mm_per_px=mm_per_px) if dots else None,
            shape_errors=of_shape,
            **maps,
            **settings,
        )


def _check_contents(arrays: dict[str, Array], meta: dict[str, Any]) -> None:
    """Refuse NaN, arrays of other types and settings of the wrong kind; the record checks the shapes."""
    boolean = {f"{MARKERS}seen", *(one.name for one in MAPS.values() if one.dtype == "bool")}
    for name, array in arrays.items():
        wanted = np.bool_ if name in boolean else np.floating
        if not np.issubdtype(array.dtype, wanted):
            raise TypeError(f"Expected {name} of another type, got {array.dtype}.")
        check_finite(array, name)
    for name in ("zero", "solver", "calibration_digest"):
        if not isinstance(meta[name], str):
            raise TypeError(f"Expected {name} as text, got {type(meta[name]).__name__}.")
    check_within(meta["curl_rms"], "curl_rms", 0, np.inf)
    for name in ("mm_per_px_sigma", "index", "time_s", "wall_time_ns", *OPTIONAL):
        if meta.get(name) is not None:
            check_number(meta[name], name)
    for name, value in meta.get(SHAPE, {}).items():
        check_within(value, name, 0, np.inf)
    for finding in meta["health"]:
        if not isinstance(finding["name"], str) or not isinstance(finding["message"], str):
            raise TypeError("Expected findings with a name and a message.")
        check_number(finding["figure"], "figure")
