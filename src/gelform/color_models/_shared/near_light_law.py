"""Light from three near lights, relative to that on the untouched gel, and its derivatives.

A light at S shines on a surface point X from the direction (S - X)/|S - X| with a strength that falls as
|S - X|^-falloff, so `E = n . (S - X)/|S - X|^(1 + falloff)` (R. Mecca et al., Near field photometric stereo with
point light sources, SIAM J. Imaging Sciences 7(4), 2014, eq. 3, at constant depth). Positions are in units of half the
image's larger side, about its centre.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

DARKEST_RATIO = 1e-3  # where a channel sees less light than this part of that at rest, it is held there
OFF_DIAGONAL = ~np.eye(3, dtype=bool)


@dataclass(frozen=True)
class Toward:
    """The way from pixels to the lights.

    Attributes
    ----------
    way : (N, 3 lights, 3) S - X
    strength : (N, 3 lights) |S|^falloff / |S - X|^(1 + falloff): 1 over the distance, at the centre
    """

    way: NDArray[np.float64]
    strength: NDArray[np.float64]

    @classmethod
    def of(
        cls, x: NDArray[np.float64], y: NDArray[np.float64], positions: NDArray[np.float64], falloff: float
    ) -> Toward:
        """From pixels (N,) to lights at positions (3, 3)."""
        way = positions - np.stack([x, y, np.zeros_like(x)], axis=-1)[:, None]
        square = np.einsum("nlk,nlk->nl", way, way)
        strength = (np.sum(positions**2, axis=1) / square) ** (falloff / 2) / np.sqrt(square)
        return cls(way, strength)

    @property
    def light(self) -> NDArray[np.float64]:
        """(N, 3 lights, 3): what a normal is multiplied by."""
        return self.strength[..., None] * self.way


def light_ratio(
    normals: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    positions: NDArray[np.float64],
    mixture: NDArray[np.float64],
    falloff: float,
) -> NDArray[np.float64]:
    """Light of each channel over that at rest, (N, 3); a light behind the surface gives nothing.

    Parameters
    ----------
    normals : (N, 3)
    x, y : (N,)
    positions : (3, 3) of the lights
    mixture : (3, 3), row: channel, column: light
    falloff : exponent of the distance
    """
    light = Toward.of(x, y, positions, falloff).light
    lit = np.maximum(np.einsum("nlk,nk->nl", light, normals), 0)
    ratio: NDArray[np.float64] = lit @ mixture.T / (light[..., 2] @ mixture.T)
    return np.maximum(ratio, DARKEST_RATIO)


def light_ratio_derivatives(
    normals: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    positions: NDArray[np.float64],
    mixture: NDArray[np.float64],
    falloff: float,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """`light_ratio` (N, 3), and its derivatives by positions (N, 3, 9) and by the mixture off the diagonal (N, 3, 6)."""
    toward = Toward.of(x, y, positions, falloff)
    light = toward.light
    lit, rest = np.einsum("nlk,nk->nl", light, normals), light[..., 2]
    square = np.einsum("nlk,nlk->nl", toward.way, toward.way)
    growth = falloff * positions / np.sum(positions**2, axis=1)[:, None]
    growth = growth - (1 + falloff) * toward.way / square[..., None]  # of the logarithm of the strength
    strength = toward.strength[..., None]
    by_lit = (strength * normals[:, None] + lit[..., None] * growth) * (lit > 0)[..., None]
    by_rest = strength * np.array([0.0, 0.0, 1.0]) + rest[..., None] * growth
    lit = np.maximum(lit, 0)
    whole = rest @ mixture.T
    ratio = lit @ mixture.T / whole
    seen = (ratio > DARKEST_RATIO)[..., None] / whole[..., None]
    by_position = by_lit[:, None] - ratio[..., None, None] * by_rest[:, None]
    by_position *= (mixture * seen)[..., None]
    by_mixture = np.zeros((len(x), 3, 3, 3))
    by_mixture[:, range(3), range(3)] = (lit[:, None] - ratio[..., None] * rest[:, None]) * seen
    return (
        np.maximum(ratio, DARKEST_RATIO),
        by_position.reshape(-1, 3, 9),
        by_mixture[:, :, OFF_DIAGONAL],
    )
