"""Motion of an image relative to the background image: whether the camera, or the gel in front of it, has shifted.

Where nothing touches, the logarithm of the image is that of the background, moved a little, plus light that changed
smoothly. The motion (shift, turn, stretch) and a quadratic light are fitted together to the pixels at rest, from the peak
of the phase correlation, coarse to fine. The texture decides how well the motion is known. Noise in the background's
slopes is subtracted from its information. Along a direction with mostly noise the answer is no motion, with the standard
deviation of an unknown motion.

Lucas and Kanade, An iterative image registration technique, IJCAI 1981; noisy regressors: Fuller, Measurement error models,
1987, chapter 2; standard deviations by blocks, since residuals are correlated: Liang and Zeger, Biometrika 73, 1986.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Array, Floats, Map, Mask, Numbers
from gelform.foundations.checks import check_image, check_mask
from gelform.foundations.filters import log_levels
from gelform.foundations.information import determined_by
from gelform.image.view import PIXEL_VARIANCE

FINEST_PX = 1.5  # px, standard deviation of the last blur
# Of the blurs, coarse to fine, each half of the one before; the first still finds a shift of about 8 px.
BLURS_PX = (4 * FINEST_PX, 2 * FINEST_PX, FINEST_PX, FINEST_PX)
PRIOR_PX = 5.0  # px, standard deviation of an unknown motion at the image's corners
# Rows and columns of blocks whose residuals count as independent; they are larger than texture.
BLOCKS = (8, 10)
MOST_PX = int(2 * BLURS_PX[0])  # px, longest shift; so wide a border, which blurs reach beyond, is left out
# Phase correlation for the start of the fit: texture finer than this Gaussian, px; smallest peak.
FINE_PX, MIN_RESPONSE = 4.0, 0.08
STEP = 1 / cv2.INTER_TAB_SIZE  # px, the finest step of cv2.remap


@dataclass(frozen=True)
class Registration:
    """The motion of an image relative to the background.

    Attributes
    ----------
    shift_px : (2,) float64, x and y at the image's center: a point at p has moved to p + shift_px
    shift_sigma_px : (2,) float64, one standard deviation; 5 along a direction without any texture, which means unknown
    turn_deg, turn_sigma_deg : float, about the center, from x toward y
    stretch, stretch_sigma : float, growth of the image as a fraction
    untouched : float, 0-1, fraction of the image at rest, which it was read from; 0: nothing is at rest, nothing is known
    """

    shift_px: Numbers
    shift_sigma_px: Numbers
    turn_deg: float
    turn_sigma_deg: float
    stretch: float
    stretch_sigma: float
    untouched: float

    def moved_px(self, sigmas: float = 4.0) -> float:
        """The smallest likely motion, px: the length of the shift, each part less so many standard deviations; >= 0."""
        size = np.abs(self.shift_px) - sigmas * self.shift_sigma_px
        return float(np.hypot(*np.maximum(size, 0)))


def registration_from_image(
    image: ArrayLike, background: ArrayLike, touched: Mask | None = None
) -> Registration:
    """Register an image against the background image.

    Parameters
    ----------
    image, background : (H, W, 3), RGB, 0-255, of one size
    touched : (H, W) bool, pixels to leave out, such as a result's contact; large changed areas are left out anyway

    Returns
    -------
    Registration
        For shifts up to about 8 px and turns up to 2 degrees. Markers are texture too; a contact that drags them
        apart looks like a stretch.

    Raises
    ------
    ValueError, TypeError
        An image is no (H, W, 3) of numbers in 0-255, or they differ in size; `touched` is no mask of that size.
    """
    rest = check_image(background, name="background")
    now = check_image(image, shape=rest.shape[:2])
    if touched is not None:
        touched = check_mask(touched, shape=rest.shape[:2], name="touched", may_be_empty=True)
    return PreparedRegistration(rest)(now, touched)


class PreparedRegistration:
    """A background prepared for many images; its arguments are those of `registration_from_image`."""

    def __init__(self, background: Array) -> None:
        self._logs = log_levels(background)
        height, width = self._logs.shape
        if min(height, width) < 2:
            raise ValueError(f"Expected images of at least 2x2 px to register, got {height}x{width} px.")
        self._half = np.hypot(height, width) / 2
        self._y, self._x = np.mgrid[:height, :width].astype(np.float32)
        self._u = (self._x - (width - 1) / 2) / np.float32(self._half)
        self._v = (self._y - (height - 1) / 2) / np.float32(self._half)
        row, column = (np.minimum((np.arange(n) * b) // n, b - 1) for n, b in zip((height, width), BLOCKS))
        self._block = (row[:, None] * BLOCKS[1] + column).ravel()
        self._window = cv2.createHanningWindow((width, height), cv2.CV_32F)
        self._levels = {blur: self._regressors(blur) for blur in set(BLURS_PX)}

    def __call__(self, image: Array, touched: Mask | None = None) -> Registration:
        """Register an image (H, W, 3), 0-255, of the background's size."""
        logs = log_levels(image)
        motion, covariance, fraction = self._start(logs, touched), PRIOR_PX**2 * np.eye(4), 0.0
        for blur in BLURS_PX:
            motion[:2] = np.round(motion[:2] / STEP) * STEP
            used = self._untouched(self._moved_back(logs, motion) - self._logs, touched)
            fraction = float(used.mean())
            if fraction < 0.1:  # less does not determine four motions and six terms of light
                return _registration(np.zeros(4), PRIOR_PX**2 * np.eye(4), self._half, 0.0)
            change, covariance = self._fit(logs, motion, blur, used)
            motion = motion + change
            if np.abs(motion).max() > 2 * MOST_PX:  # it diverged, because nothing holds it
                return _registration(np.zeros(4), PRIOR_PX**2 * np.eye(4), self._half, fraction)
        return _registration(motion, covariance, self._half, fraction)

    def _regressors(self, blur: float) -> tuple[Floats, Floats]:
        """The blurred background, and (H*W, 10): quadratic light, then its change by shift, turn and stretch."""
        logs = cv2.GaussianBlur(self._logs, (0, 0), blur)
        down, across = np.asarray(np.gradient(logs))
        u, v = self._u, self._v
        light = [np.ones_like(u), u, v, u * u, u * v, v * v]
        moved = [-across, -down, v * across - u * down, -(u * across + v * down)]
        return logs, np.stack([*light, *moved], axis=-1).reshape(-1, 10)

    def _moved_back(self, logs: Map, motion: Numbers) -> Map:
        """The image on the pixels of the background: its value at p + motion(p)."""
        shift_x, shift_y, turn, stretch = motion
        x = self._x + np.float32(shift_x) + np.float32(stretch) * self._u - np.float32(turn) * self._v
        y = self._y + np.float32(shift_y) + np.float32(stretch) * self._v + np.float32(turn) * self._u
        # Linear interpolation moves a quarter of a pixel exactly. OpenCV's cubic moves a ramp by up to 0.05 px too far.
        return np.asarray(cv2.remap(logs, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

    def _untouched(self, change: Map, touched: Mask | None) -> Mask:
        """Pixels (H, W) whose surroundings are as bright as before, up to a common factor; the border is excluded."""
        # A touch changes the mean level around it, over some 8 px, by more than a fraction of 0.02.
        smooth = cv2.GaussianBlur(change, (0, 0), 8.0)
        away = np.abs(smooth - np.median(smooth))
        used = away < max(0.02, 3 * float(np.median(away)))
        if touched is not None:
            used &= ~touched
        used[:MOST_PX] = used[-MOST_PX:] = used[:, :MOST_PX] = used[:, -MOST_PX:] = False
        return used

    def _fit(self, logs: Map, motion: Numbers, blur: float, used: Mask) -> tuple[Numbers, Numbers]:
        """The correction of the motion (4,), and the covariance of the whole motion."""
        rest, regressors = self._levels[blur]
        now = cv2.GaussianBlur(self._moved_back(logs, motion), (0, 0), blur)
        of = used.ravel()
        columns = regressors[of].astype(np.float64)
        change = (now - rest).ravel()[of].astype(np.float64)
        square = columns.T @ columns
        # Pixels in one row do not determine all terms of light; those that they leave open explain nothing.
        moved = columns[:, 6:] - columns[:, :6] @ determined_by(square[:6, :6]).covariance @ square[:6, 6:]
        residual = change - columns @ determined_by(square).covariance @ (columns.T @ change)
        # The part of noise in the information on the motion: half of the residual is the background's own.
        slope = 0.5 * float(residual @ residual) / len(residual) / (2 * blur**2)
        radius = float(np.sum(self._u.ravel()[of] ** 2 + self._v.ravel()[of] ** 2))
        noise = slope * np.diag([len(residual), len(residual), radius, radius])
        return _solved(moved, change, residual, noise, self._block[of])

    def _start(self, logs: Map, touched: Mask | None) -> Numbers:
        """A start for the shift: the peak of the phase correlation of the fine texture, 0 without one."""
        used = self._untouched(logs - self._logs, touched).astype(np.float32)
        fine = [(part - cv2.GaussianBlur(part, (0, 0), FINE_PX)) * used for part in (self._logs, logs)]
        shift, response = cv2.phaseCorrelate(fine[0], fine[1], self._window)
        if response < MIN_RESPONSE or np.hypot(*shift) > MOST_PX:
            return np.zeros(4)
        return np.array([*shift, 0, 0])


def _solved(
    moved: Numbers, change: Numbers, residual: Numbers, noise: Numbers, block: NDArray[np.intp]
) -> tuple[Numbers, Numbers]:
    """The motion (4,) and its covariance (4, 4), along each direction by itself.

    `moved` (N, 4) is the change by each motion, without the part that light can explain. A direction with mostly noise
    is unknown: it gets no motion, and the prior standard deviation.
    """
    values, directions = np.linalg.eigh(moved.T @ moved)
    true = values - np.einsum("ik,ij,jk->k", directions, noise, directions)
    known = true > 0.5 * values
    inverse = directions[:, known] / true[known] @ directions[:, known].T
    scores = np.stack([np.bincount(block, moved[:, k] * residual) for k in range(4)])
    unknown = directions[:, ~known]
    covariance = inverse @ (scores @ scores.T) @ inverse + PRIOR_PX**2 * unknown @ unknown.T
    return inverse @ (moved.T @ change), covariance


def _registration(motion: Numbers, covariance: Numbers, half: float, fraction: float) -> Registration:
    # No place is known to better than the step of interpolation, however strong the texture.
    sigma = np.minimum(np.sqrt(np.diag(covariance) + STEP**2 * PIXEL_VARIANCE), PRIOR_PX)
    degrees = np.rad2deg(1 / half)
    return Registration(
        shift_px=motion[:2].copy(),
        shift_sigma_px=sigma[:2],
        turn_deg=float(motion[2] * degrees),
        turn_sigma_deg=float(sigma[2] * degrees),
        stretch=float(motion[3] / half),
        stretch_sigma=float(sigma[3] / half),
        untouched=fraction,
    )
