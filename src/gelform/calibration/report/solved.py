"""Errors of the slopes of the solved depth on held-out presses, beside what a calibration would say of them."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from gelform.calibration.presses.press_set import Presses
from gelform.calibration.report.held_out import HeldOutSample
from gelform.calibration.report.residuals import stated_sigma
from gelform.calibration_file import Calibration
from gelform.confidence import SlopeSigma, SolvedErrors, SolvedSigma, with_solved_factors
from gelform.reconstruct import Reconstructor


def solved_by_place(
    draft: Calibration, sigma: SlopeSigma, presses: Presses, samples: Sequence[HeldOutSample], seen: float
) -> SlopeSigma:
    """The deviation of slopes with factors by slope and place for those of the solved depth.

    As in `slope_sigma_from_folds`, errors are taken down by the root of the share of presses that a fold has seen.

    Parameters
    ----------
    draft : the calibration of all presses
    sigma : what it is to state, but for the factors
    presses : as read
    samples : of the held-out presses, reconstructed by models that have not seen them
    seen : share of the presses that such a model has seen
    """
    without = replace(sigma, solved_factor=1.0)
    reconstruct = Reconstructor(replace(draft, slope_sigma=without), depth_sigma=False)
    no_walls = copy(reconstruct)
    no_walls.solved_sigma = SolvedSigma(without, draft.image_shape, None)
    height, width = draft.image_shape
    parts = []
    ratio = draft.settings["contact_radius_ratio"]
    for one in (sample.within(ratio) for sample in samples):
        stated, by_reading = (
            stated_sigma(each, presses.presses[one.index].image, one)[:, 0]
            for each in (reconstruct, no_walls)
        )
        beyond = np.sqrt(np.maximum(stated**2 - by_reading**2, 0))
        place = (one.x_px + 0.5) / width, (one.y_px + 0.5) / height
        slopes, press = np.linalg.norm(one.gradients, axis=1), np.full(len(stated), one.index)
        parts.append((slopes, np.sqrt(seen) * one.errors, stated, beyond, *place, press))
    return with_solved_factors(sigma, SolvedErrors(*(np.concatenate(column) for column in zip(*parts))))
