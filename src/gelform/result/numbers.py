"""The numbers of a result, which batches, the page, commands and notebooks read here."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Numbers:
    """Numbers of one result: lengths in mm, or in widths of a pixel without a scale. Depth is that of known pixels."""

    peak: float  # largest depth
    lowest: float
    x_px: int  # place of the largest depth
    y_px: int
    area: float  # of all contacts
    volume: float  # of the gel displaced in them
    contacts: int
    contact_px: int

    @property
    def over_time(self) -> dict[str, float]:
        """The numbers that are plotted over time."""
        return {"peak": self.peak, "area": self.area, "volume": self.volume}


def numbers_of(result: Any) -> Numbers | None:
    """The numbers of a `Reconstruction`; None if depth is known in no pixel."""
    known, depth, found = result.known, result.depth, result.contacts
    if not known.any():
        return None
    y, x = divmod(int(np.where(known, depth, -np.inf).argmax()), depth.shape[1])
    touched = int(np.count_nonzero(result.contact))
    area, volume = float(touched), float(depth[result.contact].sum(dtype=np.float64))
    if result.mm_per_px is not None:
        area = float(sum(one.area_mm2 for one in found))
        volume = float(sum(one.volume_mm3 for one in found))
    return Numbers(float(depth[y, x]), float(depth[known].min()), x, y, area, volume, len(found), touched)
