"""Whether presses of a sensor cast shadows, and what darkness means none: from the presses that calibrate it.

Darkness around contacts that no slope explains can be a color model's error, too. Shadows fall away from the lights: to the
same sides of all presses. Errors are alike all around a contact, or at other sides of other presses.
"""

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
LEAST_PRESSES, MOST_PRESSES = 12, 40  # of fewer than 12 nothing was tried
# Sectors of a ring around the contact, contact radii; shadows are some three of them wide or more. A sector that the image
# cuts to less than a share of the usual one is left out, and a press that keeps fewer than six.
SECTORS, RING = 18, (1.0, 1.8)
LEAST_OF_SECTOR, LEAST_SECTORS = 0.3, 6
# Of the noise, in three of four presses: how much darker they are at the sides where the others are dark. With shadows 0.1
# to 0.7 of it, without at most 0.07 and, where model errors are large, below 0.
DIRECTED_FROM, QUARTILE = 0.05, 25


def shadow_noise(
    model: ColorModel,
    forward: ForwardResponse,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: NDArray[np.float32],
) -> float | None:
    """Standard deviation of the darkness that slopes in contacts leave unexplained; None where presses cast no shadows.

    None for fewer than 12 presses, too: they do not tell.

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
    dark, away, turn = _around_contacts(model, forward, presses[::step], contacts[::step], background)
    inner = np.abs(dark[away < INNER])
    noise = max(float(np.percentile(inner, MOST)) / SIGMAS_OF_MOST, LEAST_NOISE)
    cast = CastShadows(coefficients_of_cells(forward), shape, noise)
    shares = [
        float(np.mean(cast.regions(one)[ring]))
        for one, ring in zip(dark, (away >= AROUND[0]) & (away < AROUND[1]))
        if ring.any()
    ]
    many = bool(shares) and np.median(shares) >= CASTS_FROM
    return noise if many and _are_directed(directed_darkness(dark, away, turn), noise) else None


def directed_darkness(
    dark: NDArray[np.float32], away: NDArray[np.float32], turn: NDArray[np.float32]
) -> NDArray[np.float64]:
    """How much darker each press is at those sides of its contact where the other presses are dark.

    Of the mean darkness of each sector around a contact, less that of all its sectors: the component along what the other
    presses have in the mean, its RMS over sectors. What is the same all around a contact gives 0; what is at one side
    of one press and at others of others gives either sign.

    Parameters
    ----------
    dark : (N, rows, columns), darkness of presses
    away, turn : (N, rows, columns), from the contact's centre: contact radii, and the direction, 0 to 2 pi

    Returns
    -------
    (M,), M <= N: of the presses that are not cut to fewer than six sectors
    """
    profiles, seen = _sectors(dark, away, turn)
    sums, counts = profiles.sum(axis=0) - profiles, seen.sum(axis=0) - seen
    found = []
    for own, others, both in zip(profiles, sums / np.maximum(counts, 1), seen & (counts > 0)):
        if np.count_nonzero(both) >= LEAST_SECTORS:
            own, others = own[both] - own[both].mean(), others[both] - others[both].mean()
            found.append(own @ others / max(float(np.linalg.norm(others)), 1e-12) / np.sqrt(len(own)))
    return np.array(found)


def _sectors(
    dark: NDArray[np.float32], away: NDArray[np.float32], turn: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Mean darkness (N, sectors) around contacts, 0 where too little is in the image, and where it is not."""
    means, enough = [], []
    for one, ring, angle in zip(dark, (away >= RING[0]) & (away < RING[1]), turn):
        sector = np.minimum((angle[ring] * (SECTORS / (2 * np.pi))).astype(np.intp), SECTORS - 1)
        count = np.bincount(sector, minlength=SECTORS)
        usual = float(np.median(count[count > 0])) if ring.any() else 0.0
        seen = count >= max(LEAST_OF_SECTOR * usual, 1.0)
        total = np.bincount(sector, weights=one[ring], minlength=SECTORS)
        means.append(np.where(seen, total / np.maximum(count, 1), 0))
        enough.append(seen)
    return np.array(means), np.array(enough)


def _are_directed(contrasts: NDArray[np.float64], noise: float) -> bool:
    return len(contrasts) > 0 and bool(np.percentile(contrasts, QUARTILE) >= DIRECTED_FROM * noise)


def _around_contacts(
    model: ColorModel,
    forward: ForwardResponse,
    presses: Sequence[PreparedPress],
    contacts: Sequence[ContactCircle],
    background: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Darkness (N, rows, columns) of presses; how far each block is from the centre, in radii, and in which direction."""
    shape = presses[0].size.shape
    prepared = model.prepare(background, shape)
    cast = CastShadows(coefficients_of_cells(forward), shape, LEAST_NOISE)
    rows, columns = (COARSER * np.arange(n, dtype=np.float32) + (COARSER - 1) / 2 for n in cast.coarse)
    dark, away, turn = [], [], []
    for press, contact in zip(presses, contacts):
        change = np.ascontiguousarray(press.color_change)
        dark.append(cast.darkness(change, prepared.gradients_from_color(change)[0]))
        x, y, radius = contact.circle_px
        away.append(np.hypot(columns[None, :] - x, rows[:, None] - y) / radius)
        turn.append(np.arctan2(rows[:, None] - y, columns[None, :] - x) % (2 * np.pi))
    return np.stack(dark), np.stack(away).astype(np.float32), np.stack(turn).astype(np.float32)
