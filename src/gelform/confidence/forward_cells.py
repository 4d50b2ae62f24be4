"""The forward response prepared for whole frames: in cells of 16x8 pixels its coefficients hardly vary."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.forward import ForwardResponse
from gelform.color_models._shared.least_squares import monomials, position_powers, unit_position

CELL = 8, 16  # rows, columns
TERMS = 9  # monomials of two slopes, to the third degree


def coefficients_of_cells(forward: ForwardResponse) -> NDArray[np.float32]:
    """Coefficients (rows, columns, 9, 3) of the gradients' monomials at the middle of each cell."""
    height, width = forward.shape
    rows, columns = -(-height // CELL[0]), -(-width // CELL[1])
    y = np.minimum((np.arange(rows) + 0.5) * CELL[0] - 0.5, height - 1)
    x = np.minimum((np.arange(columns) + 0.5) * CELL[1] - 0.5, width - 1)
    u, v = unit_position(x[None, :], y[:, None], forward.shape)
    cells = np.zeros((rows, columns, TERMS, 3))
    at = 0
    for k, term in enumerate(monomials(2, len(forward.position_degrees))):
        for i, j in position_powers(forward.position_degrees[len(term) - 1]):
            cells[:, :, k] += (u**i * v**j)[..., None] * forward.coefficients[at]
            at += 1
    return cells.astype(np.float32)


def explained_change(cells: NDArray[np.float32], gradients: NDArray[Any]) -> NDArray[np.float32]:
    """Color change (H, W, 3) that gradients (H, W, 2) give, by the coefficients of cells."""
    height, width = gradients.shape[:2]
    p, q = np.moveaxis(np.asarray(gradients, dtype=np.float32), -1, 0)
    products = [_product(p, q, term) for term in monomials(2, 3)]
    change = np.zeros((height, width, 3), dtype=np.float32)
    rows, columns = np.arange(height) // CELL[0], np.arange(width) // CELL[1]
    for k, product in enumerate(products):
        change += product[..., None] * cells[rows[:, None], columns[None, :], k]
    return change


def _product(p: NDArray[np.float32], q: NDArray[np.float32], term: tuple[int, ...]) -> NDArray[np.float32]:
    product = np.ones_like(p)
    for channel in term:
        product = product * (p if channel == 0 else q)
    return product
