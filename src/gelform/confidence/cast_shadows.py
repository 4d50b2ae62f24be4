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

from gelform._native import Kernel
from gelform.confidence.forward_cells import CELL
from gelform.confidence.in_front_of_lights import InFrontOfLights

# Of native/confidence/cast_shadows.c: pixels that are looked at together; a shadow's rim is soft, and noise averages out.
COARSER = 4
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

_shadow_darkness = Kernel(
    "shadow_darkness",
    "f32[h,w,3] change, f32[h,w,2] gradients, bool[h,w]? unseen, f32[rows,12,columns] table, f32[2] bias, "
    "out f32[rows,columns,2] slopes, out f32[rows,columns] dark, out f32[n] work",
)
_give_back_light = Kernel(
    "give_back_light",
    "bool[rows,columns] behind, f32[rows,columns] dark, f32[rows,columns,2] slopes, f32[rows,columns,3,2] toward, "
    "f32[rows,columns,3,2] slope_of, f32[rows,columns,3] null, out f32[rows,columns,3] found, f32 noise_square, "
    "f32 share, f32 least_share, f32 doubt",
)
_doubt_shadows = Kernel(
    "doubt_shadows",
    "f32[rows,columns,3] found, out f32[h,w,2] gradients, out f32[h,w] sigma, out f32[h,w] confidence, out f32[n] work, "
    "f32 clean, f32 least",
)


class CastShadows:
    """The shadows of frames of one calibration; immutable, shared by threads.

    Parameters
    ----------
    cells : of the forward response, `coefficients_of_cells`
    shape : (H, W)
    noise : standard deviation of the darkness in contacts of presses, where nothing casts a shadow
    clean : standard deviation of a slope of confidence 1, mm/mm

    Attributes
    ----------
    coarse : (rows, columns) of blocks of 4x4 pixels; those at the right and at the bottom may be smaller
    """

    def __init__(
        self, cells: NDArray[np.float32], shape: tuple[int, int], noise: float, clean: float = 0.0
    ) -> None:
        self.shape, self.noise, self._clean = shape, noise, clean
        self.coarse = -(-shape[0] // COARSER), -(-shape[1] // COARSER)
        rows, columns = (COARSER * np.arange(n) // cell for n, cell in zip(self.coarse, CELL))
        of_terms = cells[rows[:, None], columns[None, :]]
        along = np.moveaxis(of_terms[:, :, :2], 2, 3)  # of each channel by each slope
        size = np.linalg.norm(along, axis=-1, keepdims=True)
        self._toward = np.ascontiguousarray(along / np.maximum(size, 1e-12))
        self._slope_of = np.ascontiguousarray(np.moveaxis(np.linalg.pinv(along, rcond=1e-3), 2, 3))
        null = np.cross(along[..., 0], along[..., 1])
        null /= np.maximum(np.linalg.norm(null, axis=-1, keepdims=True), 1e-12)
        self._null = null * np.where(null.sum(axis=-1, keepdims=True) < 0, -1, 1).astype(np.float32)
        explained = np.einsum("rctk,rck->rct", of_terms, self._null)  # of the darkness, by each term
        table = np.concatenate([explained, self._null], axis=-1)
        self._table = np.ascontiguousarray(np.moveaxis(table, 2, 1))
        # What rises towards a light is turned away from it.
        self._in_front = InFrontOfLights(-self._toward, (COARSER, COARSER))

    def darkness(self, color_change: NDArray[Any], gradients: NDArray[Any]) -> NDArray[np.float32]:
        """How much darker (rows, columns) blocks are than any slope makes them; below 0: brighter."""
        change = np.ascontiguousarray(color_change, dtype=np.float32)
        slopes = np.ascontiguousarray(gradients, dtype=np.float32)
        return self._looked_at(change, slopes, np.zeros(2, np.float32), None)[1]

    def regions(self, darkness: NDArray[np.float32]) -> NDArray[np.bool_]:
        """Blocks (rows, columns) in shadows: connected, dark, and sure somewhere."""
        faint = np.ascontiguousarray(darkness > FAINT * self.noise)
        count, labels = cv2.connectedComponents(faint.view(np.uint8), connectivity=4)
        labels = labels.reshape(faint.shape)
        sure = np.zeros(count, dtype=bool)
        sure[labels[darkness > SURE * self.noise]] = True
        sure[0] = False
        found: NDArray[np.bool_] = sure[labels]
        return found

    def take_back(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        bias: NDArray[np.float32],
        unseen: NDArray[np.bool_] | None,
        sigma: NDArray[np.float32],
        confidence: NDArray[np.float32],
        least: float,
    ) -> bool:
        """Change slopes in shadows to those of the other lights, and doubt them, in place; whether there are any.

        Parameters
        ----------
        color_change : (H, W, 3)
        gradients : (H, W, 2), mm/mm, as the color model reads them, without a bias (2,)
        unseen : (H, W), pixels that show no gel: no shadow is told from them
        sigma : (H, W), mm/mm; in shadows it grows, in squares, by the slope's change and 5.7 clean slopes
        confidence : (H, W); in shadows no more than (clean / sigma)^2, which counts as `least` at least
        """
        found = self._found(color_change, gradients, bias, unseen)
        if found is None:
            return False
        work = np.empty(3 * self.coarse[1], dtype=np.float32)
        _doubt_shadows(found, gradients, sigma, confidence, work, self._clean, least)
        return True

    def sigma(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        unseen: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float32] | None:
        """By how much `take_back` raises the sigma of slopes (H, W), mm/mm, that have their bias; None without shadows."""
        sigma, confidence = np.zeros(self.shape, np.float32), np.zeros(self.shape, np.float32)
        bias, changed = np.zeros(2, np.float32), np.array(gradients)
        return sigma if self.take_back(color_change, changed, bias, unseen, sigma, confidence, 0.0) else None

    def _found(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        bias: NDArray[np.float32],
        unseen: NDArray[np.bool_] | None,
    ) -> NDArray[np.float32] | None:
        """Change of the slopes of each block, and what they are doubted by beside it (rows, columns, 3); None: of none."""
        slopes, dark = self._looked_at(color_change, gradients, bias, unseen)
        behind = self._in_front(slopes, dark > np.float32(BEHIND * self.noise))
        if behind is None:
            return None
        found = np.empty((*self.coarse, 3), dtype=np.float32)
        _give_back_light(
            behind, dark, slopes, self._toward, self._slope_of, self._null, found,
            (HALVED * self.noise) ** 2, GIVEN_BACK, LEAST_SHARE, DOUBTED * self._clean,
        )  # fmt: skip
        return found

    def _looked_at(
        self,
        color_change: NDArray[np.float32],
        gradients: NDArray[np.float32],
        bias: NDArray[np.float32],
        unseen: NDArray[np.bool_] | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Slopes (rows, columns, 2) and darkness (rows, columns) of blocks."""
        slopes, dark = np.empty((*self.coarse, 2), np.float32), np.empty(self.coarse, np.float32)
        work = np.empty(5 * (self.shape[1] + COARSER + self.coarse[1]), dtype=np.float32)
        _shadow_darkness(color_change, gradients, unseen, self._table, bias, slopes, dark, work)
        return slopes, dark
