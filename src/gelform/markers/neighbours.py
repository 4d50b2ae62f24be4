"""What a dot's neighbours say about it: the gel's surface moves smoothly, so a dot moves nearly as they do."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

NEIGHBOURS = 8
REACH = 1.7  # of the spacing: as far as neighbours count
MOST_ASTRAY = 0.45  # of the spacing: further from its neighbours' motion, a dot is another one


class Neighbours:
    """The neighbours of dots at rest.

    Parameters
    ----------
    rest_px : (N, 2)

    Attributes
    ----------
    spacing_px : median distance to the nearest dot
    """

    def __init__(self, rest_px: NDArray[Any]) -> None:
        self._rest = np.asarray(rest_px, dtype=np.float64)
        count = len(self._rest)
        found = scipy.spatial.cKDTree(self._rest).query(self._rest, k=min(NEIGHBOURS + 1, count))
        distance, self._index = np.asarray(found[0])[:, 1:], np.asarray(found[1])[:, 1:]
        self.spacing_px = float(np.median(distance[:, 0]))
        self._near = distance < REACH * np.maximum(self.spacing_px, distance[:, :1])

    def astray_px(self, shift_px: NDArray[Any], sure: NDArray[np.bool_]) -> NDArray[np.float64]:
        """How far (N,) each dot's shift is from the median of its sure neighbours; 0 where it has none."""
        theirs = np.where((self._near & sure[self._index])[..., None], shift_px[self._index], np.inf)
        theirs.sort(axis=1)
        count = np.count_nonzero(np.isfinite(theirs[..., 0]), axis=1)
        lower, upper = (np.maximum(count - 1, 0) // 2, count // 2)
        number = np.arange(len(theirs))
        upper = np.minimum(upper, theirs.shape[1] - 1)
        middle = (theirs[number, lower] + theirs[number, upper]) / 2
        middle = np.where((count > 0)[:, None], middle, shift_px)
        away = shift_px - middle
        astray: NDArray[np.float64] = np.hypot(away[:, 0], away[:, 1])
        return astray

    def predicted_px(
        self, shift_px: NDArray[Any], sure: NDArray[np.bool_], of: NDArray[np.bool_]
    ) -> NDArray[np.float64]:
        """Shifts (M, 2) of some dots (`of`, (N,) bool) from those of the sure ones around.

        A plane through the shifts around, the near ones counting most; held towards their mean where they do not
        tell a plane.
        """
        away = self._rest[sure] - self._rest[of][:, None]
        square = np.sum(away**2, axis=-1) / self.spacing_px**2
        weight = np.exp(-0.5 * (square - square.min(axis=1, keepdims=True)))
        weight /= weight.sum(axis=1, keepdims=True)
        mean, place = weight @ shift_px[sure], np.einsum("mk,mkc->mc", weight, away)
        offset = away - place[:, None]
        spread = np.einsum("mk,mkc,mkd->mcd", weight, offset, offset)
        spread += 0.3 * self.spacing_px**2 * np.eye(2)
        lean = np.einsum("mk,mkc,mkd->mcd", weight, offset, shift_px[sure] - mean[:, None])
        slope = np.linalg.solve(spread, lean)
        predicted: NDArray[np.float64] = mean - np.einsum("mc,mcd->md", place, slope)
        return predicted
