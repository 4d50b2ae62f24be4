"""Compile the kernels before they are needed: once per installation; from then on they are read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gelform.depth_sigma.batched_cycle import solve_lanes
from gelform.depth_sigma.blocks import Cells, sigma_of_pixels
from gelform.depth_sigma.probes import ProbeSolver, white_draws
from gelform.solvers.dct import DctSolver
from gelform.solvers.multigrid.hierarchy import build
from gelform.solvers.multigrid.solver import MultigridSolver

# What takes longest to compile, of each part.
SLOW = (build, solve_lanes, sigma_of_pixels)
MESSAGE = "Compiling the depth solvers for this machine: some seconds, once."


def is_compiled() -> bool:
    """Whether the weighted solver and `depth_sigma` start at once: compiled in this process, or kept on disk."""
    return all(bool(kernel.signatures) or _is_kept(kernel) for kernel in SLOW)


def warmup(progress: Callable[[str], None] | None = None) -> None:
    """Compile every kernel, or read it from numba's cache on disk; what follows then takes its usual time.

    Parameters
    ----------
    progress : callable, optional
        Is told, in one sentence, if it is going to take seconds.
    """
    if progress is not None and not is_compiled():
        progress(MESSAGE)
    gradients = np.zeros((8, 9, 2), dtype=np.float32)
    weights = np.ones((8, 9), dtype=np.float32)
    weights[3, 4] = 0
    DctSolver((8, 9), (1.0, 1.0))(gradients)
    MultigridSolver((8, 9), (1.0, 1.0))(gradients, weights)
    _warm_sigma(gradients + 1, weights)


def _warm_sigma(sigma: NDArray[np.float32], weights: NDArray[np.float32]) -> None:
    """The kernels of `depth_sigma`, for slopes apart and alike."""
    draws = white_draws(2, (4, 5), np.random.default_rng(0))
    everywhere = np.ones(weights.shape, dtype=bool)
    for slopes in (sigma, np.ascontiguousarray(sigma[..., :1])):
        cells = Cells(slopes, weights, everywhere, weights, everywhere, np.float32(1e-3), 2)
        variance = ProbeSolver(draws, draws, (2.0, 2.0))(cells.white, cells.common, cells.problem)[..., 0]
        pixels, within = np.repeat(np.repeat(variance, 2, 0), 2, 1), np.ones(2, dtype=np.float32)
        sigma_of_pixels(pixels, slopes, within, weights, np.float32(1e-3), weights, np.empty_like(weights))


def _is_kept(kernel: object) -> bool:
    """An index newer than the source lies in numba's cache."""
    function = kernel.py_func  # type: ignore[attr-defined]
    source = Path(function.__code__.co_filename)
    folder = Path(kernel.stats.cache_path)  # type: ignore[attr-defined]
    kept = folder.glob(f"{source.stem}.{function.__name__}-*.nbi")
    return any(index.stat().st_mtime > source.stat().st_mtime for index in kept)
