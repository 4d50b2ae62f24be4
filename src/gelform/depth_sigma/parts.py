"""How slope errors split into white and correlated ones: otherwise where the gel is untouched than in a contact."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.checks import as_array
from gelform.depth_sigma.closed_form import white_as_blurred

LEAST = 1e-6


@dataclass(frozen=True)
class ErrorParts:
    """Parts of the variance of slope errors.

    In a contact a share of it is correlated over a long distance (a color model's bias) and the rest is white. At rest
    no color model errs: what is left is the images' noise, blurred as the color change is. Over a block of pixels such
    short correlations are as good as independent errors of more variance.

    Attributes
    ----------
    block : pixels across a block
    share : correlated share in a contact, 0-1
    rest_share : share at rest that is correlated as in a contact, 0-1
    rest_px : distance over which the other part falls to exp(-1/2) at rest; 0: it is white
    aspect : pitch along x over that along y
    """

    block: int
    share: float
    rest_share: float
    rest_px: float
    aspect: float = 1.0

    def of_blocks(
        self, rest: NDArray[np.bool_] | None, shape: tuple[int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Factors of the standard deviation of white and of correlated errors of blocks (h, w, 1).

        Parameters
        ----------
        rest : (H, W), untouched pixels; None: there are none
        shape : (h, w), of blocks, that cover at least the pixels
        """
        at_rest = np.zeros(shape, dtype=np.float32) if rest is None else self._share_of_blocks(rest, shape)
        power = np.float32(white_as_blurred(self.aspect, self.block, self.rest_px)[0])
        white = (1 - at_rest) * (1 - self.share) + at_rest * (1 - self.rest_share) * power
        common = (1 - at_rest) * self.share + at_rest * self.rest_share
        return np.sqrt(white)[..., None], np.sqrt(common)[..., None]

    def within_blocks(
        self, sigma: NDArray[np.float32], rest: NDArray[np.bool_] | None
    ) -> NDArray[np.float32]:
        """Standard deviation (H, W, 1 or 2) of white errors that move depth as far within a block as these do."""
        contact = np.float32(max(np.sqrt(1 - self.share), LEAST))
        if rest is None:
            return sigma * contact
        within = white_as_blurred(self.aspect, self.block, self.rest_px)[1]
        still = np.sqrt((1 - self.rest_share) * within)
        return sigma * np.where(rest, np.float32(max(still, LEAST)), contact)[..., None]

    def _share_of_blocks(self, rest: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.float32]:
        below, right = (blocks * self.block - pixels for blocks, pixels in zip(shape, rest.shape))
        pixels = rest.view(np.uint8)
        whole = cv2.copyMakeBorder(pixels * np.uint8(255), 0, below, 0, right, cv2.BORDER_REPLICATE)
        means = cv2.resize(whole, shape[::-1], interpolation=cv2.INTER_AREA).reshape(shape)
        return np.asarray(means * np.float32(1 / 255), dtype=np.float32)


def checked_rest(rest: ArrayLike | None, shape: tuple[int, int]) -> NDArray[np.bool_] | None:
    """Return pixels (H, W) where nothing touches, which may be none, as bool."""
    if rest is None:
        return None
    array = as_array(rest, "rest")
    if array.dtype != np.bool_ or array.shape != shape:
        raise ValueError(f"Expected rest as bool of shape {shape}, got {array.dtype} of {array.shape}.")
    return np.ascontiguousarray(array)
