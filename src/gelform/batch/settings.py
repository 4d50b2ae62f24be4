"""The settings of a batch: with the input and the calibration, they determine the bytes of its outputs."""

from __future__ import annotations

import sys
from dataclasses import asdict, dataclass
from typing import Any

from gelform.depth.integrate import checked_solver
from gelform.foundations.checks import check_choice
from gelform.result.maps import KEPT_MAPS

KEPT = tuple(KEPT_MAPS)
FORMATS = ("npz", "png", "zarr", "hdf5", "lerobot")
DTYPES = ("float32", "uint16")
LEVELS_ALONE = ("png", "lerobot")  # forms with 16-bit depth only
WHOLE_SEQUENCES = ("lerobot",)  # forms with one file per sequence, which is one part
MOST_BACKGROUND_FRAMES = 200  # frames that are in memory together


@dataclass(frozen=True)
class BatchSettings:
    """Settings of a batch; a continued run must have the same.

    Attributes
    ----------
    form : "npz" and "png", a file per frame; "zarr" and "hdf5", whose chunks are frames; "lerobot", a
        LeRobot data set with an additional column of depth
    keep : maps among KEPT; ("all",), only for npz: the whole result, which `gelform.load_result` reads
    dtype : of the kept maps; "uint16" is depth only, (v - 32768) x 1e-4 mm, 0 where unknown: always so in png, never in
        npz; in lerobot 1000 + depth in um
    solver : as of a `Reconstructor`
    background_frames : number of frames at the start of each sequence that are averaged as its background; 0: none
    bgr : whether the input's channels are in the order blue, green, red, as OpenCV writes an array
    part_frames : images in one part; a video or a recording is one part

    Raises
    ------
    ValueError
        A setting is invalid; the message says what was expected.
    """

    form: str = "npz"
    keep: tuple[str, ...] = ("depth", "known")
    solver: str = "auto"
    background_frames: int = 0
    part_frames: int = 256
    dtype: str = ""
    bgr: bool = False

    def __post_init__(self) -> None:
        check_choice(self.form, FORMATS, "a format")
        self._check_keep()
        self._check_dtype()
        checked_solver(self.solver)
        if not 0 <= self.background_frames <= MOST_BACKGROUND_FRAMES:
            raise ValueError(
                f"Expected 0 to {MOST_BACKGROUND_FRAMES} frames for a background, got {self.background_frames}."
            )
        if self.part_frames < 1:
            raise ValueError(f"Expected at least one frame in a part, got {self.part_frames}.")

    def _check_keep(self) -> None:
        unknown = [name for name in self.keep if name not in KEPT]
        if not self.keep or (unknown and self.keep != ("all",)):
            raise ValueError(f"Expected maps to keep among {', '.join(KEPT)}, or all, got {self.keep}.")
        if self.keep == ("all",) and self.form != "npz":
            raise ValueError(
                f"Expected maps by name in {self.form}, got all. Whole results are written as npz."
            )

    def _check_dtype(self) -> None:
        usual = "uint16" if self.form in LEVELS_ALONE else "float32"
        object.__setattr__(self, "dtype", self.dtype or usual)
        check_choice(self.dtype, DTYPES, "a dtype")
        if self.dtype != usual and self.form in (*LEVELS_ALONE, "npz"):
            raise ValueError(f"Expected {usual} in {self.form}, got {self.dtype}. Zarr and HDF5 hold either.")
        if self.dtype == "uint16" and set(self.keep) - {"depth", "known"}:
            raise ValueError(
                f"Expected depth alone in 16 bits, got {', '.join(self.keep)}. Write float32 as npz, zarr or hdf5."
            )

    @property
    def frames_in_a_part(self) -> int:
        """The largest number of images in a part; all of a sequence if that is one file."""
        return sys.maxsize if self.form in WHOLE_SEQUENCES else self.part_frames

    def facts(self) -> dict[str, Any]:
        """The settings for JSON."""
        return {**asdict(self), "keep": list(self.keep)}
