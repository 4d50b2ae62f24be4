"""Tables of other packages: look-up tables from color difference to gradients, and Taxim's forward model.

The look-up tables (`table_smooth.npy`, and MATLAB's `LookupTable` in a `.mat`) are in the tradition of Dong and Yuan
(W. Yuan, S. Dong, E. H. Adelson, GelSight: high-resolution robot tactile sensors, Sensors 17(12), 2017). Taxim's tables
(`polycalib.npz`) bin slopes by angle and direction. Each bin has a quadratic polynomial of the pixel's place for each
channel's change in gray levels (Z. Si and W. Yuan, Taxim: an example-based simulation model for GelSight tactile sensors,
RA-L 2022).
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import scipy  # its parts load at first use

from gelform.arrays import Array, Map, Numbers
from gelform.errors import DataError, said
from gelform.foundations.checks import check_numbers, check_path, check_positive
from gelform.foundations.files import DAMAGED_ARCHIVE, MAX_ARRAY_BYTES, bytes_of, checked_archive, read_npy
from gelform.slopes.color_models.tables import LookupModel

RANGE_LEVELS = (-90.0, 90.0)  # gray levels, the usual range of differences in a look-up table without one
MOST_LEVELS = 1024.0  # gray levels, the widest range of differences
HEIGHT, WIDTH = 480, 640  # px, size of the images whose pixels Taxim's polynomials use
MEMBERS = ("bins", "grad_b", "grad_g", "grad_r")  # "r" is channel 0 of an OpenCV image, which is blue
_DAMAGED = (OSError, *DAMAGED_ARCHIVE, ValueError, AttributeError, TypeError)


def read_lut(
    path: str | PathLike[str],
    background: Map,
    *,
    depth_sign: int = 1,
    range_levels: Sequence[float] | None = None,
) -> LookupModel:
    """A table (bins, bins, bins, 2) of gradients (gx, gy), indexed by the blue, green and red difference.

    The images are blurred by 3x3 px; their difference is multiplied by 1 + 2 (mean(I0)/I0 - 1). Values hold at the
    bins' centers, with linear interpolation between them. The table's gradient for no difference is subtracted. The
    file does not state its accuracy, so no standard deviation is given.

    A `.mat` has MATLAB's struct LookupTable, whose slope angles GradMag and directions GradDir become gradients, and
    states its range. The differences of a `.npy` span `range_levels` in each channel, (low, high) in gray levels, or three
    such pairs in a row, for blue, green and red; -90 to 90 by default. `depth_sign` is 1 if the table's surface rises where
    pressed, -1 if it falls.

    DataError: the file is missing, no such table, or damaged. ValueError: the range is none, or is given for a `.mat`.
    """
    if depth_sign not in (1, -1):
        raise ValueError(f"Expected depth_sign 1 or -1, got {depth_sign}.")
    if is_matlab(path):
        if range_levels is not None:
            raise ValueError(f"Expected no range for {path}, which states its own: leave --range out.")
        fields = _matlab(path)
        magnitude, direction = fields["GradMag"], fields["GradDir"]
        slopes = np.tan(magnitude)[..., None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
        step = np.full(3, fields["Scale"] / (len(slopes) - 1))
        low = np.full(3, fields["Zeropoint"])
    else:
        array = read_npy(path, "a look-up table")
        shape = array.shape
        if len(shape) != 4 or shape[3] != 2 or len(set(shape[:3])) != 1 or not 4 <= shape[0] <= 200:
            raise DataError(f"Expected a table of shape (bins, bins, bins, 2) in {path}, got {shape}.")
        if not np.issubdtype(array.dtype, np.floating) or not np.isfinite(array).all():
            raise DataError(f"Expected finite floats in {path}, got {array.dtype} or NaN.")
        slopes = array.astype(np.float64).transpose(2, 1, 0, 3)  # to red, green, blue
        low, high = _ranges(range_levels)
        step = (high - low) / len(slopes)
    unknown = np.zeros((*slopes.shape[:3], 1))
    table = np.concatenate([depth_sign * slopes, unknown], axis=-1)[None, None].astype(np.float32)
    height, width = background.shape[:2]
    return LookupModel(table, low + step / 2, step, (height, width), "mean_over_background", background)


def _ranges(given: Sequence[float] | None) -> tuple[Numbers, Numbers]:
    """Lowest and highest difference (3,) of red, green and blue."""
    given = RANGE_LEVELS if given is None else given
    numbers = check_numbers(given, "range_levels", 6 if len(given) > 2 else 2)
    # Blue, green, red to red, green, blue.
    pairs = np.broadcast_to(np.reshape(numbers, (-1, 2)), (3, 2))[::-1]
    if not ((pairs[:, 0] < 0) & (pairs[:, 1] > 0) & (abs(pairs) <= MOST_LEVELS).all(axis=1)).all():
        raise ValueError(
            f"Expected range_levels (--range) as a low difference below 0 and a high one above, gray levels, got {given}."
        )
    return pairs[:, 0].copy(), pairs[:, 1].copy()


def is_matlab(path: str | PathLike[str]) -> bool:
    """Whether a look-up table is a file of MATLAB, by its name."""
    return Path(path).suffix.lower() == ".mat"


def mm_per_px_of_lut(path: str | PathLike[str], image_shape: tuple[int, int]) -> float | None:
    """The scale that MATLAB's table states for images (H, W) of its frames, or of their middle; None if it states none.

    DataError: it is of frames of another size.
    """
    if not is_matlab(path) or "Pixmm" not in (fields := _matlab(path)):
        return None
    frame = np.atleast_1d(fields.get("FrameSize", image_shape)).ravel()[:2]
    cut = frame - np.array(image_shape)
    if len(frame) != 2 or cut[0] != cut[1] or cut[0] < 0:
        raise DataError(
            f"{path} states {fields['Pixmm']:g} mm per pixel of frames of {'x'.join(f'{size:g}' for size in frame)} px, and "
            f"the background is {image_shape[0]}x{image_shape[1]} px. Give the scale of these images: --mm-per-px."
        )
    return check_positive(fields["Pixmm"], f"Pixmm of {path}")


def _matlab(path: str | PathLike[str]) -> dict[str, Any]:
    """The fields of the struct LookupTable in a file of MATLAB: arrays, and one number each as float."""
    content = bytes_of(Path(path), "a look-up table (.mat)", MAX_ARRAY_BYTES)
    if content[:10] == b"MATLAB 7.3":
        raise DataError(
            f"{path} is of MATLAB's format 7.3. Save it in MATLAB with: save file.mat LookupTable -v7"
        )
    try:
        _check_inflated(content)
        table = scipy.io.loadmat(BytesIO(content), variable_names=["LookupTable"])["LookupTable"][0, 0]
        arrays = {name: np.asarray(table[name], dtype=np.float64) for name in table.dtype.names}
    except KeyError:
        raise DataError(f"Expected a struct LookupTable in {path}, got none.") from None
    except (Exception, MemoryError) as problem:  # scipy's reader raises many kinds on damaged bytes
        raise DataError(
            f"{path} is no file of MATLAB with a LookupTable, or a damaged one: {said(problem)}."
        ) from problem
    fields: dict[str, Any] = {name: one.item() if one.size == 1 else one for name, one in arrays.items()}
    wanted = ("bins", "GradMag", "GradDir", "Zeropoint", "Scale")
    missing = [name for name in wanted if name not in fields]
    if missing:
        raise DataError(
            f"Expected the fields {', '.join(wanted)} in LookupTable of {path}, got no {', '.join(missing)}."
        )
    magnitude, direction, zero, scale = (fields[name] for name in wanted[1:])
    shape = np.shape(magnitude)
    are_cubes = len(shape) == 3 and shape == np.shape(direction) == (shape[:1] * 3)
    if (
        not (are_cubes and 4 <= shape[0] <= 200 and fields["bins"] == shape[0])
        or not np.isfinite([magnitude, direction]).all()
        or abs(magnitude).max() >= np.pi / 2
    ):
        raise DataError(
            f"Expected GradMag (angles under pi/2) and GradDir of shape (bins, bins, bins) in {path}, got {shape}."
        )
    # Older programs divide by the background first, and have a scale of 0.005.
    if np.ndim(zero) or np.ndim(scale) or not (10 <= scale <= MOST_LEVELS and -scale < zero < 0):
        raise DataError(
            f"Expected Zeropoint and Scale of {path} in gray levels, such as -90 and 180, got {zero} and {scale}. gelform "
            "reads tables of gray-level differences (matchGrad_Bnz), none of differences over the background (matchGrad)."
        )
    return fields


def _check_inflated(content: bytes) -> None:
    """ValueError: a variable in a file of MATLAB takes more memory than a table can need."""
    at, left = 128, MAX_ARRAY_BYTES
    while at + 8 <= len(content):
        kind, size = np.frombuffer(content, "<u4", 2, at)
        if kind == 15:  # compressed (MAT-file format, level 5)
            inflate = zlib.decompressobj()
            left -= len(inflate.decompress(content[at + 8 : at + 8 + int(size)], left + 1))
            if left < 0:
                raise ValueError(f"it takes more than {MAX_ARRAY_BYTES >> 20} MB")
        at += 8 + int(size)


@dataclass(frozen=True, eq=False)
class TaximTables:
    """A forward model in Taxim's form."""

    # (bins, bins, 3, 6) float64: by slope angle (0 to 90 degrees) and direction (-180 to 180), for red, green and
    # blue: the factors of x^2, y^2, x y, x, y, 1 in pixels of an image of 480x640.
    table: Numbers
    name: str = "Taxim tables"

    def level_change(self, gradients: Array, *, as_level: bool = False) -> Numbers:
        """Change in gray levels (H, W, 3) for slopes (H, W, 2) of an image of the whole gel, in the tables' bins.

        With `as_level`, as if each slope were 0 in its own direction.
        """
        height, width = gradients.shape[:2]
        last = len(self.table) - 1
        p, q = np.moveaxis(np.asarray(gradients, dtype=np.float64), -1, 0)
        angle = np.zeros((height, width)) if as_level else np.arctan(np.hypot(p, q))
        steepness = np.floor(angle / (np.pi / 2 / last)).astype(np.intp)
        direction = np.floor((np.arctan2(q, p) + np.pi) / (2 * np.pi / last)).astype(np.intp)
        x = np.broadcast_to((np.arange(width) + 0.5) * (WIDTH / width) - 0.5, (height, width))
        y = np.broadcast_to(((np.arange(height) + 0.5) * (HEIGHT / height) - 0.5)[:, None], (height, width))
        place = np.stack([x**2, y**2, x * y, x, y, np.ones_like(x)], axis=-1)
        change = np.einsum("hwck,hwk->hwc", self.table[steepness, direction], place)
        return np.asarray(change, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class TaximLook:
    """Taxim's tables on a background image: a look for `gelform.simulate.twin.Twin`.

    The tables were fitted inside contacts, where level gel has another color than at rest. Their color of level gel is
    therefore faded in over the first 0.1 mm of depth. Gel at rest keeps its background.

    Attributes
    ----------
    tables : from `read_taxim_forward`
    background : (H, W, 3) float32, 4:3 as the tables, oriented as the images of their calibration
    mm_per_px : of this image; the tables contain no scale
    noise : (3,) gray levels
    """

    tables: TaximTables
    background: Map
    mm_per_px: float
    noise: Numbers

    def __post_init__(self) -> None:
        check_positive(self.mm_per_px, "mm_per_px")
        shape = np.shape(self.background)
        if len(shape) != 3 or shape[2] != 3 or abs(shape[1] / shape[0] * HEIGHT / WIDTH - 1) > 0.02:
            raise ValueError(
                f"Expected a background of shape (H, W, 3) with W/H = 4/3 as the tables', got {shape}. "
                "Turn an upright one by 90 degrees clockwise, as Taxim's images of that sensor are."
            )

    @property
    def name(self) -> str:
        """The name of the tables."""
        return self.tables.name

    def levels(self, gradients: Array, depth_mm: Array) -> Map:
        """Gray levels (H, W, 3), 0-255, of slopes (H, W, 2) and depths (H, W)."""
        level = self.tables.level_change(gradients, as_level=True)
        untouched = 1 - np.clip(depth_mm / 0.1, 0, 1)[..., None]
        levels = self.background + self.tables.level_change(gradients) - untouched * level
        return np.asarray(np.clip(levels, 0, 255), dtype=np.float32)


def is_taxim_forward(path: str | PathLike[str]) -> bool:
    """Whether a file is an archive with Taxim's members; `load_calibration` reports other kinds."""
    try:
        return {f"{name}.npy" for name in MEMBERS} <= set(checked_archive(path, "Taxim's tables"))
    except (DataError, *_DAMAGED):  # no archive: an array, or another file
        return False


def read_taxim_forward(path: str | PathLike[str]) -> TaximTables:
    """Read Taxim's `polycalib.npz`.

    DataError: it is missing, lacks these tables, is damaged, too large, or of another form.
    """
    path = check_path(path)
    try:
        checked_archive(path, "Taxim's tables (polycalib.npz)", MAX_ARRAY_BYTES)
        with open(path, "rb") as handle, np.load(handle, allow_pickle=False) as file:
            missing = [name for name in MEMBERS if name not in file.files]
            if missing:
                raise DataError(f"{path} lacks {', '.join(missing)}: expected Taxim's {', '.join(MEMBERS)}.")
            bins, *channels = (np.asarray(file[name], dtype=np.float64) for name in MEMBERS)
    except _DAMAGED as problem:
        raise DataError(f"{path} is damaged, or no archive (.npz) of numbers: {said(problem)}.") from problem
    count = int(bins) if bins.ndim == 0 and np.isfinite(bins) else 0
    if not 2 <= count <= 2000 or any(one.shape != (count, count, 6) for one in channels):
        shapes = ", ".join(str(one.shape) for one in channels)
        raise DataError(f"{path}: expected three tables of shape (bins, bins, 6), got {shapes}, bins {bins}.")
    table = np.stack(channels, axis=2)
    if not np.all(np.isfinite(table)):
        raise DataError(f"{path}: expected finite tables, got NaN or infinity.")
    return TaximTables(table, path.stem)
