"""Tables of other packages: look-up tables from color difference to gradients, and Taxim's forward model.

The look-up tables (`table_smooth.npy`) are in the tradition of Dong and Yuan. Taxim's tables (`polycalib.npz`) bin slopes by
angle and direction. Each bin has a quadratic polynomial of the pixel's place for each channel's change in gray levels
(Z. Si and W. Yuan, Taxim: an example-based simulation model for GelSight tactile sensors, RA-L 2022).
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError, said
from gelform.foundations.checks import check_path, check_positive
from gelform.foundations.npz_files import DAMAGED_ARCHIVE, checked_archive, read_npy
from gelform.foundations.whole_files import MAX_ARRAY_BYTES
from gelform.slopes.color_models.lookup import LookupModel

RANGE_LEVELS = 180.0  # gray levels: a look-up table spans differences of -90 to 90 per channel
HEIGHT, WIDTH = 480, 640  # px, size of the images whose pixels Taxim's polynomials use
MEMBERS = ("bins", "grad_b", "grad_g", "grad_r")  # "r" is channel 0 of an OpenCV image, which is blue
_DAMAGED = (OSError, *DAMAGED_ARCHIVE, ValueError, AttributeError, TypeError)


def read_lut(
    path: str | PathLike[str], background: NDArray[np.float32], *, depth_sign: int = 1
) -> LookupModel:
    """A table (bins, bins, bins, 2) of gradients (gx, gy), indexed by the blue, green and red difference.

    The images are blurred by 3x3 px; their difference is multiplied by 1 + 2 (mean(I0)/I0 - 1). Values hold at the
    bins' centers, with linear interpolation between them. The table's gradient for no difference is subtracted. The
    file does not state its accuracy, so no standard deviation is given.

    Parameters
    ----------
    depth_sign : 1 if the table's surface rises where pressed, -1 if it falls

    Raises
    ------
    DataError
        The file is missing, no such table, or damaged.
    """
    if depth_sign not in (1, -1):
        raise ValueError(f"Expected depth_sign 1 or -1, got {depth_sign}.")
    slopes = depth_sign * _lut(path).transpose(2, 1, 0, 3)  # to red, green, blue
    unknown = np.zeros((*slopes.shape[:3], 1))
    bins = slopes.shape[0]
    step = np.full(3, RANGE_LEVELS / bins)
    table = np.concatenate([slopes, unknown], axis=-1)[None, None].astype(np.float32)
    height, width = background.shape[:2]
    low = step / 2 - RANGE_LEVELS / 2
    return LookupModel(table, low, step, (height, width), "mean_over_background", background)


def _lut(path: str | PathLike[str]) -> NDArray[np.float64]:
    array = read_npy(path, "a look-up table")
    shape = array.shape
    if len(shape) != 4 or shape[3] != 2 or len(set(shape[:3])) != 1 or not 4 <= shape[0] <= 200:
        raise DataError(f"Expected a table of shape (bins, bins, bins, 2) in {path}, got {shape}.")
    if not np.issubdtype(array.dtype, np.floating) or not np.isfinite(array).all():
        raise DataError(f"Expected finite floats in {path}, got {array.dtype} or NaN.")
    return np.asarray(array, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class TaximTables:
    """A forward model in Taxim's form.

    Attributes
    ----------
    table : (bins, bins, 3, 6) float64
        By slope angle (0 to 90 degrees) and direction (-180 to 180), for red, green and blue: the factors of
        x^2, y^2, x y, x, y, 1 in pixels of an image of 480x640.
    name : name of the tables
    """

    table: NDArray[np.float64]
    name: str = "Taxim tables"

    def level_change(self, gradients: NDArray[Any], *, as_level: bool = False) -> NDArray[np.float64]:
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
    tables : TaximTables
    background : (H, W, 3) float32, 4:3 as the tables, oriented as the images of their calibration
    mm_per_px : of this image; the tables contain no scale
    noise : (3,) gray levels
    """

    tables: TaximTables
    background: NDArray[np.float32]
    mm_per_px: float
    noise: NDArray[np.float64]

    def __post_init__(self) -> None:
        check_positive(self.mm_per_px, "mm_per_px")
        shape = np.shape(self.background)
        if len(shape) != 3 or shape[2] != 3 or not _is_of_tables_aspect(*shape[:2]):
            raise ValueError(
                f"Expected a background of shape (H, W, 3) with W/H = 4/3 as the tables', got {shape}. "
                "Turn an upright one by 90 degrees, as Taxim's images of that sensor are: np.rot90(image, -1)."
            )

    @property
    def name(self) -> str:
        """The name of the tables."""
        return self.tables.name

    def levels(self, gradients: NDArray[Any], depth_mm: NDArray[Any]) -> NDArray[np.float32]:
        """Gray levels (H, W, 3), 0-255, of slopes (H, W, 2) and depths (H, W)."""
        level = self.tables.level_change(gradients, as_level=True)
        untouched = 1 - np.clip(depth_mm / 0.1, 0, 1)[..., None]
        levels = self.background + self.tables.level_change(gradients) - untouched * level
        return np.asarray(np.clip(levels, 0, 255), dtype=np.float32)


def _is_of_tables_aspect(height: int, width: int) -> bool:
    return abs(width / height * HEIGHT / WIDTH - 1) <= 0.02


def is_taxim_forward(path: str | PathLike[str]) -> bool:
    """Whether a file is an archive with Taxim's members; `load_calibration` reports other kinds."""
    try:
        return {f"{name}.npy" for name in MEMBERS} <= set(checked_archive(path, "Taxim's tables"))
    except (DataError, *_DAMAGED):  # no archive: an array, or another file
        return False


def read_taxim_forward(path: str | PathLike[str]) -> TaximTables:
    """Read Taxim's `polycalib.npz`.

    Raises
    ------
    DataError
        The file is missing, lacks these tables, is damaged, too large, or of another form.
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
