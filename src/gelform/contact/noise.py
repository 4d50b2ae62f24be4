"""How noisy the slopes of an untouched gel are from place to place: where light is weak, more."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.background.change import PreparedBackground
from gelform.color_models.seam import PreparedColorModel
from gelform.medians import medians_where

USUAL_LEVELS = 2.0  # grey levels, of a calibration that does not know its images' noise
SMOOTH_PX = 8.0
LEAST, MOST = 0.3, 4.0  # times the median: beyond, a color model says more of itself than of noise


def noise_by_place(
    model: PreparedColorModel, untouched: PreparedBackground, levels: Sequence[float] | None
) -> NDArray[np.float32]:
    """Standard deviation of the slopes at rest at each place over its median, (H, W), from the image's noise.

    By how much the slopes change when a channel is brighter by its noise: the color model's derivative, by one difference
    for each channel.

    Parameters
    ----------
    model : ready for frames over this background
    untouched : the background
    levels : standard deviation of a pixel's red, green, blue, grey levels; None where unknown
    """
    rest = model.gradients_from_color(np.zeros_like(untouched.background))[0].copy()
    variance = np.zeros(rest.shape[:2], dtype=np.float32)
    for channel, level in enumerate(levels or (USUAL_LEVELS,) * 3):
        brighter = untouched.background.copy()
        brighter[..., channel] += np.float32(level)
        off = model.gradients_from_color(untouched.change(brighter))[0] - rest
        variance += off[..., 0] ** 2 + off[..., 1] ** 2
    noise = np.sqrt(cv2.GaussianBlur(variance, (0, 0), SMOOTH_PX, borderType=cv2.BORDER_REPLICATE))
    # np.median loads numpy.ma, a tenth of a first frame.
    median = float(medians_where(noise[..., None])[0][0])
    if median == 0:
        return np.ones_like(noise)
    return np.clip(noise / np.float32(median), LEAST, MOST, dtype=np.float32)
