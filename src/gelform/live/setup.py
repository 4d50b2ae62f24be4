"""The setup of a station's reconstruction: calibration, background, solver, zero; immutable."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import Calibration
from gelform.depth.contact import contact_from_depth
from gelform.foundations.checks import check_mm_per_px
from gelform.image.frame import Frame
from gelform.image.view import View, image_from_frame
from gelform.reconstruct import Reconstructor
from gelform.result import Reconstruction
from gelform.sensors.streams.memory import Memory, of_frame, result_from_image

BACKGROUND_FRAMES = 15  # frames at rest that are averaged


@dataclass(frozen=True)
class Setup:
    """Everything that turns a frame into the displayed result.

    Attributes
    ----------
    memory : the Reconstructor with the memory of the sequence; None without a calibration: only the image is shown
    name : of the calibration, in the page's list
    solver : the chosen one, "auto" by default
    background : (H, W, 3) float32 taken live, or None: the calibration's own
    zero_mm : (H, W) depth that is subtracted from every result, or None
    """

    memory: Memory | None = None
    name: str = ""
    solver: str = "auto"
    background: NDArray[np.float32] | None = None
    zero_mm: NDArray[np.float32] | None = None

    @property
    def reconstruct(self) -> Reconstructor | None:
        """The Reconstructor for the coming frames; None without a calibration."""
        return None if self.memory is None else self.memory.reconstruct

    @property
    def calibration(self) -> Calibration | None:
        """The calibration in use."""
        return None if self.reconstruct is None else self.reconstruct.calibration

    def image_of(self, frame: Frame) -> NDArray[np.uint8]:
        """The frame through the view; unchanged without a calibration."""
        view = View() if self.calibration is None else self.calibration.view
        return np.ascontiguousarray(image_from_frame(frame.image, view), dtype=np.uint8)

    def result_of(
        self, frame: Frame, image: NDArray[np.uint8], *, alone: bool = False
    ) -> Reconstruction | None:
        """The calibration's result of an image, against the background; None without a calibration.

        Parameters
        ----------
        alone : whether to reconstruct the frame without memory, as for a recording, whose frames may come in any order
        """
        if self.memory is None:
            return None
        if alone:
            return of_frame(result_from_image(self.memory.reconstruct, image), frame)
        return self.memory.remembered(image, of_frame(self.memory.result_from_image(image), frame))

    def against_zero(self, result: Reconstruction) -> Reconstruction:
        """The result relative to the chosen zero."""
        if self.zero_mm is None or self.zero_mm.shape != result.depth.shape:
            return result
        depth = result.depth - self.zero_mm
        pitch = 1.0 if result.mm_per_px is None else check_mm_per_px(result.mm_per_px)
        known = None if self.calibration is None else self.calibration.settings.relaxation_mm
        contact = contact_from_depth(depth, mm_per_px=pitch, relaxation_mm=known)
        return replace(result, depth=depth, contact=contact, zero="set")

    # -- another setup ---------------------------------------------------------------------------------------------

    def with_calibration(
        self, calibration: Calibration, name: str, background: NDArray[np.float32] | None = None
    ) -> Setup:
        """A setup with another calibration, and its own background or one taken live."""
        run = Reconstructor(calibration, background=background, solver=self.solver)
        return Setup(Memory(run), name, self.solver, background)

    def with_background(self, background: NDArray[np.float32] | None) -> Setup:
        """A setup with a new background; None: the calibration's own.

        Raises
        ------
        CalibrationError
            The background is not of the calibrated sensor.
        """
        return replace(self, background=background, zero_mm=None).anew()

    def with_solver(self, solver: str) -> Setup:
        """A setup with another solver."""
        return replace(self, solver=solver, zero_mm=None).anew()

    def anew(self) -> Setup:
        """A setup for another sequence of frames, without memory."""
        if self.calibration is None:
            return self
        run = Reconstructor(self.calibration, background=self.background, solver=self.solver)
        return replace(self, memory=Memory(run))
