"""mm per pixel from one object pressed twice, a known distance apart."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.geometry.scale import Scale, scale_from_lengths
from gelform.errors import DataError
from gelform.foundations.checks import check_image
from gelform.image.background.change import ChangeSettings, PreparedBackground

BLUR_PX = 1.0  # px, blur of the change of color against noise
STEP_SIGMA_PX = 0.1  # px, uncertainty of the shift from the similarity of the images
MIN_LIKENESS = 0.5  # correlation, 0-1


def scale_from_stage(
    first: NDArray[Any],
    second: NDArray[Any],
    background: NDArray[Any],
    distance_mm: float,
    *,
    sigma_mm: float = 0.005,
) -> Scale:
    """The scale from one object pressed twice at the same depth, moved along the gel by a stage in between.

    The shift is the peak of the correlation of the two changes of color, then refined for each channel by
    aligning the images (G. D. Evangelidis and E. Z. Psarakis, IEEE Trans. PAMI 30(10), 2008); the channels' spread
    is its uncertainty.

    Parameters
    ----------
    first, second, background : (H, W, 3), RGB, 0-255, after the view
    distance_mm : motion of the stage
    sigma_mm : standard deviation of the distance, mm

    Raises
    ------
    DataError
        The two images do not show the same object, because nothing aligns.
    """
    a, b = (_change_of(image, background) for image in (first, second))
    shifts = [_aligned(a[..., c], b[..., c], _coarse_shift(a, b)) for c in range(3)]
    found = np.array([shift for shift in shifts if shift is not None])
    if not len(found):
        raise DataError(
            "Expected one thing pressed at two places, got two images that no shift aligns. Press the same thing "
            "to the same depth, whole in both images."
        )
    dx, dy = np.median(found, axis=0)
    sigma_px = float(np.hypot(STEP_SIGMA_PX, np.linalg.norm(found.std(axis=0))))
    length = float(np.hypot(dx, dy))
    if length < 10 * sigma_px:
        raise DataError(
            f"Expected a step that is long against its uncertainty, got {length:.2f} +- {sigma_px:.2f} px. "
            "Move the stage further: a third of the image is good."
        )
    source = f"a stage step of {distance_mm:g} mm, ({dx:.2f}, {dy:.2f}) px"
    scale = scale_from_lengths(distance_mm, length, sigma_mm, sigma_px, source)
    return replace(scale, along_x=float((dx / length) ** 2))


def _change_of(image: NDArray[Any], background: NDArray[Any]) -> NDArray[np.float32]:
    """Change of color (H, W, 3), with the exposure compensated."""
    bare = PreparedBackground(background, ChangeSettings(blur_px=BLUR_PX))
    checked = check_image(image, shape=bare.background.shape[:2])
    return bare.change(checked, bare.compare(checked)[0])


def _coarse_shift(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[int, int]:
    """Whole pixels (dx, dy) of the shift of b against a, from the correlation of all channels together."""
    shape = (2 * a.shape[0], 2 * a.shape[1])
    correlation = sum(
        np.fft.irfft2(np.fft.rfft2(b[..., c], shape) * np.conj(np.fft.rfft2(a[..., c], shape)), shape)
        for c in range(3)
    )
    row, column = np.unravel_index(np.argmax(correlation), shape)
    return (
        int(column) - (shape[1] if column >= a.shape[1] else 0),
        int(row) - (shape[0] if row >= a.shape[0] else 0),
    )


def _aligned(
    a: NDArray[np.float32], b: NDArray[np.float32], start: tuple[int, int]
) -> tuple[float, float] | None:
    """Sub-pixel shift (dx, dy) of b against a; None if the alignment does not converge near the start."""
    matrix = np.array([[1, 0, start[0]], [0, 1, start[1]]], dtype=np.float32)
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-7)
    try:
        likeness, matrix = cv2.findTransformECC(
            np.ascontiguousarray(a), np.ascontiguousarray(b), matrix, cv2.MOTION_TRANSLATION, stop, None, 5
        )
    except cv2.error:  # raised by OpenCV if the images have nothing in common
        return None
    if likeness < MIN_LIKENESS or np.hypot(matrix[0, 2] - start[0], matrix[1, 2] - start[1]) > 3:
        return None
    return float(matrix[0, 2]), float(matrix[1, 2])
