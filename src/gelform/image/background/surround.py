"""The dark surround of a gel that does not fill the image, and the largest crop inside the gel."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.findings import Finding
from gelform.image.frame import DARK

DARK_PART = 0.15  # of the image's light; the darkest corners of six real sensors have over 0.25 of it
LEAST_SHARE = 0.03  # of the image; a smaller surround costs no press
EDGE_PX = 5  # px; a gel's edge is blurred
SMALLER_CROP = "a smaller crop in the [view] of sensor.toml"
BLOCKS = 48  # along the shorter side, whole blocks of which make up a crop


def surround_of(background: NDArray[Any]) -> NDArray[np.bool_] | None:
    """Pixels (H, W) outside the gel in a background image (H, W, 3): dark, and joined to its border; None without any."""
    strongest = np.asarray(background, dtype=np.float32).max(axis=-1)
    dark = strongest < max(DARK, DARK_PART * float(np.percentile(strongest, 95)))
    _, labels = cv2.connectedComponents(dark.astype(np.uint8))
    at_border = np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]])
    outside = np.isin(labels, np.setdiff1d(at_border, 0))
    return outside if outside.mean() > LEAST_SHARE else None


def surround_finding(background: NDArray[Any], remedy: str, *, viewed: bool = False) -> Finding | None:
    """The finding that a background image (H, W, 3) shows more than the gel; `{}` in the remedy is the crop that fits.

    Of an image that is already a view of the frame (`viewed`), the crop is not one of the frame, and the view is named.
    """
    outside = surround_of(background)
    if outside is None:
        return None
    crop = SMALLER_CROP if viewed else remedy.format(",".join(map(str, crop_inside(outside))))
    message = (
        f"{100 * outside.mean():.0f} % of the image are outside the gel: dark, and joined to its border. Leave them out: "
        f"{crop}. If the camera sees the gel at an angle, undo that too: gelform lens."
    )
    return Finding("dark_surround", message, float(outside.mean()))


def crop_inside(outside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """(left, top, width, height) of the largest rectangle, px, that is free of `outside` (H, W) and of its blurred edge."""
    side = -(-min(outside.shape) // BLOCKS)
    rows, columns = (count // side for count in outside.shape)
    near = cv2.dilate(outside.astype(np.uint8), np.ones((EDGE_PX, EDGE_PX), dtype=np.uint8))
    free = near[: rows * side, : columns * side].reshape(rows, side, columns, side).max(axis=(1, 3)) == 0
    area, best = 0, (0, 0, 0, 0)
    for top in range(rows):
        open_ = np.ones(columns, dtype=bool)
        for bottom in range(top, rows):
            open_ &= free[bottom]
            ends = np.flatnonzero(np.concatenate([[True], ~open_, [True]]))
            widths = np.diff(ends) - 1
            widest = int(widths.argmax())
            height, width = bottom + 1 - top, int(widths[widest])
            if height * width > area:
                area = height * width
                best = (int(ends[widest]) * side, top * side, width * side, height * side)
    return best
