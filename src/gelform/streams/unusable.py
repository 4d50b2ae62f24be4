"""What a frame gives that cannot be of the calibrated gel: a result that knows nothing, with the reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.errors import CalibrationError
from gelform.findings import Finding
from gelform.health import DepthLimit
from gelform.markers import MarkerFlow
from gelform.reconstruct import Reconstructor
from gelform.reconstruction import Reconstruction
from gelform.reconstruction.maps import BESIDE_DEPTH

NOT_THIS_GEL = "not_this_gel"
UNKNOWN_SLOPE = 1.0  # standard deviation of a slope of which nothing is known, mm/mm


def result_from_image(
    reconstruct: Reconstructor, image: NDArray[Any], markers: MarkerFlow | None = None
) -> Reconstruction:
    """The image's result; where the Reconstructor refuses the image, one that knows nothing.

    In a sequence a frame that is clearly not of the calibrated gel (the gel was taken off, a light went out) is no
    reason to stop: the finding `not_this_gel` has the words of the refusal.

    Raises
    ------
    ValueError, TypeError
        As `Reconstructor.from_image`: the source gives no images of the calibrated size.
    """
    try:
        return reconstruct.from_image(image, markers=markers)
    except CalibrationError as refusal:
        return unusable(reconstruct, Finding(NOT_THIS_GEL, str(refusal), 1.0))


def unusable(reconstruct: Reconstructor, finding: Finding) -> Reconstruction:
    """A result of depth 0, known nowhere: its deviation is that of a depth of which only the limits are known."""
    calibration = reconstruct.calibration
    shape, pitch = calibration.image_shape, calibration.mm_per_px
    sigma = None if pitch is None else np.full(shape, DepthLimit.of(shape, pitch).ignorance_mm, np.float32)
    nothing: dict[str, Any] = {
        one.name: np.zeros((*shape, *one.axes), one.dtype) for one in BESIDE_DEPTH if not one.optional
    }
    return Reconstruction(
        depth=np.zeros(shape, np.float32),
        depth_sigma_mm=sigma,
        gradients_sigma=np.full((*shape, 2), UNKNOWN_SLOPE, np.float32),
        **nothing,
        mm_per_px=pitch,
        mm_per_px_sigma=calibration.mm_per_px_sigma,
        health=(*reconstruct.findings, finding),
        calibration_digest=calibration.digest,
    )


def unknown_by_now(reconstruct: Reconstructor, result: Reconstruction) -> Reconstruction:
    """The result of an image that is not of now, such as one that a hanging camera repeats: as before, but not known."""
    nothing = unusable(reconstruct, result.health[-1])
    return replace(
        result,
        depth_sigma_mm=nothing.depth_sigma_mm if result.depth_sigma_mm is not None else None,
        gradients_sigma=nothing.gradients_sigma,
        confidence=nothing.confidence,
        known=nothing.known,
    )
