"""Color changes on a gel with markers: the dots' pixels are left out, and bridged for what needs a whole map.

A dot that moved is dark where it is now and, where it was, the background is dark that is divided by. So the
pixels of both are left out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.background.change import PreparedBackground
from gelform.background.exposure import Exposure
from gelform.gradients import fill_unknown
from gelform.markers import MarkerFinder

BLUR_REACH = 2.0


def change_without_markers(
    image: NDArray[Any], rest: PreparedBackground, exposure: Exposure | None, finder: MarkerFinder
) -> tuple[NDArray[np.float32], NDArray[np.bool_] | None]:
    """The color change of an image, and which of its pixels may be used.

    Parameters
    ----------
    image : (H, W, 3), 0-255
    rest : the untouched image, and how the change is taken
    exposure : what `rest.compare(image)` found, compensated; None to take the image as it is
    finder : of this background

    Returns
    -------
    color_change : (H, W, 3) float32; smooth across the dots
    usable : (H, W) bool, False on the dots of either image; None on a gel without markers
    """
    if not len(finder.untouched):
        return rest.change(image, exposure), None
    settings = rest.settings
    usable = ~_grown(finder.untouched.mask | finder(image).mask, BLUR_REACH * max(settings.blur_px, 0.5))
    sharp = PreparedBackground(rest.background, replace(settings, blur_px=0.0))
    change = fill_unknown(sharp.change(image, exposure), usable)
    if settings.blur_px > 0:
        cv2.GaussianBlur(change, (0, 0), settings.blur_px, dst=change, borderType=cv2.BORDER_REFLECT_101)
    return change, usable


def _grown(mask: NDArray[np.bool_], reach_px: float) -> NDArray[np.bool_]:
    size = 2 * int(np.ceil(reach_px)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    grown: NDArray[np.bool_] = cv2.dilate(mask.view(np.uint8), kernel).view(np.bool_)
    return grown
