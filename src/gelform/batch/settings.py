"""What is asked of a batch: everything that decides the bytes of its outputs, beside the input and the calibration."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from gelform.solvers import SOLVERS

KEPT = ("depth", "known", "depth_sigma", "gradients", "confidence", "contact")
FORMATS = ("npz", "png")
MOST_BACKGROUND_FRAMES = 200


@dataclass(frozen=True)
class BatchSettings:
    """Settings of a batch; those of a resumed one have to be the same.

    Attributes
    ----------
    form : "npz", or "png": 16-bit PNG of the depth, (v - 32768) x 1e-4 mm, 0 where unknown
    keep : maps of an npz file, among KEPT; ("all",): the whole result, which `gelform.load_result` reads
    solver : as of a `Reconstructor`
    depth_sigma : whether depth's standard deviation is worked out, which also decides where contact is; without it a
        frame takes a quarter less time
    background_frames : how many frames at the start of each sequence are averaged to its background; 0: none
    part_frames : images that are one piece of work; a video or a recording is one piece

    Raises
    ------
    ValueError
        A setting that cannot be; the message says what was expected.
    """

    form: str = "npz"
    keep: tuple[str, ...] = ("depth", "known")
    solver: str = "auto"
    depth_sigma: bool = True
    background_frames: int = 0
    part_frames: int = 256

    def __post_init__(self) -> None:
        if self.form not in FORMATS:
            raise ValueError(f"Expected a format among {', '.join(FORMATS)}, got {self.form!r}.")
        unknown = [name for name in self.keep if name not in KEPT]
        if not self.keep or (unknown and self.keep != ("all",)):
            raise ValueError(f"Expected maps to keep among {', '.join(KEPT)}, or all, got {self.keep}.")
        if self.form == "png" and set(self.keep) - {"depth", "known"}:
            raise ValueError(f"Expected depth alone in 16-bit PNG, got {', '.join(self.keep)}. Write npz.")
        if "depth_sigma" in self.keep and not self.depth_sigma:
            raise ValueError("Expected depth_sigma to be worked out where it is kept. Leave out --no-sigma.")
        if self.solver not in ("auto", *SOLVERS):
            raise ValueError(f"Expected a solver among auto, {', '.join(SOLVERS)}, got {self.solver!r}.")
        if not 0 <= self.background_frames <= MOST_BACKGROUND_FRAMES:
            raise ValueError(
                f"Expected 0 to {MOST_BACKGROUND_FRAMES} frames for a background, got {self.background_frames}."
            )
        if self.part_frames < 1:
            raise ValueError(f"Expected at least one frame in a part, got {self.part_frames}.")

    def facts(self) -> dict[str, Any]:
        """The settings as JSON has them."""
        return {**asdict(self), "keep": list(self.keep)}
