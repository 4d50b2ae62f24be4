"""Lattice regression: values at the nodes of a grid, fitted so that multilinear interpolation meets scattered samples.

Each sample pulls on the corners of the grid cell that it lies in; nodes without samples follow their neighbours,
because second differences are kept small (E. Garcia, R. Arora, M. R. Gupta, Optimized regression for efficient
function evaluation, IEEE Trans. Image Processing 21(9), 2012, section III).
"""

from __future__ import annotations

from itertools import product

import numpy as np
import scipy  # its parts load at first use
from numpy.typing import NDArray

from gelform.color_models._shared.least_squares import HUBER_SLOPE

ROUNDS = 2
FOLDS, STRETCHES = 2, 24  # stretches of the samples, about a press or two each, are dealt into folds
TOLERANCE = 1e-3


def corner_weights(coordinates: list[NDArray[np.float64]], sizes: tuple[int, ...]) -> scipy.sparse.csr_matrix:
    """Matrix (N, nodes) of multilinear weights; beyond the grid the nearest face counts.

    Parameters
    ----------
    coordinates : per axis the positions (N,) of the samples, in nodes
    sizes : number of nodes per axis
    """
    count = len(coordinates[0])
    low, part = [], []
    for at, size in zip(coordinates, sizes):
        clipped = np.clip(at, 0, size - 1)
        index = np.minimum(clipped.astype(int), max(size - 2, 0))
        low.append(index)
        part.append(clipped - index)
    columns, values = [], []
    for corner in product(*[(0, 1) if size > 1 else (0,) for size in sizes]):
        node = np.zeros(count, dtype=int)
        share = np.ones(count)
        for index, between, up, size in zip(low, part, corner, sizes):
            node = node * size + index + up
            share = share * (between if up else 1 - between)
        columns.append(node)
        values.append(share)
    rows = np.tile(np.arange(count), len(columns))
    entries = np.concatenate(values), (rows, np.concatenate(columns))
    return scipy.sparse.csr_matrix(entries, shape=(count, int(np.prod(sizes))))


class Lattice:
    """Least squares on the nodes of a grid over (y, x, R, G, B), of slopes that are 0 at no change of colour.

    Parameters
    ----------
    sizes : number of nodes per axis
    zero : the node of no change on the three color axes
    smoothness : weight of the squared second differences, relative to the samples
    """

    def __init__(self, sizes: tuple[int, ...], zero: tuple[int, ...], smoothness: float) -> None:
        self.smoothness = smoothness
        self.roughness = scipy.sparse.csr_matrix((int(np.prod(sizes)),) * 2)
        for axis, size in enumerate(sizes):
            if size > 1:
                self.roughness = self.roughness + _squared_differences(sizes, axis)
        free = np.ones(sizes, dtype=bool)
        free[:, :, zero[0], zero[1], zero[2]] = False
        self.free = np.flatnonzero(free)

    def fitted(
        self, corners: scipy.sparse.csr_matrix, target: NDArray[np.float64], weight: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Slopes (nodes, 2) by conjugate gradients, reweighted by Huber's loss.

        Parameters
        ----------
        corners : from `corner_weights`
        target : (N, 2), the samples' slopes
        weight : (N,), >= 0
        """
        slopes, current = np.zeros((corners.shape[1], 2)), weight
        scale = self.smoothness * float(weight.sum()) / len(self.free)
        part = corners[:, self.free]
        stiff = self.roughness[self.free][:, self.free] * scale
        for _ in range(ROUNDS):
            normal = (part.T @ scipy.sparse.diags(current) @ part + stiff).tocsr()
            precondition = scipy.sparse.diags(1 / (normal.diagonal() + 1e-12))
            right = part.T @ (current[:, None] * target)
            for c in (0, 1):
                enough = TOLERANCE * float(np.linalg.norm(right[:, c]))
                start = slopes[self.free, c]
                slopes[self.free, c] = scipy.sparse.linalg.cg(
                    normal, right[:, c], x0=start, atol=enough, maxiter=500, M=precondition
                )[0]
            residual = np.linalg.norm(corners @ slopes - target, axis=1)
            current = weight * np.minimum(1, HUBER_SLOPE / np.maximum(residual, 1e-12))
        return slopes


def _squared_differences(sizes: tuple[int, ...], axis: int) -> scipy.sparse.csr_matrix:
    """D^T D of second differences along one axis (first ones where there are two nodes), over all nodes."""
    size = sizes[axis]
    order = [1.0, -2.0, 1.0] if size > 2 else [-1.0, 1.0]
    line = scipy.sparse.diags(order, list(range(len(order))), shape=(size - len(order) + 1, size))
    before, after = (int(np.prod(part)) for part in (sizes[:axis], sizes[axis + 1 :]))
    return scipy.sparse.csr_matrix(
        scipy.sparse.kron(scipy.sparse.kron(scipy.sparse.eye(before), line.T @ line), scipy.sparse.eye(after))
    )


def held_out_residuals(
    lattice: Lattice,
    corners: scipy.sparse.csr_matrix,
    target: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Residuals (N, 2) of samples that were not fitted: stretches of them are left out in turn.

    Samples come press by press, so a stretch is about one press and its neighbours in the list no copies of it.
    """
    stretch = np.arange(len(target)) * STRETCHES // max(len(target), 1)
    fold = stretch % FOLDS
    residual = np.empty_like(target)
    for one in range(FOLDS):
        out = fold == one
        slopes = lattice.fitted(corners[~out], target[~out], weight[~out])
        residual[out] = corners[out] @ slopes - target[out]
    return residual
