"""What the causes are told from: a frame, its color change, and what the forward response leaves unexplained."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.color_models._shared.gamut import Gamut

# Of the forward response's noise: what is less is no sign of anything. Depth alone changes the colour of a gel by up to
# 3.6 of them on a real sensor, where no gradient explains it.
NOISE_LIMIT = 3.7
SURE_LIMIT = 6.5  # of it: nothing is left of such a slope, nor of those that its blur reaches
LEAST_LIMIT, LEAST_SURE = 0.02, 0.06  # of color change, where the response was fitted to images without noise
# A colour that no gradient explains moves the slope by more than the same difference along the colours that do.
AMPLIFIED = 3.0
# mm/mm: the response, a polynomial, says nothing of slopes beyond, which a shadow may be read as.
STEEPEST = 1.0
# Times the RMS of the channels, that their mean has to be below for shadow, above for light. The slopes that are read take
# part of a lost light for their own, more of it where the channels mix the lights: what is left need not be alike in them.
DARKER, BRIGHTER = -0.25, 0.6
BLOCK_PX = 16  # lost parts are found in such blocks
# Slopes that differ by more from those this many blurs away than a small ball's do are blurred by the color change, and
# off by so much of the rest. Chosen on simulated objects with walls.
REACH, BEND_FROM, BEND = 1.6, 0.1, 1.75
# Of a slope: what the forward response, a polynomial learnt on balls, may leave unexplained beyond `sure` of a wall.
STEEP = 0.25
# Confidence of a slope of which the image says something: above that which solvers take for nothing and fill from around,
# which would take the walls from an object.
LEAST_CONFIDENCE = 0.002
UNSEEN = 1000.0  # of the clean sigma, for what says nothing: a weight of 1e-6, below that which solvers take


@dataclass(frozen=True, eq=False)
class Limits:
    """What does not depend on the frame.

    Attributes
    ----------
    clean : standard deviation of a slope of confidence 1, mm/mm
    worth : slope that a color change of 1 is worth on the training presses, mm/mm
    noise : RMS of the channels' noise about the forward response, of color change; None where there is no response
    levels : standard deviation of the calibrated images' pixels, grey levels; infinite where nobody knows
    gain : (H, W), color change of one grey level, mean of the channels
    margin_px : how far a clipped pixel's colour reaches
    outside : (H, W) bool, pixels that no light reaches; None where there are none
    gamut : colours of the training presses, or None
    blur_px : of the color change
    """

    clean: float
    worth: float
    noise: float | None
    levels: float
    gain: NDArray[np.float32]
    margin_px: int
    outside: NDArray[np.bool_] | None
    gamut: Gamut | None
    blur_px: float

    @property
    def per_bend(self) -> float:
        """Standard deviation of a slope, mm/mm, per difference to its neighbours beyond `BEND_FROM`."""
        return 0.0 if self.gamut is None else BEND

    @property
    def reach_px(self) -> int:
        """How far away the neighbours are, px."""
        return reach_px(self.blur_px)

    @property
    def unseen(self) -> float:
        """Standard deviation of a slope of which the image says nothing, mm/mm."""
        return UNSEEN * self.clean

    @property
    def unexplained(self) -> float:
        """Color change up to which what no gradient explains is no sign of anything."""
        return max(NOISE_LIMIT * (self.noise or 0.0), LEAST_LIMIT)

    @property
    def sure(self) -> float:
        """Color change that no gradient explains, from which nothing is left of a gentle slope; see `STEEP`."""
        return max(SURE_LIMIT * (self.noise or 0.0), LEAST_SURE)

    @property
    def per_change(self) -> float:
        """Standard deviation of the slope, mm/mm, for an unexplained color change of 1 beyond that."""
        return AMPLIFIED * self.worth


@dataclass(frozen=True, eq=False)
class Seen:
    """One frame, as the causes look at it.

    Attributes
    ----------
    pixels : (H, W, 3) uint8, the image, with the untouched one where parts were lost
    color_change : (H, W, 3)
    gradients : (H, W, 2), the slopes that the color model read
    residual : (H, W, 3), color change minus that which the slopes explain; None without a forward response
    markers : (H, W) bool, pixels that markers hide; None where the gel has none
    lost : (H, W) bool, parts that are torn, dark or saturated; None where there are none
    lost_pixels : (H, W, 3) uint8, the image as it came
    added_levels : noise of the image beyond the calibrated images', grey levels
    limits : of the calibration
    cast : (H, W), standard deviation of slopes in cast shadows, mm/mm; None where there are none
    gentle : (H, W, 3), the residual of slopes that are cut to `STEEPEST`; None where they are the residual's
    """

    pixels: NDArray[np.uint8]
    color_change: NDArray[np.float32]
    gradients: NDArray[np.float32]
    residual: NDArray[np.float32] | None
    markers: NDArray[np.bool_] | None
    lost: NDArray[np.bool_] | None
    lost_pixels: NDArray[np.uint8]
    added_levels: float
    limits: Limits
    cast: NDArray[np.float32] | None = None
    gentle: NDArray[np.float32] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(H, W)."""
        height, width = self.pixels.shape[:2]
        return height, width

    def common(self) -> NDArray[np.float32]:
        """Mean of the residual's channels over their RMS (H, W), -1 to 1: light without colour; 0 without a response.

        Of slopes up to `STEEPEST`.
        """
        residual = self.residual if self.gentle is None else self.gentle
        if residual is None:
            return np.zeros(self.shape, dtype=np.float32)
        return np.asarray(residual.mean(axis=-1) / np.maximum(_rms(residual), 1e-12), dtype=np.float32)

    def unexplained(self) -> NDArray[np.float32]:
        """RMS of the residual's channels (H, W); 0 without a response."""
        if self.residual is None:
            return np.zeros(self.shape, dtype=np.float32)
        return _rms(self.residual)

    def where(self, mask: NDArray[np.bool_] | None) -> NDArray[np.float32]:
        """A map (H, W) of the sigma of slopes that the image says nothing of, where the mask says so; 0 elsewhere."""
        if mask is None:
            return np.zeros(self.shape, dtype=np.float32)
        return np.where(mask, np.float32(self.limits.unseen), np.float32(0))

    def beyond(self, mask: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Standard deviation (H, W) for what is unexplained where the mask says so; nothing is known around sure pixels."""
        excess = np.maximum(self.unexplained() - np.float32(self.limits.unexplained), 0)
        doubt = np.where(mask, np.float32(self.limits.per_change) * excess, np.float32(0))
        limit = np.square(self.limits.sure) + np.square(STEEP) * np.square(self.gradients).sum(axis=-1)
        sure = self.reached_from(mask & (np.square(self.unexplained()) > limit))
        return np.hypot(doubt, self.where(sure))

    def reached_from(self, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Marked pixels (H, W) and those that they reach; marks count where there is gel to be seen alone."""
        for unseen in (self.limits.outside, self.markers, self.lost):
            if unseen is not None:
                marked = marked & ~unseen
        return with_margin(marked, self.limits.margin_px)


def _rms(channels: NDArray[np.float32]) -> NDArray[np.float32]:
    squares = np.einsum("...c,...c->...", channels, channels)
    return np.asarray(np.sqrt(squares / np.float32(3)), dtype=np.float32)


def no_steeper(gradients: NDArray[np.float32]) -> NDArray[np.float32]:
    """Slopes (H, W, 2), mm/mm, those beyond `STEEPEST` cut to it."""
    size = np.linalg.norm(gradients, axis=-1, keepdims=True)
    return gradients * (np.float32(STEEPEST) / np.maximum(size, np.float32(STEEPEST)))


def reach_px(blur_px: float) -> int:
    """How far from a pixel those lie that its slope is compared with, of a color change that is blurred so much."""
    return max(1, round(REACH * blur_px))


def with_margin(clipped: NDArray[np.bool_], margin_px: int) -> NDArray[np.bool_]:
    """Clipped pixels (H, W) and those that they reach: by the lens and the sensor's wells, and by the change's blur."""
    size = 2 * margin_px + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    grown: NDArray[np.bool_] = cv2.dilate(np.ascontiguousarray(clipped).view(np.uint8), disc).view(np.bool_)
    return grown


def lost_level(seen: Seen) -> NDArray[np.uint8]:
    """Grey levels (H, W, 3) of a frame as it came, averaged over blocks as wide as those that are lost together."""
    level: NDArray[np.uint8] = cv2.blur(seen.lost_pixels, (BLOCK_PX, BLOCK_PX))
    return level
