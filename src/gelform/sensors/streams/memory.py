"""The memory of one sequence of frames, around a Reconstructor, which itself has none; and depth averaged over it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import cv2
import numpy as np

from gelform import CalibrationError, Frame, MarkerTracker, Reconstruction, Reconstructor, contact_from_depth
from gelform.arrays import Array, Map, Mask
from gelform.errors import Finding
from gelform.foundations.checks import check_within
from gelform.foundations.filters import robust_sigma
from gelform.foundations.pool import once
from gelform.image import view
from gelform.image.health import DepthLimit
from gelform.image.markers import MarkerFlow
from gelform.result import ShapeErrors
from gelform.result.maps import BESIDE_DEPTH
from gelform.sensors.playback import Every
from gelform.sensors.streams.sensor_health import (
    FROZEN,
    FROZEN_S,
    BackgroundDrift,
    DriftEvidence,
    Examination,
    Frozen,
    light_findings,
)
from gelform.slopes.gradients import STEEPEST_GEL, slopes_of_solution

STILL, MOVING = 2.0, 4.0  # standard deviations of noise: a change is averaged below, followed above


class Smoothing:
    """A running mean of depth per pixel, with exponentially falling weights.

    The delay of the mean is the time constant, s. If the change within a square of 5 px exceeds 4 times the noise of two
    frames, the mean of that pixel starts again without delay. Between 2 and 4 times it restarts in part.
    """

    def __init__(self, time_s: float) -> None:
        self.time_s = check_within(time_s, "smoothing", 0, 60)
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
        mean, solved = self._mean.copy(), self._mean.copy()  # the caller may write to the result's
        pitch = result.mm_per_px or 1.0
        pitches = (pitch, pitch) if isinstance(pitch, float) else pitch
        sigma = once(partial(_less_noise, result, self._left, self._noise))
        slopes = once(partial(slopes_of_solution, solved, pitches))
        return result.changed(depth=mean, depth_sigma_mm=sigma, gradients=slopes)

    def _update(self, depth: Map, step_s: float) -> None:
        sample = (depth - self._last)[::4, ::4]  # is enough to measure the noise
        noise = float(robust_sigma(sample)) / math.sqrt(2)
        self._noise = noise if self._noise == 0 else self._noise + 0.1 * (noise - self._noise)
        change = depth - self._mean
        moves = np.abs(cv2.blur(change, (5, 5)))  # noise is correlated over some pixels
        moves *= np.float32(1 / max(math.sqrt(2) * self._noise, 1e-9))
        moves -= np.float32(STILL)
        moves *= np.float32(1 / (MOVING - STILL))
        # In a mean of n frames the next frame has the weight 1/(n + 1): the mean of a pixel that came to rest grows.
        least = self._left / (1 + self._left)
        weight = np.clip(np.maximum(moves, least), -math.expm1(-step_s / max(self.time_s, 1e-9)), 1)
        self._mean += weight * change
        self._left = np.square(1 - weight) * self._left + np.square(weight)


def _less_noise(result: Reconstruction, left: Map, noise: float) -> Map | None:
    """The standard deviation of a result's depth without the noise that is averaged away."""
    sigma = result.depth_sigma_mm
    if sigma is None:
        return None
    averaged_away = np.float32(noise**2) * (1 - left)
    least = left * np.square(sigma)  # if all of sigma is noise of frames
    return np.asarray(np.sqrt(np.maximum(np.square(sigma) - averaged_away, least)))


NOT_THIS_GEL = "not_this_gel"
# s between the frames of a sensor whose findings are looked for, unless somebody reads those of each one: eight a second.
# The memory learns means over a second and more, and a camera that hangs is the finding that comes first.
LOOK_S = FROZEN_S / 2
ZERO_SET = "set"  # `Reconstruction.zero` of a depth against a zero that a user set

Work = Callable[[], Any]
Timed = Callable[[str], AbstractContextManager[None]]


@dataclass(frozen=True, eq=False)
class StreamFrame:
    """A result and its image."""

    image: Array  # (H, W, 3), RGB, after the calibration's view
    result: Reconstruction
    index: int  # number of the frame; increasing
    time_s: float  # capture time, on the clock of `time.monotonic()`
    frame: Frame  # from the source, before the view
    against_rest: Reconstruction  # from which the memory learns; another than `result` only if a zero was set


