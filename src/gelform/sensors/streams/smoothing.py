"""Depth averaged over the last frames where it is constant, and followed at once where it changes."""

from __future__ import annotations

import math
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.checks import check_within
from gelform.foundations.filters import robust_sigma
from gelform.result import Later, Reconstruction
from gelform.slopes.gradients import slopes_of_solution

LONGEST_S = 60.0  # s, largest time constant
STILL, MOVING = 2.0, 4.0  # standard deviations of noise: a change is averaged below, followed above
NEARBY_PX = 5  # px, width of the squares in which a change is searched: noise is correlated over some pixels
NOISE_FRACTION = 0.1  # weight of each frame in the running mean of the noise
NOISE_SAMPLE_PX = 4  # px: every fourth row and column measures the noise


class Smoothing:
    """A running mean of depth per pixel, with exponentially falling weights.

    The delay of the mean is the time constant. If the change within a square of 5 px exceeds 4 times the noise of two
    frames, the mean of that pixel starts again without delay. Between 2 and 4 times it restarts in part.

    Parameters
    ----------
    time_s : time constant, s
    """

    def __init__(self, time_s: float) -> None:
        self.time_s = check_within(time_s, "smoothing", 0, LONGEST_S)
        self._mean = self._last = np.empty((0, 0), np.float32)
        self._left = np.empty((0, 0), np.float32)  # fraction of a frame's variance left in the mean
        self._last_s = -math.inf
        self._noise = 0.0

    def __call__(self, result: Reconstruction) -> Reconstruction:
        """The result with depth, slopes and standard deviation of the mean; observations of this frame stay unchanged.

        Averaging reduces only noise that changes from frame to frame. Its variance is measured on differences of
        frames and is subtracted in `depth_sigma_mm`.
        """
        depth, time_s = result.depth, result.time_s or 0.0
        if self._mean.shape != depth.shape or time_s <= self._last_s:
            self._mean, self._left = depth.copy(), np.ones_like(depth)
        else:
            self._update(depth, time_s - self._last_s)
        self._last, self._last_s = depth, time_s
        return self._smoothed(result)

    def _update(self, depth: NDArray[np.float32], step_s: float) -> None:
        self._measure_noise(depth - self._last)
        change = depth - self._mean
        nearby = cv2.blur(change, (NEARBY_PX, NEARBY_PX))
        moves = np.abs(nearby)
        moves *= np.float32(1 / max(math.sqrt(2) * self._noise, 1e-9))
        moves -= np.float32(STILL)
        moves *= np.float32(1 / (MOVING - STILL))
        # In a mean of n frames the next frame has the weight 1/(n + 1): the mean of a pixel that came to rest grows.
        least = self._left / (1 + self._left)
        weight = np.clip(np.maximum(moves, least), -math.expm1(-step_s / max(self.time_s, 1e-9)), 1)
        self._mean += weight * change
        self._left = np.square(1 - weight) * self._left + np.square(weight)

    def _measure_noise(self, difference: NDArray[np.float32]) -> None:
        sample = difference[::NOISE_SAMPLE_PX, ::NOISE_SAMPLE_PX]
        noise = float(robust_sigma(sample)) / math.sqrt(2)
        self._noise = noise if self._noise == 0 else self._noise + NOISE_FRACTION * (noise - self._noise)

    def _smoothed(self, result: Reconstruction) -> Reconstruction:
        depth = self._mean.copy()
        pitch = result.mm_per_px or 1.0
        pitches = (pitch, pitch) if isinstance(pitch, float) else pitch
        solved = depth.copy()  # the caller may write to the result's
        sigma = Later(partial(_less_noise, result, self._left, self._noise))
        slopes = Later(partial(slopes_of_solution, solved, pitches))
        return result.changed(depth=depth, depth_sigma_mm=sigma, gradients=slopes)


def _less_noise(
    result: Reconstruction, left: NDArray[np.float32], noise: float
) -> NDArray[np.float32] | None:
    """The standard deviation of a result's depth without the noise that is averaged away."""
    sigma = result.depth_sigma_mm
    if sigma is None:
        return None
    averaged_away = np.float32(noise**2) * (1 - left)
    least = left * np.square(sigma)  # if all of sigma is noise of frames
    return np.asarray(np.sqrt(np.maximum(np.square(sigma) - averaged_away, least)))
