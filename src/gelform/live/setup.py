"""How a station reconstructs: calibration, background, solver, zero; replaced whole, never changed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gelform.calibration_file import Calibration
from gelform.contact import contact_from_depth
from gelform.errors import GelformError
from gelform.foundations.checks import check_mm_per_px
from gelform.frames import Frame
from gelform.reconstruct import Reconstructor
from gelform.reconstruction import Reconstruction
from gelform.streams.memory import Memory, of_frame, result_from_image
from gelform.view import View, image_from_frame

BACKGROUND_FRAMES = 15  # of the untouched gel that are averaged


@dataclass(frozen=True)
class Setup:
    """What turns a frame into what is shown.

    Attributes
    ----------
    memory : the Reconstructor with what the sequence has taught it; None without a calibration: the image alone is shown
    name : of the calibration, as the page lists it
    solver : as it was asked for, "auto" by default
    background : (H, W, 3) float32 that was taken live, or None: the calibration's own
    zero_mm : (H, W) depth that is taken off every result, or None
    other, other_name : the calibration that it is compared with
    """

    memory: Memory | None = None
    name: str = ""
    solver: str = "auto"
    background: NDArray[np.float32] | None = None
    zero_mm: NDArray[np.float32] | None = None
    other: Reconstructor | None = None
    other_name: str = ""

    @property
    def reconstruct(self) -> Reconstructor | None:
        """For the frames to come; None without a calibration."""
        return None if self.memory is None else self.memory.reconstruct

    @property
    def calibration(self) -> Calibration | None:
        """The calibration in use."""
        return None if self.reconstruct is None else self.reconstruct.calibration

    def image_of(self, frame: Frame) -> NDArray[np.uint8]:
        """The frame through the view; as it is without a calibration."""
        view = View() if self.calibration is None else self.calibration.view
        return np.ascontiguousarray(image_from_frame(frame.image, view), dtype=np.uint8)

    def result_of(
        self, frame: Frame, image: NDArray[np.uint8], *, alone: bool = False
    ) -> Reconstruction | None:
        """What the calibration says of the image, against the untouched gel; None without a calibration.

        Parameters
        ----------
        alone : whether the frame is reconstructed for itself, as one of a recording: it may come again, and the next one
            may be an earlier one
        """
        if self.memory is None:
            return None
        if alone:
            return of_frame(result_from_image(self.memory.reconstruct, image), frame)
        return self.memory.remembered(image, of_frame(self.memory.result_from_image(image), frame))

    def other_of(self, frame: Frame) -> Reconstruction | None:
        """What the other calibration says of the same frame; None where it cannot, or there is none."""
        if self.other is None:
            return None
        try:
            return self.other(frame)
        except (GelformError, ValueError):
            return None

    def against_zero(self, result: Reconstruction) -> Reconstruction:
        """The result against the zero that was set."""
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
        """The same with another calibration, its own background or one that was taken live, nothing compared."""
        run = Reconstructor(calibration, background=background, solver=self.solver)
        return Setup(Memory(run), name, self.solver, background)

    def with_background(self, background: NDArray[np.float32] | None) -> Setup:
        """The same with today's background; None: the calibration's own.

        Raises
        ------
        CalibrationError
            It is not of the calibrated sensor.
        """
        return replace(self, background=background, zero_mm=None).anew()

    def with_solver(self, solver: str) -> Setup:
        """The same with another solver."""
        return replace(self, solver=solver, zero_mm=None).anew()

    def anew(self) -> Setup:
        """The same for another sequence of frames: what the last one has taught is forgotten."""
        if self.calibration is None:
            return self
        run = Reconstructor(self.calibration, background=self.background, solver=self.solver)
        return replace(self, memory=Memory(run))

    def with_other(self, calibration: Calibration | None, name: str) -> Setup:
        """The same, compared with another calibration, or with none."""
        run = None if calibration is None else Reconstructor(calibration, solver=self.solver)
        return replace(self, other=run, other_name=name if run else "")