class Memory:
    """A function of the images and results of one sequence, in order; times come from the frames.

    It begins with the Reconstructor's background. `smoothing` has a time constant, s. `standing` returns the current
    findings about the source, such as a camera whose settings differ from the calibration's. It learns from a
    frame every `look_s`, and from each one of a background that is asked for.
    """

    def __init__(
        self,
        reconstruct: Reconstructor,
        *,
        smoothing: float | None = None,
        standing: Callable[[], tuple[Finding, ...]] = tuple,
        look_s: float = 0.0,
    ) -> None:
        self.reconstruct, self.standing = reconstruct, standing  # for the coming frames
        self._looks = Every(look_s)
        # Its depth counts as 0: `zero_from_results`; None: the gel at rest.
        self.zero: Reconstruction | None = None
        # Makes slow work; another function may make it elsewhere.
        self.examine: Callable[[Work], None] = lambda work: work()
        self._frozen, self._examination = Frozen(), Examination()
        self._examined: DriftEvidence | None = None
        self._light: tuple[Finding, ...] = ()
        self._examined_findings: tuple[Finding, ...] = ()
        self._markers = MarkerTracker(reconstruct.markers)
        self._drift = BackgroundDrift(reconstruct.background, reconstruct.calibration.background)
        self._smoothing = None if smoothing is None else Smoothing(smoothing)

    def take_background(self) -> None:
        """Take the next frames as background, because nothing touches now. May be called from any thread.

        If something touches the gel, or the frames disagree, it stays, and results have the finding `background_refused`.
        """
        self._drift.asked = True

    @property
    def background_request(self) -> tuple[bool, tuple[Finding, ...]]:
        """Whether the last request for a background is not decided yet; what was found in the one before it."""
        return self._drift.taking, self._drift.doubts

    def image_from_frame(self, frame: Frame) -> Array:
        """The calibration's view of a frame; ValueError if the frame has another size."""
        calibration = self.reconstruct.calibration
        expected, given = calibration.view.frame_shape or calibration.image_shape, frame.image.shape[:2]
        if given not in (expected, calibration.image_shape):
            raise ValueError(
                f"Frame {frame.index}: Expected frames of {expected[0]}x{expected[1]} px (height x width) as at the "
                f"calibration, got {given[0]}x{given[1]}. "
                "Set the camera's width and height as they were then, or calibrate with these frames."
            )
        return view.image_from_frame(frame.image, calibration.view)

    def result_from_image(self, image: Array) -> Reconstruction:
        """Reconstruct an image with the current knowledge of the sequence; markers are tracked from image to image."""
        return result_from_image(self.reconstruct, image, self._markers.update(image))

    def __call__(self, image: Array, result: Reconstruction) -> Reconstruction:
        """`remembered`, then `learn`, for callers that can wait for both."""
        result = self.remembered(image, result)
        self.learn(image, result)
        return result

    def reconstructed(
        self, frame: Frame, timed: Timed = lambda _: nullcontext(), *, alone: bool = False
    ) -> StreamFrame:
        """The result of a frame, after `remembered`, against the zero; `timed(stage)` times a block.

        `alone` leaves the sequence's findings, markers and smoothing out, as for a frame of a recording, whose frames may
        come in any order.
        """
        with timed("view"):
            image = self.image_from_frame(frame)
        with timed("reconstruct"):
            found = result_from_image(self.reconstruct, image) if alone else self.result_from_image(image)
            found = of_frame(found, frame)
        with timed("remember"):
            found = found if alone else self.remembered(image, found)
            relaxation_mm = self.reconstruct.calibration.settings.relaxation_mm
            result = found if self.zero is None else against_zero(found, self.zero, relaxation_mm)
        return StreamFrame(image, result, frame.index, frame.time_s, frame, found)

    def learn_from(self, given: StreamFrame) -> None:
        """Run `learn` on a result of `reconstructed`."""
        self.learn(given.image, given.against_rest)

    def remembered(self, image: Array, result: Reconstruction) -> Reconstruction:
        """The result with the findings and the smoothing of the sequence."""
        frozen = self._frozen(image, result.time_s or 0.0)
        standing = (*self.standing(), *self._light, *self._drift.doubts, *self._examined_findings)

        def health() -> tuple[Finding, ...]:
            own = {finding.name for finding in result.health}
            return (*result.health, *frozen, *(finding for finding in standing if finding.name not in own))

        found = result.changed(health=once(health))
        if frozen:  # the image is a hanging camera's: depth stays, but is known nowhere
            nothing = _unusable(self.reconstruct, found.health[-1])
            return found.changed(
                depth_sigma_mm=None if found.depth_sigma_mm is None else nothing.depth_sigma_mm,
                gradients_sigma=nothing.gradients_sigma,
                confidence=nothing.confidence,
                known=nothing.known,
            )
        return found if self._smoothing is None else self._smoothing(found)

    def learn(self, image: Array, result: Reconstruction) -> None:
        """Learn from a remembered result for the coming frames; takes some ms once a second.

        It may run in another thread than the frames, which then run a frame or two ahead.
        """
        if not (self._looks(result.time_s or 0.0) or self._drift.taking):
            return
        if any(finding.name == FROZEN for finding in result.health):
            return
        background = self._drift(image, result)
        if background is not None:
            newer = background, self._drift.usual, self._drift.findings
            self.reconstruct = self.reconstruct.with_background(*newer)
            self._light = light_findings(self._drift.gains)
        if self._drift.evidence is not self._examined:
            self._examined = self._drift.evidence
            self.examine(self._examine_evidence)

    def _examine_evidence(self) -> None:
        if (evidence := self._examined) is not None:
            self._examined_findings = self._examination(evidence)


