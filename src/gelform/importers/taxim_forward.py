"""Taxim's tables (`polycalib.npz`): a forward model, from slope and place to a change of colour.

Z. Si and W. Yuan, Taxim: an example-based simulation model for GelSight tactile sensors, RA-L 2022. The tables
hold, for bins of the slope's angle and direction, a quadratic polynomial in the pixel's place on an image of
480x640 for each channel's change in grey levels.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from gelform.checks import check_path, check_positive
from gelform.errors import DataError
from gelform.npz_files import DAMAGED_ARCHIVE

HEIGHT, WIDTH = 480, 640
MEMBERS = ("bins", "grad_b", "grad_g", "grad_r")  # the file's "r" is channel 0 of an OpenCV image: blue
MAX_BYTES = 1 << 28
MAX_BINS = 2000
TOUCHED_MM = 0.1
ASPECT_TOLERANCE = 0.02
_DAMAGED = (OSError, *DAMAGED_ARCHIVE, ValueError, AttributeError, TypeError)


@dataclass(frozen=True, eq=False)
class TaximTables:
    """A forward model in Taxim's form.

    Attributes
    ----------
    table : (bins, bins, 3, 6) float64
        By slope angle (0 to 90 degrees) and direction (-180 to 180), for red, green and blue: the factors of
        x^2, y^2, x y, x, y, 1 in pixels of an image of 480x640.
    name : whose
    """

    table: NDArray[np.float64]
    name: str = "Taxim tables"

    def level_change(self, gradients: NDArray[Any], *, as_level: bool = False) -> NDArray[np.float64]:
        """Change in grey levels (H, W, 3) of slopes (H, W, 2) of an image of the whole gel, in the tables' bins.

        `as_level`: as if each slope were 0 in its own direction.
        """
        height, width = gradients.shape[:2]
        last = len(self.table) - 1
        p, q = (
            np.asarray(gradients[..., 0], dtype=np.float64),
            np.asarray(gradients[..., 1], dtype=np.float64),
        )
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
    """Taxim's tables over an untouched image: a look for `gelform.simulate.twin.Twin`.

    The tables were fitted inside contacts, where level gel has another colour than untouched gel; so what they
    say of level gel is faded in over the first 0.1 mm of depth. Untouched gel keeps its background.

    Attributes
    ----------
    tables : TaximTables
    background : (H, W, 3) float32, 4:3 as the tables are, turned as the images that they were made from
    mm_per_px : of this image; the tables hold no scale
    noise : (3,) grey levels
    """

    tables: TaximTables
    background: NDArray[np.float32]
    mm_per_px: float
    noise: NDArray[np.float64]

    def __post_init__(self) -> None:
        check_positive(self.mm_per_px, "mm_per_px")
        shape = np.shape(self.background)
        if (
            len(shape) != 3
            or shape[2] != 3
            or abs(shape[1] / shape[0] * HEIGHT / WIDTH - 1) > ASPECT_TOLERANCE
        ):
            raise ValueError(
                f"Expected a background of shape (H, W, 3) with W/H = 4/3 as the tables', got {shape}. "
                "Turn an upright one by 90 degrees, as Taxim's images of that sensor are: np.rot90(image, -1)."
            )

    @property
    def name(self) -> str:
        """Whose look it is."""
        return self.tables.name

    def levels(self, gradients: NDArray[Any], depth_mm: NDArray[Any]) -> NDArray[np.float32]:
        """Grey levels (H, W, 3), 0-255, of slopes (H, W, 2) and depths (H, W)."""
        level = self.tables.level_change(gradients, as_level=True)
        untouched = 1 - np.clip(depth_mm / TOUCHED_MM, 0, 1)[..., None]
        levels = self.background + self.tables.level_change(gradients) - untouched * level
        return np.asarray(np.clip(levels, 0, 255), dtype=np.float32)


def is_taxim_forward(path: str | PathLike[str]) -> bool:
    """Whether a file is an archive with Taxim's members; what else it is, `load_calibration` says."""
    try:
        with open(path, "rb") as handle, np.load(handle, allow_pickle=False) as file:
            return set(MEMBERS) <= set(file.files)
    except _DAMAGED:  # no archive: an array, or nothing
        return False


def read_taxim_forward(path: str | PathLike[str]) -> TaximTables:
    """Read Taxim's `polycalib.npz`.

    Raises
    ------
    DataError
        No such file, one without its tables, damaged, too large, or of another form.
    """
    path = check_path(path)
    if not path.is_file():
        raise DataError(f"No file {path}: expected Taxim's tables (polycalib.npz).")
    try:
        with ZipFile(path) as archive:
            declared = sum(member.file_size for member in archive.infolist())
        if declared > MAX_BYTES:
            raise DataError(f"{path} declares {declared / 1e6:.3g} MB; Taxim's tables have a few.")
        with open(path, "rb") as handle, np.load(handle, allow_pickle=False) as file:
            missing = [name for name in MEMBERS if name not in file.files]
            if missing:
                raise DataError(f"{path} lacks {', '.join(missing)}: expected Taxim's {', '.join(MEMBERS)}.")
            bins, *channels = (np.asarray(file[name], dtype=np.float64) for name in MEMBERS)
    except _DAMAGED as problem:
        raise DataError(f"{path} is damaged, or no archive (.npz) of numbers: {problem}.") from problem
    count = int(bins) if bins.ndim == 0 and np.isfinite(bins) else 0
    if not 2 <= count <= MAX_BINS or any(one.shape != (count, count, 6) for one in channels):
        shapes = ", ".join(str(one.shape) for one in channels)
        raise DataError(f"{path}: expected three tables of shape (bins, bins, 6), got {shapes}, bins {bins}.")
    table = np.stack(channels, axis=2)
    if not np.all(np.isfinite(table)):
        raise DataError(f"{path}: expected finite tables, got NaN or infinity.")
    return TaximTables(table, path.stem)
