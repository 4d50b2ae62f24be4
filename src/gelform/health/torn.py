"""Torn: a part of the frame did not arrive: it holds one colour, rows of another part, or is displaced sideways."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.background.check import Finding
from gelform.health.blocks import BLOCK_PX, Blocks

FLAT_RANGE = 2  # grey levels within a block; a camera's noise alone gives more
ALIKE, UNLIKE = 4, 10  # grey levels: flat blocks among each other; a flat block and the rest image
MIN_SHARE = 0.03
JUMP, JUMP_FACTOR = 5.0, 3.0  # grey levels; of the rows' median: a seam against its neighbours
APART_ROWS = 3  # video that halves the colour's rows makes neighbours equal


class Torn:
    """Finds parts of frames that are no picture; prepared once for an untouched image.

    Parameters
    ----------
    background : (H, W, 3), 0-255, the untouched image
    rest : its blocks
    """

    def __init__(self, background: NDArray[Any], rest: Blocks) -> None:
        self._background = background
        self._rest = rest.means.astype(np.int16)
        _, place, count = np.unique(rest.row_digests, return_inverse=True, return_counts=True)
        self._own_rows = count.ravel()[place.ravel()] == 1  # rows that the rest image has only once

    def __call__(self, blocks: Blocks, image: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Pixels (H, W) that did not arrive; None where all did."""
        flat, repeated = self.flat(blocks), self.repeated_rows(blocks, image)
        displaced = self.displaced_rows(blocks) if flat is None and repeated is None else None
        if flat is None and repeated is None and displaced is None:
            return None
        width = image.shape[1]
        torn = np.zeros(image.shape[:2], dtype=bool) if flat is None else blocks.pixels(flat, width)
        for rows in (repeated, displaced):
            if rows is not None:
                torn[rows] = True
        return torn

    def flat(self, blocks: Blocks) -> NDArray[np.bool_] | None:
        """Blocks (h, w) of one and the same colour that is not the rest image's; None where they are few."""
        flat = blocks.ranges <= FLAT_RANGE
        least = MIN_SHARE * flat.size
        if np.count_nonzero(flat) <= least:
            return None
        means = blocks.means.astype(np.int16)
        flat &= np.abs(means - self._rest).max(axis=-1) > UNLIKE
        if np.count_nonzero(flat) <= least:
            return None
        common = np.median(means[flat], axis=0)
        flat &= np.abs(means - common).max(axis=-1) <= ALIKE
        return flat if np.count_nonzero(flat) > least else None

    def repeated_rows(self, blocks: Blocks, image: NDArray[Any]) -> NDArray[np.bool_] | None:
        """Rows (H,) that repeat another row of the frame; None where they are few.

        Of rows that are alike, the one that fits the rest image best counts as the true one.
        """
        order = np.sort(blocks.row_digests)
        least = MIN_SHARE * len(order)
        if np.count_nonzero(order[1:] == order[:-1]) <= least:
            return None
        repeated = np.zeros(len(order), dtype=bool)
        for digest in np.unique(order[1:][order[1:] == order[:-1]]):
            rows = np.flatnonzero((blocks.row_digests == digest) & self._own_rows)
            if len(rows) > 1 and rows[-1] - rows[0] >= APART_ROWS:
                away = np.abs(image[rows].astype(np.float32) - self._background[rows]).mean(axis=(1, 2))
                repeated[np.delete(rows, int(np.argmin(away)))] = True
        return repeated if np.count_nonzero(repeated) > least else None

    def displaced_rows(self, blocks: Blocks) -> NDArray[np.bool_] | None:
        """Rows (H,) on the far side of a seam across the whole frame; None where there is no seam.

        The difference to the rest image jumps there from one row to the next. Edges of objects are blurred over more
        rows than that. Of the two sides, the one that fits the rest image worse counts as displaced; of several seams,
        what lies between them.
        """
        seams = self._seams(blocks.row_jumps)
        if not len(seams):
            return None
        rows = np.arange(len(blocks.row_jumps))
        far = (rows >= seams[0]) & (rows < (seams[-1] if len(seams) > 1 else len(rows)))
        away = np.abs(blocks.means.astype(np.int16) - self._rest).mean(axis=(1, 2))
        blocks_far = far[BLOCK_PX // 2 :: BLOCK_PX][: len(away)]
        if len(seams) > 1:
            return far
        if blocks_far.all() or not blocks_far.any():  # a seam within half a block of the border
            return far if far.mean() < 0.5 else ~far
        return far if away[blocks_far].mean() > away[~blocks_far].mean() else ~far

    def _seams(self, jumps: NDArray[np.float32]) -> NDArray[np.intp]:
        """Rows that jump by far more than a row beside them and the middle one: a contact may begin right at a seam."""
        if jumps.max() <= JUMP:
            return np.zeros(0, dtype=np.intp)
        least = max(JUMP_FACTOR * float(np.median(jumps)), JUMP)
        beside = np.stack([np.append(jumps[1:], 0), np.append(0, jumps[:-1])])
        alone = (jumps > beside.min(axis=0) + JUMP) & (jumps > beside.max(axis=0) + JUMP / 2)
        return np.flatnonzero((jumps > least) & alone)


def torn_finding(lost: NDArray[np.bool_]) -> Finding:
    """The finding; its figure is the share of the frame."""
    share = float(lost.mean())
    message = (
        f"{100 * share:.0f} % of the frame is torn: it holds one colour, rows of another part, or is displaced. "
        "Check the cable, and whether the camera's bandwidth is shared."
    )
    return Finding("torn", message, share)