def zero_from_results(results: Sequence[Reconstruction]) -> Reconstruction:
    """A zero for depth: the mean of results. It is as uncertain as the last one, because most of its error is common."""
    last = results[-1]
    means = {
        name: np.mean([getattr(one, name) for one in results], axis=0).astype(np.float32)
        for name in ("depth", "gradients", "observed_gradients")
        if getattr(last, name) is not None
    }
    return last.changed(known=np.all([one.known for one in results], axis=0), **means)


def against_zero(
    result: Reconstruction, zero: Reconstruction, relaxation_mm: float | None = None
) -> Reconstruction:
    """A result relative to another one of the same sensor: depth, slopes, their deviations and the contact.

    Both are against the gel at rest, whose `relaxation_mm` is that of `contact_from_depth`.
    """
    depth, known = result.depth - zero.depth, result.known & zero.known
    sigma = once(lambda: _both(result.depth_sigma_mm, zero.depth_sigma_mm))
    pitch = 1.0 if result.mm_per_px is None else result.mm_per_px
    solved = depth.copy()  # the caller may write to the result's

    def contact() -> Mask:
        how: dict[str, Any] = {"mm_per_px": pitch, "depth_sigma_mm": sigma(), "relaxation_mm": relaxation_mm}
        return contact_from_depth(solved, **how) & known

    observed = result.observed_gradients
    if observed is not None and zero.observed_gradients is not None:
        observed = observed - zero.observed_gradients
    return result.changed(
        depth=depth,
        depth_sigma_mm=sigma,
        gradients=once(lambda: result.gradients - zero.gradients),
        gradients_sigma=once(lambda: _both(result.gradients_sigma, zero.gradients_sigma)),
        observed_gradients=observed,
        contact=once(contact),
        known=known,
        zero=ZERO_SET,
        shape_errors=once(lambda: _both_shapes(result.shape_errors, zero.shape_errors)),
    )


def _both(one: Map | None, other: Map | None) -> Map | None:
    """The standard deviation of a difference; None if one is unknown."""
    return None if one is None or other is None else np.hypot(one, other)


def _both_shapes(one: ShapeErrors | None, other: ShapeErrors | None) -> ShapeErrors | None:
    """The errors of a difference, whose slopes are off by either; None if one is unknown."""
    if one is None or other is None:
        return None
    variance, common = (
        np.concatenate([getattr(x, n) for x in (one, other)]) for n in ("variance", "common_mm")
    )
    return replace(one, variance=variance, common_mm=common)


def of_frame(result: Reconstruction, frame: Frame) -> Reconstruction:
    """The result with the number and the times of its frame."""
    return result.changed(index=frame.index, time_s=frame.time_s, wall_time_ns=frame.wall_time_ns)


def result_from_image(
    reconstruct: Reconstructor, image: Array, markers: MarkerFlow | None = None
) -> Reconstruction:
    """The result of an image; if the Reconstructor refuses the image, a result in which nothing is known.

    A frame that is clearly not of the calibrated gel (the gel was removed, a light failed) must not end a sequence.
    The finding `not_this_gel` holds the text of the refusal.

    ValueError, TypeError: as `Reconstructor.from_image`: the source's images do not have the calibrated size.
    """
    try:
        return reconstruct.from_image(image, markers=markers)
    except CalibrationError as refusal:
        return _unusable(reconstruct, Finding(NOT_THIS_GEL, str(refusal), 1.0))


def _unusable(reconstruct: Reconstructor, finding: Finding) -> Reconstruction:
    """A result of depth 0 that is known nowhere; its sigma is that of a depth known only by its limits."""
    calibration = reconstruct.calibration
    shape, pitch = calibration.image_shape, calibration.mm_per_px
    nothing: dict[str, Any] = {
        one.name: np.zeros((*shape, *one.axes), one.dtype) for one in BESIDE_DEPTH if not one.optional
    }
    sigma = None if pitch is None else np.full(shape, DepthLimit.of(shape, pitch).ignorance_mm, np.float32)
    return Reconstruction(
        depth=np.zeros(shape, np.float32),
        depth_sigma_mm=sigma,
        gradients_sigma=np.full((*shape, 2), STEEPEST_GEL, np.float32),
        **nothing,
        mm_per_px=pitch,
        mm_per_px_sigma=calibration.mm_per_px_sigma,
        health=(*reconstruct.findings, finding),
        calibration_digest=calibration.digest,
    )
