"""Slopes of one frame -> depth and its standard deviation, with weights and the anchor where the solver takes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.depth.anchor import RestAnchor
from gelform.depth.integrate import Integration, integrate_unchecked
from gelform.depth.sigma.sigma import DepthDifference, DepthSigma, checked_sigma
from gelform.depth.solvers.inputs import takes_weights

Work = Callable[[], NDArray[np.float32]]


class FrameDepth:
    """Depth for the frames of one calibration. It is immutable; threads can share it.

    Parameters
    ----------
    shape : (H, W)
    pitch : mm per pixel
    solver : a checked name; one that treats all slopes alike uses neither weights nor anchor
    full_confidence_sigma : standard deviation of a slope of confidence 1, mm/mm
    correlation : of the slopes' errors, as in `DepthSigma`; None: the depth's standard deviation is not computed
    gain_sigma : relative standard deviation of all slopes together

    Attributes
    ----------
    sigma : DepthSigma or None
    """

    def __init__(
        self,
        shape: tuple[int, int],
        pitch: float,
        solver: str,
        full_confidence_sigma: float,
        *,
        correlation: Mapping[str, Any] | None,
        gain_sigma: float,
    ) -> None:
        self.solver, self.gain_sigma, self._pitch = solver, gain_sigma, pitch
        self._anchor = RestAnchor(shape, pitch, full_confidence_sigma) if takes_weights(solver) else None
        self.sigma = None if correlation is None else DepthSigma(shape, mm_per_px=pitch, **correlation)

    def __call__(
        self,
        slopes: NDArray[np.float32],
        slopes_sigma: NDArray[np.float32] | None,
        confidence: NDArray[np.float32],
        at_rest: NDArray[np.bool_],
        start: Callable[[Work], Work],
    ) -> tuple[Integration, NDArray[np.float32] | None, DepthDifference | None]:
        """Depth of slopes (H, W, 2), its standard deviation by their local errors, and the one of depth differences.

        `start(work)` begins the work of the standard deviation; the function that it returns ends it.
        """
        solve_args: dict[str, Any] = {"zero": at_rest}
        if self._anchor is not None:
            solve_args = {"weights": confidence, "anchor": self._anchor(slopes, at_rest)}
        if self.sigma is None or slopes_sigma is None:
            solution = integrate_unchecked(slopes, mm_per_px=self._pitch, solver=self.solver, **solve_args)
            return solution, None, None
        sigma_args = {**solve_args, "at_rest": at_rest}
        sigma_of = start(partial(self.sigma.unchecked, checked_sigma(slopes_sigma), **sigma_args))
        solution = integrate_unchecked(slopes, mm_per_px=self._pitch, solver=self.solver, **solve_args)
        difference = DepthDifference(self.sigma, slopes_sigma, sigma_args, solution.depth_mm, self.gain_sigma)
        return solution, sigma_of(), difference
