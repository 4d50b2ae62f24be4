"""All that one sequence of frames has taught: what is around a Reconstructor, which itself remembers nothing."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from gelform import view
from gelform.frames import Frame
from gelform.markers import MarkerTracker
from gelform.reconstruct import Reconstructor
from gelform.reconstruction import Reconstruction
from gelform.streams.rest import BackgroundDrift
from gelform.streams.smoothing import Smoothing
from gelform.streams.unusable import result_from_image


class Memory:
    """A function of the images and results of one sequence, in order; it takes its times from the frames.

    Parameters
    ----------
    reconstruct : of the sensor, with the untouched image that the sequence starts from
    smoothing : time constant of the smoothing, s, or None

    Attributes
    ----------
    reconstruct : for the frames to come
    """

    def __init__(self, reconstruct: Reconstructor, *, smoothing: float | None = None) -> None:
        self.reconstruct = reconstruct
        self._markers = MarkerTracker(reconstruct.markers)
        self._drift = BackgroundDrift(reconstruct.background)
        self._smoothing = None if smoothing is None else Smoothing(smoothing)

    def take_background(self) -> None:
        """Nothing touches now: what the next second shows is the untouched gel. From any thread."""
        self._drift.take()

    def image_from_frame(self, frame: Frame) -> NDArray[Any]:
        """The calibration's view of a frame; ValueError where it is of another size."""
        return view.image_from_frame(frame.image, self.reconstruct.calibration.view)

    def result_from_image(self, image: NDArray[Any]) -> Reconstruction:
        """Reconstruct an image as the sequence is understood now; its marker dots are followed from image to image."""
        return result_from_image(self.reconstruct, image, self._markers.update(image))

    def __call__(self, image: NDArray[Any], result: Reconstruction) -> Reconstruction:
        """The result with what the sequence adds to it; learns from both."""
        background = self._drift(image, result)
        if background is not None:
            self.reconstruct = self.reconstruct.with_background(background)
        return result if self._smoothing is None else self._smoothing(result)
