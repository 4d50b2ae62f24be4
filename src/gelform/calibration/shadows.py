"""Whether presses of a sensor cast shadows, and what darkness means none: from the presses that calibrate it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.samples import PreparedPress
from gelform.color_models import ColorModel
from gelform.color_models._shared.forward import ForwardResponse
from gelform.confidence.cast_shadows import COARSER, CastShadows
from gelform.confidence.forward_cells import coefficients_of_cells

INNER = 0.7  # of the contact radius: a ball casts no shadow on itself there
AROUND = 1.0, 2.0  # contact radii, where its shadows fall
LEAST_NOISE = 0.03  # of color change: a fainter shadow is not worth looking for
MOST, SIGMAS_OF_MOST = 95.0, 2.0
CASTS_FROM = 0.05  # of the ring around a contact in shadow, median over presses; sensors without: up to 0.02
# Of fewer presses color model and forward response know too little beside the contacts: what they leave is no shadow. Of 12,
# simulated and real sensors without shadows were above that share.
LEAST_PRESSES, MOST_PRESSES = 18, 40
# Of the ring, in three of four presses: where one press casts a shadow, others do; what a model lacks at places is not.
IN_MOST, QUARTILE = 0.02, 25


def shadow_noise(
    model: ColorModel,
    forward: ForwardResponse,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: NDArray[np.float32],
) -> float | None:
    """Standard deviation of the darkness that slopes in contacts leave unexplained; None where presses cast no shadows.

    None for fewer than 18 presses, too: they do not tell.

    Parameters
    ----------
    model, forward : fitted on the presses
    presses, contacts : prepared, and their circles
    background : (H, W, 3), the untouched image
    """
    if len(presses) < LEAST_PRESSES:
        return None
    step = max(1, -(-len(presses) // MOST_PRESSES))
    shape = presses[0].size.shape
    dark, away = _around_contacts(model, forward, presses[::step], contacts[::step], background)
    inner = np.abs(dark[away < INNER])
    noise = max(float(np.percentile(inner, MOST)) / SIGMAS_OF_MOST, LEAST_NOISE)
    cast = CastShadows(coefficients_of_cells(forward), shape, noise)
    shares = [
        float(np.mean(cast.regions(one)[ring]))
        for one, ring in zip(dark, (away >= AROUND[0]) & (away < AROUND[1]))
        if ring.any()
    ]
    return noise if _are_shadows(shares) else None


def _are_shadows(shares: Sequence[float]) -> bool:
    """Of the shares in shadow of the rings around contacts."""
    if not shares:
        return False
    return bool(np.median(shares) >= CASTS_FROM and np.percentile(shares, QUARTILE) >= IN_MOST)


def _around_contacts(
    model: ColorModel,
    forward: ForwardResponse,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Darkness (N, rows, columns) of presses, and how far each coarse pixel is from its contact's centre, in radii."""
    shape = presses[0].size.shape
    prepared = model.prepare(background, shape)
    cast = CastShadows(coefficients_of_cells(forward), shape, LEAST_NOISE)
    rows, columns = (COARSER * np.arange(n, dtype=np.float32) + (COARSER - 1) / 2 for n in cast.coarse)
    dark, away = [], []
    for press, contact in zip(presses, contacts):
        change = np.ascontiguousarray(press.color_change)
        dark.append(cast.darkness(change, prepared.gradients_from_color(change)[0]))
        x, y, radius = contact.circle_px
        away.append(np.hypot(columns[None, :] - x, rows[:, None] - y) / radius)
    return np.stack(dark), np.stack(away).astype(np.float32)
