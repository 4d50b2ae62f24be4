"""A stream without a calibration: its first frames give the background image, which makes one from a starter."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.starters import Starter, load_starter
from gelform.calibration_file import Calibration
from gelform.errors import CalibrationError, DataError, GelformError, StaleError
from gelform.image.background.average import USUAL_FRAMES, background_from_frames
from gelform.image.frame import Frame
from gelform.image.view import View, image_from_frame
from gelform.reconstruct import Reconstructor
from gelform.sensors.grabber import Grabber
from gelform.sensors.source import Source
from gelform.sensors.streams.feed import Feed
from gelform.sensors.streams.memory import Memory, StreamFrame, Timed, Work

STEADY_S = 1.0  # s without motion; a hand that presses cannot keep as still
LEAST = 3  # frames of that second; fewer cannot agree
# Limits of the frames, and of their bytes, that are read of a recording before the first one is given out.
HELD, MAX_BYTES = 15, 192 * 2**20
TOUCH_NOTHING = "Touch nothing: the starter's calibration needs the gel at rest."


class UntouchedImage:
    """The mean of frames without motion.

    Attributes
    ----------
    view : of the frames
    reason : why there is no mean yet, as a sentence
    """

    def __init__(self, starter: Starter) -> None:
        self.view, self.reason = View(), TOUCH_NOTHING
        self._starter = starter
        self._shape: tuple[int, ...] = ()
        self._images: deque[tuple[float, NDArray[Any]]] = deque()

    def keep(self, frame: Frame) -> bool:
        """Add a frame; True once a whole second of them is there.

        Raises
        ------
        SensorError
            The frame has another aspect ratio than those of the make.
        """
        height, width = frame.image.shape[:2]
        if (height, width) != self._shape:  # the camera's mode has changed: earlier frames have another view
            self._shape, self.view = (height, width), self._starter.view((height, width))
            self._images.clear()
        self._images.append((frame.time_s, image_from_frame(frame.image, self.view)))
        return len(self._images) >= LEAST and frame.time_s - self._images[0][0] >= STEADY_S

    def mean(self) -> NDArray[np.float32] | None:
        """The mean (H, W, 3) of the frames; None if they disagree, and then the first half is dropped."""
        stride = max(1, len(self._images) // USUAL_FRAMES)
        chosen = [image for _, image in list(self._images)[::-stride]]
        try:
            taken = background_from_frames(chosen)
        except DataError:
            said = "Most frames differ"
        else:
            if not taken.left_out:
                return taken.background
            said = f"{len(taken.left_out)} of {len(chosen)} frames differ"
        self.reason = f"Something moves on the gel, or its light changes ({said}). {TOUCH_NOTHING}"
        for _ in range(len(self._images) // 2 + 1):
            self._images.popleft()
        return None


def calibration_at_rest(
    sensor: str, frames: Iterable[Frame], serial: str | None, before: Calibration | None
) -> Calibration:
    """The calibration of a unit from frames of its gel at rest.

    Parameters
    ----------
    sensor : the starter's name
    before : the calibration in use; a scale that the user gave to a starter's calibration is kept

    Raises
    ------
    GelformError
        Something moved, or the gel's light is not that of the make.
    """
    starter = load_starter(sensor)
    untouched = UntouchedImage(starter)
    for frame in frames:
        untouched.keep(frame)
    image = untouched.mean()
    if image is None:
        raise GelformError(untouched.reason)
    # Whole gray levels, so that the background in a recording is exactly the image in use.
    pitch = _own_pitch(starter, before)
    return starter.for_unit(np.rint(image), view=untouched.view, mm_per_px=pitch, serial=serial)


def _own_pitch(starter: Starter, before: Calibration | None) -> float | None:
    """The scale of a starter's calibration of the same make, if it differs from the make's."""
    record = None if before is None else before.settings.starter
    if before is None or record is None or record["sensor"] != starter.sensor:
        return None
    return None if before.mm_per_px == starter.calibration.mm_per_px else before.mm_per_px


class UntouchedFirst:
    """A feed that starts once the gel was at rest; of a recording every frame is then given.

    Parameters
    ----------
    feed : of the sensor
    starter : of its make
    begin : called with the calibration, before the first frame is given
    """

    def __init__(self, feed: Feed, starter: Starter, begin: Callable[[Calibration], None]) -> None:
        self.every = feed.every
        self.camera: Source | Grabber = feed.camera
        self._feed, self._starter, self._begin = feed, starter, begin
        self._untouched = UntouchedImage(starter)
        self._held: deque[Frame] = deque()
        self._after, self._begun = -1, False

    @property
    def state(self) -> str:
        return "starting" if not self._begun and self._feed.state == "running" else self._feed.state

    @property
    def reason(self) -> str:
        return self._untouched.reason if self.state == "starting" else self._feed.reason

    @property
    def skipped(self) -> int:
        return self._feed.skipped

    def next(self, after_index: int) -> Frame | None:
        """As the feed's; None while it waits for the gel at rest.

        Raises
        ------
        CalibrationError
            The background image is of another make, or a recording does not begin with the gel at rest.
        """
        if not self._begun:
            self._look()
        if not self._begun:
            return None
        return self._held.popleft() if self._held else self._feed.next(after_index)

    def close(self) -> None:
        self._feed.close()

    def _look(self) -> None:
        """Look at one frame of a sensor, or at the first ones of a recording."""
        ready = self._hold() if self.every else self._see_next()
        image = self._untouched.mean() if ready else None
        if image is not None:
            made = self._starter.for_unit(image, view=self._untouched.view, serial=self.camera.serial)
            self._begin(made)
            self._begun = True
        elif self.every or self._feed.state == "ended":
            raise CalibrationError(
                f"Expected the gel at rest in the first frames, to make a calibration of the {self._starter.make} from it. "
                f"{self._untouched.reason} Or give a background image with background= (--background)."
            )

    def _see_next(self) -> bool:
        frame = self._feed.next(self._after)
        if frame is None:
            return False
        self._after = frame.index
        return self._untouched.keep(frame)

    def _hold(self) -> bool:
        while len(self._held) < HELD and sum(one.image.nbytes for one in self._held) < MAX_BYTES:
            frame = self._feed.next(-1)
            if frame is None:
                break
            self._held.append(frame)
            self._untouched.keep(frame)
        return bool(self._held)


class LaterMemory:
    """The memory of a sequence whose first frames make its calibration, as a `Pipeline` runs it.

    Parameters
    ----------
    made : makes the `Memory` from a Reconstructor
    """

    def __init__(self, made: Callable[[Reconstructor], Memory]) -> None:
        self._made = made
        self._memory: Memory | None = None
        self._examine: Callable[[Work], None] | None = None

    def begin(self, calibration: Calibration) -> None:
        """Reconstruct the sequence with this calibration from now on."""
        memory = self._made(Reconstructor(calibration))
        if self._examine is not None:
            memory.run_by(self._examine)
        self._memory = memory

    @property
    def memory(self) -> Memory:
        """The memory of the sequence.

        Raises
        ------
        StaleError
            The gel was not at rest yet.
        """
        if self._memory is None:
            raise StaleError(f"The stream is starting. {TOUCH_NOTHING}")
        return self._memory

    @property
    def reconstruct(self) -> Reconstructor:
        """The memory's Reconstructor."""
        return self.memory.reconstruct

    def run_by(self, examine: Callable[[Work], None]) -> None:
        """As `Memory.run_by`."""
        self._examine = examine

    def reconstructed(self, frame: Frame, timed: Timed) -> StreamFrame:
        """As `Memory.reconstructed`."""
        return self.memory.reconstructed(frame, timed)

    def learn_from(self, given: StreamFrame) -> None:
        """As `Memory.learn_from`."""
        self.memory.learn_from(given)

    def take_background(self) -> None:
        """As `Memory.take_background`.

        Does nothing before there is a calibration, because the gel at rest is awaited anyway.
        """
        if self._memory is not None:
            self._memory.take_background()
