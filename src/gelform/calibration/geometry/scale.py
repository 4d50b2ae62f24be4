"""mm per pixel with its uncertainty and its origin, also from one object pressed twice; presses do not determine it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.errors import DataError
from gelform.foundations.checks import (
    LARGEST,
    check_image,
    check_list,
    check_numbers,
    check_positive,
    check_within,
)
from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.sensors.profiles import profile_named

MAX_DISAGREEMENT = 4.0  # standard deviations between two scales


@dataclass(frozen=True)
class Scale:
    """Pixel pitch on the gel.

    Attributes
    ----------
    mm_per_px : mm per image pixel (square pixels)
    sigma : its standard deviation, mm
    source : target that it was measured on, with the figures
    along_x : square of the cosine between the measured length and the image's x axis; None if both axes were measured
    """

    mm_per_px: float
    sigma: float
    source: str
    along_x: float | None = None

    def __post_init__(self) -> None:
        check_positive(self.mm_per_px, "mm_per_px")
        check_positive(self.sigma, "sigma")
        if self.along_x is not None:
            check_within(self.along_x, "along_x", 0, 1)


def scale_from_profile(name: str) -> Scale:
    """The scale of a sensor profile; its sigma includes the differences between units."""
    profile = profile_named(name)
    return Scale(profile.mm_per_px, profile.mm_per_px_sigma, f"profile {name}: {profile.source}")


def scale_from_points(
    a_px: tuple[float, float],
    b_px: tuple[float, float],
    distance_mm: float,
    *,
    sigma_px: float = 0.5,
    sigma_mm: float = 0.0,
) -> Scale:
    """The scale from two marked points with a known distance.

    Parameters
    ----------
    a_px, b_px : (x, y) in pixels of the image, after the view
    distance_mm : between them, on the gel
    sigma_px : standard deviation of each coordinate that was marked by hand, px
    sigma_mm : standard deviation of the distance, mm

    Raises
    ------
    ValueError
        The points are nearer than 10 `sigma_px`, or a length is not positive.
    """
    a, b = check_numbers(a_px, "a_px", 2), check_numbers(b_px, "b_px", 2)
    check_positive(distance_mm, "distance_mm")
    check_positive(sigma_px, "sigma_px")
    distance_px = float(np.hypot(a[0] - b[0], a[1] - b[1]))
    if not (np.isfinite(distance_px) and distance_px > 10 * sigma_px):
        raise ValueError(
            f"Expected two points at least {10 * sigma_px:g} px apart, got {distance_px:.3g} px. "
            "Mark two that are far apart: the scale is as good as their distance is long."
        )
    source = f"two points {distance_px:.1f} px and {distance_mm:g} mm apart"
    scale = scale_from_lengths(distance_mm, distance_px, sigma_mm, np.sqrt(2) * sigma_px, source)
    return replace(scale, along_x=((a[0] - b[0]) / distance_px) ** 2)


def scale_from_lengths(mm: float, px: float, sigma_mm: float, sigma_px: float, source: str) -> Scale:
    """Scale, mm/px, from one length known in both units, with the uncertainty of both."""
    pitch = check_positive(mm, "length_mm") / check_positive(px, "length_px")
    sigma_mm = check_within(sigma_mm, "sigma_mm", 0, LARGEST)
    return Scale(pitch, float(pitch * np.hypot(sigma_mm / mm, sigma_px / px)), source)


def combined_scale(scales: Sequence[Scale]) -> Scale:
    """The mean of several scales, weighted by their inverse variances.

    Raises
    ------
    DataError
        Two of them are more than four standard deviations apart; one is wrong, and a mean would hide it. Or pixels are not
        square: if lengths along both axes show that, the message has the pair to write.
    """
    scales = check_list(scales, "scales", Scale)
    if not scales:
        raise ValueError(
            "Expected one scale or more, from two marked points, a step of a stage, or a grid, got none."
        )
    for i, a in enumerate(scales):
        for b in scales[i + 1 :]:
            apart = abs(a.mm_per_px - b.mm_per_px) / np.hypot(a.sigma, b.sigma)
            if apart > MAX_DISAGREEMENT:
                raise DataError(
                    f"Expected scales that agree, got {a.mm_per_px:.5g} +- {a.sigma:.2g} mm/px ({a.source}) and "
                    f"{b.mm_per_px:.5g} +- {b.sigma:.2g} mm/px ({b.source}): {apart:.1f} standard deviations apart. "
                    f"{_not_square(scales) or 'Leave the wrong one out.'}"
                )
    weight = np.array([1 / scale.sigma**2 for scale in scales])
    mean = float(weight @ [scale.mm_per_px for scale in scales] / weight.sum())
    return Scale(mean, float(weight.sum() ** -0.5), "; ".join(scale.source for scale in scales))


def _not_square(scales: Sequence[Scale]) -> str:
    """What to write if lengths in several directions agree on pixels that are not square; empty if they do not."""
    along = np.array([scale.along_x for scale in scales if scale.along_x is not None])
    if len(along) < len(scales) or np.ptp(along) < 0.5:  # of cos^2; it is 1 for lengths along both axes
        return ""
    pitch, sigma = (np.array([getattr(scale, name) for scale in scales]) for name in ("mm_per_px", "sigma"))
    design = np.stack([along, 1 - along], axis=1)  # pitch^2 = x^2 cos^2 + y^2 sin^2
    weight = 1 / (2 * pitch * sigma)
    squares = np.linalg.lstsq(design * weight[:, None], pitch**2 * weight, rcond=None)[0]
    residual = np.abs(design @ squares - pitch**2) * weight
    if squares.min() <= 0 or residual.max() > MAX_DISAGREEMENT:
        return ""
    x, y = np.sqrt(squares)
    return (
        f"The pixels are not square: mm_per_px = [{x:.5g}, {y:.5g}] fits all of them. Write that into sensor.toml. "
        "Or leave the wrong one out."
    )


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
    is its uncertainty, with 0.1 px of the images' similarity.

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
    bare = PreparedBackground(background, ChangeSettings(blur_px=1.0))  # the blur is against noise
    images = [check_image(image, shape=bare.background.shape[:2]) for image in (first, second)]
    a, b = (bare.change(image, bare.compare(image)[0]) for image in images)  # with the exposure compensated
    start = _coarse_shift(a, b)
    shifts = [_aligned(a[..., c], b[..., c], start) for c in range(3)]
    found = np.array([shift for shift in shifts if shift is not None])
    if not len(found):
        raise DataError(
            "Expected one thing pressed at two places, got two images that no shift aligns. Press the same thing "
            "to the same depth, whole in both images."
        )
    dx, dy = np.median(found, axis=0)
    sigma_px = float(np.hypot(0.1, np.linalg.norm(found.std(axis=0))))
    length = float(np.hypot(dx, dy))
    if length < 10 * sigma_px:
        raise DataError(
            f"Expected a step that is long against its uncertainty, got {length:.2f} +- {sigma_px:.2f} px. "
            "Move the stage further: a third of the image is good."
        )
    source = f"a stage step of {distance_mm:g} mm, ({dx:.2f}, {dy:.2f}) px"
    scale = scale_from_lengths(distance_mm, length, sigma_mm, sigma_px, source)
    return replace(scale, along_x=float((dx / length) ** 2))


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
    if likeness < 0.5 or np.hypot(matrix[0, 2] - start[0], matrix[1, 2] - start[1]) > 3:
        return None
    return float(matrix[0, 2]), float(matrix[1, 2])
