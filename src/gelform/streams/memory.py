"""All that one sequence of frames has taught: what is around a Reconstructor, which itself remembers nothing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from gelform import view
from gelform.findings import Finding
from gelform.frames import Frame
from gelform.markers import MarkerTracker
from gelform.reconstruct import Reconstructor
from gelform.reconstruction import Reconstruction
from gelform.streams.evidence import Evidence
from gelform.streams.health import FROZEN, Examination, Frozen, light_findings
from gelform.streams.rest import BackgroundDrift
from gelform.streams.smoothing import Smoothing
from gelform.streams.unusable import result_from_image, unknown_by_now


class Memory:
    """A function of the images and results of one sequence, in order; it takes its times from the frames.

    Parameters
    ----------
    reconstruct : of the sensor, with the untouched image that the sequence starts from
    smoothing : time constant of the smoothing, s, or None
    standing : gives the findings on the source at this moment, such as a camera that is set otherwise than calibrated

    Attributes
    ----------
    reconstruct : for the frames to come
    """

    def __init__(
        self,
        reconstruct: Reconstructor,
        *,
        smoothing: float | None = None,
        standing: Callable[[], tuple[Finding, ...]] = tuple,
    ) -> None:
        self.reconstruct = reconstruct
        self._examine: Callable[[Callable[[], None]], None] = lambda work: work()
        self._frozen, self._examination = Frozen(), Examination()
        self._examined: Evidence | None = None
        self._standing = standing
        self._light: tuple[Finding, ...] = ()
        self._examined_findings: tuple[Finding, ...] = ()
        self._markers = MarkerTracker(reconstruct.markers)
        self._drift = BackgroundDrift(reconstruct.background)
        self._smoothing = None if smoothing is None else Smoothing(smoothing)

    def examine_by(self, examine: Callable[[Callable[[], None]], None]) -> None:
        """Have what takes too long for a frame run elsewhere: `examine` is given it to call, ten seconds apart."""
        self._examine = examine

    def take_background(self) -> None:
        """Nothing touches now: what the next second shows is the untouched gel. From any thread."""
        self._drift.take()

    def image_from_frame(self, frame: Frame) -> NDArray[Any]:
        """The calibration's view of a frame; ValueError where it is of another size."""
        calibration = self.reconstruct.calibration
        expected, came = calibration.view.frame_shape or calibration.image_shape, frame.image.shape[:2]
        if came != expected:
            raise ValueError(
                f"Expected frames of {expected[0]}x{expected[1]} px (height x width) as at the calibration, got "
                f"{came[0]}x{came[1]}. Set the camera's width and height as they were then, or calibrate with these frames."
            )
        return view.image_from_frame(frame.image, calibration.view)

    def result_from_image(self, image: NDArray[Any]) -> Reconstruction:
        """Reconstruct an image as the sequence is understood now; its marker dots are followed from image to image."""
        return result_from_image(self.reconstruct, image, self._markers.update(image))

    def __call__(self, image: NDArray[Any], result: Reconstruction) -> Reconstruction:
        """`remembered`, then `learn`: for who needs no result sooner than that."""
        result = self.remembered(image, result)
        self.learn(image, result)
        return result

    def remembered(self, image: NDArray[Any], result: Reconstruction) -> Reconstruction:
        """The result with what the sequence adds to it: findings, and smoothing."""
        frozen = self._frozen(image, result.time_s or 0.0)
        result = replace(result, health=(*result.health, *frozen, *self._findings))
        if frozen:
            return unknown_by_now(self.reconstruct, result)
        return result if self._smoothing is None else self._smoothing(result)

    def learn(self, image: NDArray[Any], result: Reconstruction) -> None:
        """Learn for the frames to come from a remembered result; takes some ms once a second.

        May run in another thread than the frames, which then are a frame or two ahead of what was learned.
        """
        if any(finding.name == FROZEN for finding in result.health):
            return
        background = self._drift(image, result)
        if background is not None:
            self.reconstruct = self.reconstruct.with_background(background)
            self._light = light_findings(self._drift.light.gains)
        if self._drift.evidence is not self._examined:
            self._examined = self._drift.evidence
            self._examine(self._examine_evidence)

    @property
    def _findings(self) -> tuple[Finding, ...]:
        return (*self._standing(), *self._light, *self._examined_findings)

    def _examine_evidence(self) -> None:
        if (evidence := self._examined) is not None:
            self._examined_findings = self._examination(evidence)
