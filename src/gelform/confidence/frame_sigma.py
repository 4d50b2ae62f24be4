"""Standard deviation and confidence of a frame's slopes: every cause counted, pixel by pixel."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gelform.color_models._shared.gamut import Gamut
from gelform.confidence.slope_sigma import SlopeSigma, factor_at, law_at

SATURATED_SIGMA = 1.0
TABLE = 64  # the law, tabulated for the frame's kernel


class PreparedSigma:
    """Standard deviation and confidence of whole frames; immutable, shared by threads."""

    def __init__(self, sigma: SlopeSigma, shape: tuple[int, int], gamut: Gamut | None) -> None:
        self.gamut = gamut
        grid = np.array(sigma.place)
        y, x = ((np.arange(n) + 0.5) / n for n in shape)
        factor = factor_at(grid, *np.broadcast_arrays(x[None, :], y[:, None]))
        self._place = (factor**2).astype(np.float32)
        self._step = np.float32(1.25 * max(sigma.slopes) / (TABLE - 2))
        at = self._step * np.arange(TABLE)
        knots = np.array(sigma.slopes), np.array(sigma.sigmas)
        self._table = (law_at(at, *knots) ** 2).astype(np.float32)
        self._grows = np.float32(knots[1][-1] / knots[0][-1]) ** 2 if knots[0][-1] > 0 else np.float32(0)
        self._rest = np.float32(sigma.rest**2)
        self._clean = np.float32(sigma.clean**2)

    def __call__(
        self,
        gradients: NDArray[np.float32],
        image: NDArray[Any],
        untouched: NDArray[np.bool_],
        color_change: NDArray[np.float32] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Standard deviation (H, W), alike for both components, and confidence (H, W) of a frame's slopes.

        Untouched pixels have the deviation of rest. A pixel with a channel at 0 or 255 is clipped: its slope is
        not known better than `SATURATED_SIGMA`. A colour beyond those of the training presses adds its distance
        to them (`Gamut`).
        """
        sigma = np.empty(gradients.shape[:2], dtype=np.float32)
        confidence = np.empty(gradients.shape[:2], dtype=np.float32)
        beyond = _NOTHING
        if self.gamut is not None and color_change is not None:
            beyond = self.gamut.distance_of(color_change)
        _sigma_and_confidence(
            gradients, image, untouched, beyond, self._place, self._table, self._step, self._grows,
            self._rest, self._clean, sigma, confidence,
        )  # fmt: skip
        return sigma, confidence


class UnknownSigma:
    """Of an imported calibration: no deviation, and confidence 1 but where a pixel is clipped."""

    def __call__(
        self,
        gradients: NDArray[np.float32],
        image: NDArray[Any],
        untouched: NDArray[np.bool_],
        color_change: NDArray[np.float32] | None = None,
    ) -> tuple[None, NDArray[np.float32]]:
        """None, and 0 where a channel is at 0 or 255, else 1."""
        clipped = (image.min(axis=-1) <= 0) | (image.max(axis=-1) >= 255)
        return None, (~clipped).astype(np.float32)


_NOTHING = np.zeros((0, 0), dtype=np.float32)


def with_model_sigma(
    sigma: NDArray[np.float32] | None,
    confidence: NDArray[np.float32],
    model_sigma: NDArray[np.float32] | None,
    clean: float,
) -> tuple[NDArray[np.float32] | None, NDArray[np.float32]]:
    """Standard deviation of both components and confidence, where the color model states a deviation of its own.

    Parameters
    ----------
    sigma : (H, W), the calibration's, alike for both components; None where nobody knows
    confidence : (H, W)
    model_sigma : (H, W, 2), the color model's; None where it states none
    clean : deviation up to which confidence is 1

    Returns
    -------
    gradients_sigma : (H, W, 2), the larger of both; None where there is neither
    confidence : (H, W), the smaller of both
    """
    both = None if sigma is None else np.broadcast_to(sigma[..., None], (*sigma.shape, 2))
    if model_sigma is None:
        return both, confidence
    limit = np.square(np.float32(clean) / model_sigma.max(axis=-1))
    larger = model_sigma if both is None else np.maximum(model_sigma, both)
    return larger, np.minimum(confidence, limit)


@njit(cache=True, fastmath=True, nogil=True)
def _sigma_and_confidence(  # type: ignore[no-untyped-def]
    gradients, image, untouched, beyond, place, table, step, grows, rest, clean, sigma, confidence
):
    height, width, _ = gradients.shape
    clipped = np.float32(SATURATED_SIGMA**2)
    last = table.shape[0] - 2
    for y in range(height):
        for x in range(width):
            p, q = gradients[y, x, 0], gradients[y, x, 1]
            square = p * p + q * q
            at = np.sqrt(square) / step
            index = min(int(at), last)
            between = at - np.float32(index)
            inside = table[index] + between * (table[index + 1] - table[index])
            law = inside if at <= np.float32(last) else grows * square
            variance = rest if untouched[y, x] else law * place[y, x]
            if beyond.shape[0] > 0:
                variance += beyond[y, x] * beyond[y, x]
            darkest = min(image[y, x, 0], image[y, x, 1], image[y, x, 2])
            brightest = max(image[y, x, 0], image[y, x, 1], image[y, x, 2])
            variance = max(variance, clipped if (darkest <= 0) | (brightest >= 255) else variance)
            sigma[y, x] = np.sqrt(variance)
            confidence[y, x] = min(np.float32(1), clean / variance)
