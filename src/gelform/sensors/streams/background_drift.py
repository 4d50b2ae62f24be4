"""Updates the background image while nothing touches the gel: smooth light at once, other changes late and slowly.

A slow change comes either from the sensor (LEDs that warm up, a gel that relaxes) or from a slow press. The two look alike
for a while. Shape and time tell them apart:

- The light, its tilt over the image and the room's light (`light_at_rest`) are followed within seconds. No contact is that
  wide when it begins.
- Everything else waits in quarantine: an average over 10 s becomes part of the background only where nothing touched for
  30 s before it *and* for 60 s after it (`Touched`, with a margin). By then even a slight slow press is detected, so that
  none of it enters the background.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform import CalibrationError, Reconstruction
from gelform.arrays import Array, Map, Mask, Numbers
from gelform.foundations.filters import robust_sigma
from gelform.foundations.findings import Finding
from gelform.image.agreement import check_untouched
from gelform.image.light import FrameLight, block_means, light_at_rest, light_from_blocks, lit, without_light

STEP_S, MEAN_S = 1.0, 3.0  # s: interval of the light's fits, and averaging time of the blocks for them
MEAN_IMAGE_S = 10.0  # s over which frames are averaged before they wait
BEFORE_S, AFTER_S = 30.0, 60.0  # s before and after a mean image in which nothing may touch
FOLLOW_S = 60.0  # s, time constant of adding mean images
LEAST_FREE = 0.9  # fraction of the blocks that must be free of contact to fit the light, which the gel's halo resembles
NO_MEASURE = {"beyond_gel", "dark", "exposure_unknown", "frozen", "saturated", "torn"}
DIFFERENT = {"background_differs", "few_untouched", "not_this_gel"}  # contact all over, or another gel
PER_GRAY_LEVEL = 256  # steps per gray level of a waiting mean image

TOUCH_SIGMAS = 5.0  # standard deviations of noise by which a touched block changes
LEAST_CHANGE = 0.0025  # fraction of a block's brightness: slopes of about 0.2 %
LONG_S = 10.0  # s, averaging time for slight changes
MOST_CHANGE = 0.01  # limit of such an average, so that a strong change does not stay in it
MARGIN = 0.1  # fraction of the image's shorter side: around a contact the gel sinks or rises


@dataclass(frozen=True, eq=False)
class DriftEvidence:
    """The mean of the frames of about ten seconds."""

    image: Map  # (H, W, 3), mean of the frames, 0-255
    start: Map  # (H, W, 3), the background at the start of the sequence
    lit: Map  # (H, W, 3), that background in the light of now
    touched: Mask  # (H, W), where something may have touched meanwhile, with a margin
    contact: Mask  # (H, W), where a frame showed contact
    different: float = 0.0  # fraction of the frames that differ from the background nearly everywhere


@dataclass(frozen=True, eq=False)
class MeanImage:
    """A mean image without the smooth light that waits to become background: (H, W, 3), in 1/256 gray level."""

    start_s: float
    end_s: float
    image: NDArray[np.uint16]


class BackgroundDrift:
    """The current background; a function of the sequence of images and results.

    It begins with `background` (H, W, 3), 0-255. One that is taken is compared with the calibration's, `calibrated`, by
    default the same.
    """

    def __init__(self, background: Map, calibrated: Map | None = None) -> None:
        self.start = background
        self._calibrated = background if calibrated is None else calibrated
        # Whether the background that was asked for last was not taken, because something touches the gel.
        self.refused: tuple[Finding, ...] = ()
        self._local = background.astype(np.float32)
        self._local_blocks = block_means(self._local)
        self.light = np.zeros((3, 4))  # the followed light relative to the start, as in `lit`
        # Light of the last second relative to the current background, which can follow it only where nothing touches.
        self.usual: FrameLight | None = None
        self.touched = Touched(self._local_blocks.shape[:2])
        self._mean: Map | None = None
        self._waiting: deque[MeanImage] = deque()
        self._last_s: float | None = None
        self._asked = self._taking = False
        self._contact_long = np.zeros(background.shape[:2], dtype=bool)
        self.evidence: DriftEvidence | None = None  # of the last complete ten seconds
        self._start_anew(0.0)

    @property
    def gains(self) -> Numbers:
        """The mean light of each channel (3,) relative to the start."""
        rest = self._local_blocks
        return np.asarray(lit(rest, self.light).mean(axis=(0, 1)) / rest.mean(axis=(0, 1)), dtype=np.float64)

    def take(self) -> None:
        """Take the mean of the next second as background, because nothing touches now. May be called from any thread."""
        self._asked = True

    def __call__(self, image: Array, result: Reconstruction) -> Map | None:
        """Learn from a frame; the background (H, W, 3) if it has changed, else None."""
        time_s = result.time_s or 0.0
        # After 5 s without a frame the past is unknown.
        if self._last_s is None or not 0 <= time_s - self._last_s <= 5.0:
            self.touched.everywhere(time_s)
            self._forget(time_s)
        self._last_s = time_s
        if self._asked:
            self._asked, self._taking, self.refused = False, True, ()
            self._start_anew(time_s)
        names = {finding.name for finding in result.health}
        if names & NO_MEASURE:
            self._contact |= True
            return None
        self._blocks += block_means(image)
        self._count += 1
        cv2.accumulate(image, self._sum)
        self._sum_count += 1
        self._contact |= result.contact
        self._contact_long |= result.contact
        if names & DIFFERENT:
            self._contact |= True
            self._different += 1
        if time_s - self._step_s < STEP_S:
            return None
        return self._taken(time_s) if self._taking else self._step(time_s)

    def _taken(self, time_s: float) -> Map | None:
        """Start again from the mean of the frames since the request; None if something touches the gel in it."""
        self._taking = False
        mean = self._sum / np.float32(self._sum_count)
        try:
            check_untouched(mean, self._calibrated, self._contact)
        except CalibrationError as touched:
            message = f"The background was not taken. {touched}"
            self.refused = (Finding("background_refused", message, 1.0),)
            self._start_anew(time_s)
            return None
        self.start = self._local = mean
        self._local_blocks = block_means(self._local)
        self.light, self.usual = np.zeros((3, 4)), None
        self.touched.everywhere(-np.inf)
        self._forget(time_s)
        return self._local.copy()

    def _forget(self, time_s: float) -> None:
        """Start anew, without what was averaged or waits."""
        self._waiting.clear()
        self._mean = None
        self._start_anew(time_s)

    def _start_anew(self, time_s: float) -> None:
        """Start a new step and a new mean image."""
        self._step_s = self._mean_image_s = time_s
        self._blocks = np.zeros_like(self._local_blocks)
        self._contact = np.zeros(self._local.shape[:2], dtype=bool)
        self._sum = np.zeros_like(self._local)
        self._count = self._sum_count = self._different = 0

    def _step(self, time_s: float) -> Map | None:
        """Fit the light, mark touched blocks, and add the mean images that have waited long enough."""
        step_s, blocks = time_s - self._step_s, self._blocks * np.float32(1 / self._count)
        size = blocks.shape[1::-1]
        contact = cv2.resize(self._contact.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0
        free = self.touched.not_since(time_s - MEAN_S) & ~contact
        if self._mean is None:
            self._mean = blocks
        else:
            self._mean += np.float32(-np.expm1(-step_s / MEAN_S)) * (blocks - self._mean)
        self._follow(np.where(free[..., None], self._mean, np.float32(0)), free.mean())
        now = lit(self._local_blocks, self._now)
        self.touched.mark(time_s, step_s, contact, blocks / now - 1, now)
        if time_s - self._mean_image_s >= MEAN_IMAGE_S:
            self._keep_mean_image(time_s)
        self._take_in(time_s)
        self._step_s = time_s
        self._blocks[:], self._count = 0, 0
        self._contact[:] = False
        # The fitted light can exceed a camera's largest gray level.
        return np.asarray(np.clip(lit(self._local, self.light), 0, 255), dtype=np.float32)

    def _follow(self, blocks: Map, free: float) -> None:
        """Follow the light of blocks (h, w, 3), of which this part is free of contact and the others are 0."""
        untouched = self._local_blocks
        usual = light_from_blocks(blocks, lit(untouched, self.light), self.usual)
        self.usual = usual if usual.is_known else None
        if free >= LEAST_FREE and self.usual is not None:
            self.light, self.usual = light_at_rest(blocks, untouched, self._now), None

    @property
    def _now(self) -> Numbers:
        """The light relative to the start, in parts followed, in parts only known."""
        return self.light if self.usual is None else self.light + self.usual.values

    def _keep_mean_image(self, time_s: float) -> None:
        mean = self._sum * np.float32(1 / self._sum_count)
        touched = (~self.touched.not_since(self._mean_image_s)).astype(np.uint8)
        shape = self._local.shape[1::-1]
        self.evidence = DriftEvidence(
            image=mean,
            start=self.start,
            lit=lit(self.start, self._now),
            touched=cv2.resize(touched, shape, interpolation=cv2.INTER_NEAREST).astype(bool),
            contact=self._contact_long.copy(),
            different=self._different / self._sum_count,
        )
        image = without_light(mean, self.light) * np.float32(PER_GRAY_LEVEL)
        levels = np.clip(np.rint(image), 0, 255 * PER_GRAY_LEVEL).astype(np.uint16)
        self._waiting.append(MeanImage(self._mean_image_s, time_s, levels))
        self._mean_image_s = time_s
        self._sum[:], self._sum_count, self._different = 0, 0, 0
        self._contact_long[:] = False

    def _take_in(self, time_s: float) -> None:
        """Add mean images that have waited to the background, where nothing touched around their time."""
        while self._waiting and self._waiting[0].end_s + AFTER_S <= time_s:
            waited = self._waiting.popleft()
            free = self.touched.not_since(waited.start_s - BEFORE_S).astype(np.float32)
            fraction = cv2.resize(free, self._local.shape[1::-1], interpolation=cv2.INTER_LINEAR)
            span_s = waited.end_s - waited.start_s
            fraction *= np.float32(-np.expm1(-span_s / FOLLOW_S))
            image = waited.image.astype(np.float32) * np.float32(1 / PER_GRAY_LEVEL)
            self._local += fraction[..., None] * (image - self._local)
            self._local_blocks = block_means(self._local)


class Touched:
    """The time of the last touch, or possible touch, of each block of a grid (h, w)."""

    def __init__(self, blocks: tuple[int, ...]) -> None:
        self._last_s = np.full(blocks, -np.inf)
        self._long = np.zeros((*blocks, 3), dtype=np.float32)
        reach = max(1, round(MARGIN * min(blocks)))
        self._kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * reach + 1,) * 2)

    def mark(self, time_s: float, step_s: float, contact: Mask, change: Map, untouched: Map) -> None:
        """Find and remember the blocks (h, w) that may be touched at this time, `step_s` after the last, with the margin.

        Those are blocks in which a frame shows contact, and those whose brightness stands out from all blocks, in the last
        second or in the mean of about ten. `change` (h, w, 3) is relative, against the background in the current light, of
        which `untouched` (h, w, 3) has the gray levels.
        """
        slight = np.clip(change, -MOST_CHANGE, MOST_CHANGE)
        self._long += np.float32(-np.expm1(-step_s / LONG_S)) * (slight - self._long)
        touched = contact | _stands_out(change, untouched) | _stands_out(self._long, untouched)
        self._last_s[cv2.dilate(touched.astype(np.uint8), self._kernel) > 0] = time_s

    def everywhere(self, time_s: float) -> None:
        """Mark every block as touched at that time, because no frame was available; -inf: forget all touches."""
        self._last_s[:] = time_s

    def not_since(self, time_s: float) -> Mask:
        """The blocks (h, w) without a touch since that time."""
        return self._last_s < time_s


def _stands_out(change: Map, untouched: Map) -> Mask:
    """The blocks (h, w) that changed by more than drift and noise; noise is equal in gray levels."""
    size = np.abs(change)
    levels = size * untouched
    noise = robust_sigma(levels, axis=(0, 1))
    odd = (levels > TOUCH_SIGMAS * noise) & (size > LEAST_CHANGE)
    return np.asarray(odd.any(axis=-1))
