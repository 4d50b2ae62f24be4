"""Cast shadows: where something stands in one light, and the slope that the other lights show there.

Three channels and two slopes leave one number at each pixel that no slope changes: the sum of the channels, each by how
little a slope changes it. A pixel in the shadow of one light is darker by it, and its slope is read as facing away from that
light, which it is not. Where something stands in a light and the pixel is darker, the light that the surface faces away
from most is taken to be hidden; given back what it lost, the slope is that of the other two (C. Hernandez, G. Vogiatzis and
R. Cipolla, Overcoming shadows in 3-source photometric stereo, IEEE Trans. PAMI 33(2), 2011). What it lost is known badly, so
the slope is doubted, and the pixels around carry the shape.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import monomial_products, monomials
from gelform.confidence.forward_cells import CELL
from gelform.confidence.in_front_of_lights import InFrontOfLights

COARSER = 4  # pixels that are looked at together: a shadow's rim is soft, and noise averages out
# Times the darkness that slopes in contacts leave unexplained: from which a shadow is sure, and as far as it goes; and from
# which it is one where something stands in the light.
SURE, FAINT = 1.5, 0.5
BEHIND = 0.2
# Times the deviation of a clean slope, of slopes in shadows: a weight of 0.03 (simulated DIGITs ask for 0.01 to 0.06).
DOUBTED = 5.7
HALVED = 0.5  # times it: of so faint a shadow half is taken back
# Of the darkness: the rest is light from all sides, which a shadow loses too (slopes on simulated DIGITs ask for 0.4-0.6).
GIVEN_BACK = 0.5
LEAST_SHARE = 0.2  # of a channel in the darkness: what a light lost is not told from less


class CastShadows:
    """The shadows of frames of one calibration; immutable, shared by threads.

    Parameters
    ----------
    cells : of the forward response, `coefficients_of_cells`
    shape : (H, W)
    noise : standard deviation of the darkness in contacts of presses, where nothing casts a shadow
    clean : standard deviation of a slope of confidence 1, mm/mm
    """

    def __init__(
        self, cells: NDArray[np.float32], shape: tuple[int, int], noise: float, clean: float = 0.0
    ) -> None:
        self.shape, self.noise, self._doubt = shape, noise, np.float32(DOUBTED * clean)
        self.coarse = max(1, shape[0] // COARSER), max(1, shape[1] // COARSER)
        rows, columns = (
            ((np.arange(n) + 0.5) * (full / n)).astype(int) // cell
            for n, full, cell in zip(self.coarse, shape, CELL)
        )
        of_terms = cells[rows[:, None], columns[None, :]]
        along = np.moveaxis(of_terms[:, :, :2], 2, 3)  # of each channel by each slope
        self._toward = along / np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
        self._slope_of = np.moveaxis(np.linalg.pinv(along, rcond=1e-3), 2, 3)
        null = np.cross(along[..., 0], along[..., 1])
        null /= np.maximum(np.linalg.norm(null, axis=-1, keepdims=True), 1e-12)
        self._null = null * np.where(null.sum(axis=-1, keepdims=True) < 0, -1, 1).astype(np.float32)
        self._dark_of = np.einsum("rctk,rck->rct", of_terms, self._null)  # of what each term explains
        # What rises towards a light is turned away from it.
        self._in_front = InFrontOfLights(-self._toward, shape)

    def darkness(self, color_change: NDArray[Any], gradients: NDArray[Any]) -> NDArray[np.float32]:
        """How much darker (rows, columns) the coarse pixels are than any slope makes them; below 0: brighter."""
        return self._darkness(self._small(color_change), self._small(gradients))

    def regions(self, darkness: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Coarse pixels (rows, columns) in shadows: connected, dark, and sure somewhere."""
        faint = np.ascontiguousarray(darkness > FAINT * self.noise)
        count, labels = cv2.connectedComponents(faint.view(np.uint8), connectivity=4)
        labels = labels.reshape(faint.shape)
        sure = np.zeros(count, dtype=bool)
        sure[labels[darkness > SURE * self.noise]] = True
        sure[0] = False
        found: NDArray[np.bool_] = sure[labels]
        return found

    def __call__(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        bias: NDArray[np.float32] | float = 0.0,
        unseen: NDArray[np.bool_] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]] | None:
        """What slopes in shadows change by, so that they are those of the other lights, and their standard deviation then.

        None where there is no shadow; else (H, W, 2) and (H, W), mm/mm, both 0 outside of shadows.

        Parameters
        ----------
        color_change : (H, W, 3)
        gradients : (H, W, 2), as the color model reads them, without a bias (2,)
        unseen : (H, W), pixels that show no gel: no shadow is told from them
        """
        slopes = self._small(gradients)
        slopes += bias
        darkness = self._darkness(self._small(color_change), slopes)
        if unseen is not None:
            darkness[self._small(unseen)[..., 0] > 0] = 0
        region = darkness > BEHIND * self.noise
        region &= self._in_front(slopes)
        if not region.any():
            return None
        found = np.zeros((*self.coarse, 3), dtype=np.float32)
        found[region, :2] = self._given_back(region, darkness[region], slopes[region])
        found[region, 2] = self._doubt
        height, width = self.shape
        whole = np.asarray(cv2.resize(found, (width, height), interpolation=cv2.INTER_LINEAR))
        shift = np.ascontiguousarray(whole[..., :2])
        return shift, np.hypot(size_of(shift), whole[..., 2])

    def _given_back(
        self, region: NDArray[np.bool_], darkness: NDArray[np.float32], slopes: NDArray[np.float32]
    ) -> NDArray[np.float32]:
        """The change (N, 2) of the slopes (N, 2) in a region; never so much that the surface faces the hidden light."""
        facing = np.einsum("nck,nk->nc", self._toward[region], slopes)
        hidden = np.argmin(facing, axis=1)
        which = np.arange(len(hidden)), hidden
        square = np.square(darkness)
        lost = darkness * square / (square + np.float32(HALVED * self.noise) ** 2)
        lost = lost / np.maximum(self._null[region][which], LEAST_SHARE)
        change = GIVEN_BACK * self._slope_of[region][which] * lost[:, None]
        along = np.einsum("nk,nk->n", change, self._toward[region][which])
        size = np.linalg.norm(change, axis=1)
        most = np.minimum(
            np.maximum(-facing[which], 0) / np.maximum(along, 1e-12),
            np.linalg.norm(slopes, axis=1) / np.maximum(size, 1e-12),
        )
        return np.asarray(change * np.minimum(most, 1)[:, None], dtype=np.float32)

    def _small(self, values: NDArray[Any]) -> NDArray[np.float32]:
        rows, columns = self.coarse
        small = cv2.resize(
            np.asarray(values, dtype=np.float32), (columns, rows), interpolation=cv2.INTER_AREA
        )
        return np.asarray(small).reshape(rows, columns, -1)

    def _darkness(self, change: NDArray[np.float32], slopes: NDArray[np.float32]) -> NDArray[np.float32]:
        terms = np.stack(monomial_products(np.moveaxis(slopes, -1, 0), monomials(2, 3)), axis=-1)
        seen = np.einsum("rck,rck->rc", self._null, change)
        return np.asarray(np.einsum("rct,rct->rc", terms, self._dark_of) - seen, dtype=np.float32)


def size_of(shift: NDArray[np.float32]) -> NDArray[np.float32]:
    """How much slopes changed (H, W), of the change (H, W, 2) of both."""
    size: NDArray[np.float32] = np.sqrt(np.einsum("...k,...k->...", shift, shift))
    return size
