"""Numbers of a result that are shown against time: deepest point, contact area, volume."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from gelform.checks import check_mm_per_px
from gelform.reconstruction import Reconstruction

OUTLINE_PX = 0.6  # how far an outline may be from the pixels' edge
MAX_OUTLINES = 32


@dataclass(frozen=True)
class Measures:
    """Numbers of one result.

    Attributes
    ----------
    peak : the deepest point, mm (widths of a pixel without a scale)
    x_px, y_px : where it is
    area : of the contact, mm^2
    volume : of gel displaced in the contact, mm^3
    """

    peak: float
    x_px: int
    y_px: int
    area: float
    volume: float


def measures_of(result: Reconstruction) -> Measures:
    """The numbers of a result; in pixels where it has no scale."""
    row, column = np.unravel_index(int(result.depth.argmax()), result.depth.shape)
    pitch_x, pitch_y = (1.0, 1.0) if result.mm_per_px is None else check_mm_per_px(result.mm_per_px)
    pixel = pitch_x * pitch_y
    return Measures(
        float(result.depth[row, column]),
        int(column),
        int(row),
        int(np.count_nonzero(result.contact)) * pixel,
        float(result.depth[result.contact].sum(dtype=np.float64)) * pixel,
    )


def outlines_of(result: Reconstruction) -> list[list[int]]:
    """Outlines of the contact, each as x, y, x, y ... in px of the image; the largest ones where there are many."""
    found, _ = cv2.findContours(result.contact.view(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    largest = sorted(found, key=len, reverse=True)[:MAX_OUTLINES]
    simple: list[Any] = [cv2.approxPolyDP(outline, OUTLINE_PX, True) for outline in largest]
    return [outline.ravel().tolist() for outline in simple]
