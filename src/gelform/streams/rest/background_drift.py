"""The untouched image follows the gel where nothing touches it: smooth light at once, all else late and slowly.

What changes a frame slowly is either the sensor (LEDs that warm up, a gel that relaxes) or a slow press, and the two
look alike for a while. They are told apart by shape and by time:

- Light that changes smoothly over the whole image (`SmoothLight`) is followed within seconds. No contact is that wide
  when it begins.
- Everything else is held in quarantine: an average over 10 s becomes part of the untouched image only where nothing
  touched for 30 s before it *and* for 60 s after it (`Touched`, with a margin). A slow press is seen by then, however
  slight it was at first, so that nothing of it is absorbed.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.reconstruction import Reconstruction
from gelform.streams.evidence import Evidence
from gelform.streams.rest.smooth_light import SmoothLight, block_means
from gelform.streams.rest.touched import Touched

BLOCK_PX = 8
STEP_S, MEAN_S = 1.0, 3.0  # how often the light is fitted, and over how long blocks are averaged for it
CANDIDATE_S, BEFORE_S, AFTER_S, FOLLOW_S = 10.0, 30.0, 60.0, 60.0
LONGEST_GAP_S = 5.0  # without a frame: nobody knows what happened
LEAST_FREE = 0.3  # part of the blocks that has to be untouched for the light to be fitted
NO_MEASURE = {"beyond_gel", "dark", "exposure_unknown", "frozen", "saturated", "torn"}
DIFFERENT = {
    "background_differs",
    "few_untouched",
    "not_this_gel",
}  # a contact that fills the image, or another gel
LEVELS = 256  # of a candidate, per grey level
WHITE = 255.0  # what a camera shows at most; the smooth light can promise more


@dataclass(frozen=True, eq=False)
class Candidate:
    """An average image, with the smooth light taken out, that may become the untouched one.

    Attributes
    ----------
    start_s, end_s : when its frames were captured
    image : (H, W, 3) uint16, 1/256 grey level
    """

    start_s: float
    end_s: float
    image: NDArray[np.uint16]


class BackgroundDrift:
    """The untouched image of now; a function of the sequence of images and results.

    Parameters
    ----------
    background : (H, W, 3) float32, 0-255, the untouched image from which the sequence starts

    Attributes
    ----------
    evidence : the mean of the last ten seconds that were whole, or None
    """

    def __init__(self, background: NDArray[np.float32]) -> None:
        self.start = background
        self._local = background.astype(np.float32)
        self._local_blocks = block_means(self._local, BLOCK_PX)
        shape = self._local_blocks.shape[:2]
        self.light = SmoothLight((shape[0], shape[1]))
        self.touched = Touched((shape[0], shape[1]))
        self._mean: NDArray[np.float32] | None = None
        self._waiting: deque[Candidate] = deque()
        self._last_s: float | None = None
        self._asked = self._taking = False
        self._contact_long = np.zeros(background.shape[:2], dtype=bool)
        self.evidence: Evidence | None = None
        self._start_anew(0.0)

    def take(self) -> None:
        """Nothing touches now: the mean of the next second is the untouched image. From any thread."""
        self._asked = True

    def __call__(self, image: NDArray[Any], result: Reconstruction) -> NDArray[np.float32] | None:
        """Learn from a frame; the untouched image (H, W, 3) where it has changed, else None."""
        time_s = result.time_s or 0.0
        if self._last_s is None or not 0 <= time_s - self._last_s <= LONGEST_GAP_S:
            self._lose_track(time_s)
        self._last_s = time_s
        if self._asked:
            self._asked, self._taking = False, True
            self._start_anew(time_s)
        names = {finding.name for finding in result.health}
        if names & NO_MEASURE:
            self._contact |= True
            return None
        self._add(image, result.contact)
        if names & DIFFERENT:
            self._contact |= True
            self._different += 1
        if time_s - self._step_s < STEP_S:
            return None
        return self._taken(time_s) if self._taking else self._step(time_s)

    def _taken(self, time_s: float) -> NDArray[np.float32]:
        """Start again from the mean since it was asked for."""
        self._taking = False
        self.start = self._local = self._sum / np.float32(self._sum_count)
        self._local_blocks = block_means(self._local, BLOCK_PX)
        self.light.coefficients[:] = 0
        self.touched.nowhere()
        self._waiting.clear()
        self._mean = None
        self._start_anew(time_s)
        return self._local.copy()

    def _lose_track(self, time_s: float) -> None:
        self.touched.everywhere(time_s)
        self._waiting.clear()
        self._mean = None
        self._start_anew(time_s)

    def _start_anew(self, time_s: float) -> None:
        """Begin a step and a candidate."""
        self._step_s = self._candidate_s = time_s
        self._blocks = np.zeros_like(self._local_blocks)
        self._contact = np.zeros(self._local.shape[:2], dtype=bool)
        self._sum = np.zeros_like(self._local)
        self._count = self._sum_count = self._different = 0

    def _add(self, image: NDArray[Any], contact: NDArray[np.bool_]) -> None:
        self._blocks += block_means(image, BLOCK_PX)
        self._count += 1
        cv2.accumulate(image, self._sum)
        self._sum_count += 1
        self._contact |= contact
        self._contact_long |= contact

    def _step(self, time_s: float) -> NDArray[np.float32] | None:
        """Fit the light, see what is touched, take in what has waited long enough."""
        step_s, blocks = time_s - self._step_s, self._blocks * np.float32(1 / self._count)
        seen = self._averaged(blocks, step_s)
        rest = self._local_blocks
        contact = self._contact_blocks()
        free = self.touched.not_since(time_s - MEAN_S) & ~contact
        if free.mean() >= LEAST_FREE:
            self.light.fit(seen, rest, free)
        lit = rest * self.light.at(rest.shape[:2])
        self.touched.see(time_s, step_s, contact, blocks / lit - 1, lit)
        if time_s - self._candidate_s >= CANDIDATE_S:
            self._keep_candidate(time_s)
        self._take_in(time_s)
        self._step_s = time_s
        self._blocks[:], self._count = 0, 0
        self._contact[:] = False
        lit = self._local * self.light.at(self._local.shape[:2])
        return np.asarray(np.minimum(lit, WHITE), dtype=np.float32)

    def _averaged(self, blocks: NDArray[np.float32], step_s: float) -> NDArray[np.float32]:
        if self._mean is None:
            self._mean = blocks
        else:
            self._mean += np.float32(-np.expm1(-step_s / MEAN_S)) * (blocks - self._mean)
        return self._mean

    def _contact_blocks(self) -> NDArray[np.bool_]:
        shares = cv2.resize(
            self._contact.astype(np.float32), self._local_blocks.shape[1::-1], interpolation=cv2.INTER_AREA
        )
        return np.asarray(shares > 0)

    def _keep_candidate(self, time_s: float) -> None:
        light = self.light.at(self._local.shape[:2])
        mean = self._sum * np.float32(1 / self._sum_count)
        self.evidence = self._evidence(time_s, mean, light)
        image = mean * np.float32(LEVELS) / light
        levels = np.clip(np.rint(image), 0, 255 * LEVELS).astype(np.uint16)
        self._waiting.append(Candidate(self._candidate_s, time_s, levels))
        self._candidate_s = time_s
        self._sum[:], self._sum_count, self._different = 0, 0, 0
        self._contact_long[:] = False

    def _evidence(self, time_s: float, mean: NDArray[np.float32], light: NDArray[np.float32]) -> Evidence:
        touched = ~self.touched.not_since(self._candidate_s)
        return Evidence(
            time_s=time_s,
            image=mean,
            frames=self._sum_count,
            start=self.start,
            light=light,
            touched=_as_pixels(touched, self._local.shape[:2]),
            contact=self._contact_long.copy(),
            different=self._different / self._sum_count,
        )

    def _take_in(self, time_s: float) -> None:
        """Let candidates that have waited become part of the untouched image, where nothing touched around their time."""
        while self._waiting and self._waiting[0].end_s + AFTER_S <= time_s:
            candidate = self._waiting.popleft()
            free = self.touched.not_since(candidate.start_s - BEFORE_S).astype(np.float32)
            share = cv2.resize(free, self._local.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            span_s = candidate.end_s - candidate.start_s
            share *= np.float32(-np.expm1(-span_s / FOLLOW_S))
            image = candidate.image.astype(np.float32) * np.float32(1 / LEVELS)
            self._local += share[..., None] * (image - self._local)
            self._local_blocks = block_means(self._local, BLOCK_PX)


def _as_pixels(blocks: NDArray[np.bool_], shape: tuple[int, int]) -> NDArray[np.bool_]:
    pixels = cv2.resize(blocks.astype(np.uint8), shape[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(pixels, dtype=bool)
