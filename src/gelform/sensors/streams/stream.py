"""source -> results: the depth of the newest frame, never a stale one; with a calibration, or from a starter at first."""

from __future__ import annotations

import time
import weakref
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from gelform import (
    Calibration,
    CalibrationError,
    DataError,
    Frame,
    GelformError,
    Grabber,
    Reconstruction,
    Reconstructor,
    StaleError,
    View,
    background_from_frames,
    image_from_frame,
)
from gelform.arrays import Array, Map
from gelform.calibration.library import NoCalibration, choose_calibration, unit_of
from gelform.calibration.starters import Starter, load_starter, starter_names, starter_of_source
from gelform.errors import Finding
from gelform.image.background import MAX_BYTES, USUAL_FRAMES
from gelform.image.light import block_means
from gelform.sensors.grabber import Shared
from gelform.sensors.playback import Closing
from gelform.sensors.source import Source
from gelform.sensors.streams.memory import LOOK_S, Memory, Smoothing, StreamFrame, Timed, Work
from gelform.sensors.streams.pipeline import Feed, Pipeline, SourceLike, StreamStats, feed_from_source
from gelform.sensors.streams.sensor_health import camera_findings

STEADY_S = 1.0  # s without motion; a hand that presses cannot keep as still
LEAST = 3  # frames of that second; fewer cannot agree
HELD = 50  # frames at most that are read of a recording before the first one is given out
KEPT = 8  # results whose images stay available to `image_of`
TOUCH_NOTHING = "Touch nothing: the starter's calibration needs the gel at rest."


class UntouchedImage:
    """The mean of frames without motion, at the starter's size."""

    def __init__(self, starter: Starter) -> None:
        self.view = View()  # of the frames
        self.reason = TOUCH_NOTHING  # why there is no mean yet, as a sentence
        self._starter = starter
        self._shape: tuple[int, ...] = ()
        self._images: deque[tuple[float, Array]] = deque()

    def keep(self, frame: Frame) -> bool:
        """Add a frame; True once a whole second of them is there.

        SensorError: the frame has another aspect ratio than those of the make.
        """
        height, width = frame.image.shape[:2]
        if (height, width) != self._shape:  # the camera's mode has changed: earlier frames have another view
            self._shape, self.view = (height, width), self._starter.view((height, width))
            self._images.clear()
        self._images.append((frame.time_s, image_from_frame(frame.image, self.view)))
        return len(self._images) >= LEAST and frame.time_s - self._images[0][0] >= STEADY_S

    def mean(self, least_s: float = 0.0) -> Map | None:
        """The mean (H, W, 3) of the longest still stretch of at least `least_s`; None without one.

        A stretch in which nothing seems to touch the gel is preferred. Without any, the first half is dropped.
        """
        times, images = [time_s for time_s, _ in self._images], [image for _, image in self._images]
        stretches = [
            one for one in still_stretches(images) if times[one.stop - 1] - times[one.start] >= least_s
        ]
        means = []
        for one in sorted(stretches, key=len, reverse=True):
            chosen = images[one.start : one.stop : max(1, len(one) // USUAL_FRAMES)]
            try:
                taken = background_from_frames(chosen, smooth=True)
            except DataError:  # most of its frames differ
                continue
            if taken.touch is None:
                return taken.background
            means.append(taken.background)
        if means:
            return means[0]
        said = f"no {LEAST} of {len(images)} frames follow each other without a change"
        self.reason = f"Something moves on the gel, or its light changes ({said}). {TOUCH_NOTHING}"
        for _ in range(len(self._images) // 2 + 1):
            self._images.popleft()
        return None


def still_stretches(images: Sequence[Array]) -> list[range]:
    """The stretches of images in a row without motion, of at least three, if there are three.

    A stretch ends where a block is off the mean of the stretch by more than three of the film's usual steps from image to
    image: compressed video steps by 1 to 3.5 gray levels at rest, a camera's own gray levels by one, touches by 10 or more.
    """
    blocks = [block_means(one) for one in images]
    steps = [float(np.abs(b - a).max()) for a, b in pairwise(blocks)]
    most = min(3 * max(1.0, float(np.median(steps))), 10.0) if steps else 0.0
    starts, total = [0], np.zeros_like(blocks[0])
    for k, one in enumerate(blocks):
        if k > starts[-1] and np.abs(one - total / (k - starts[-1])).max() > most:
            starts.append(k)
            total = np.zeros_like(one)
        total = total + one
    return [range(a, b) for a, b in pairwise([*starts, len(blocks)]) if b - a >= min(LEAST, len(images))]


def calibration_at_rest(
    sensor: str, frames: Iterable[Frame], serial: str | None, before: Calibration | None
) -> Calibration:
    """The calibration of a unit from frames of its gel at rest.

    `sensor` is the starter's name. The scale of `before`, the calibration in use, is kept if the user gave it to a
    calibration of the same starter.

    GelformError: something moved, or the gel's light is not that of the make.
    """
    starter = load_starter(sensor)
    untouched = UntouchedImage(starter)
    for frame in frames:
        untouched.keep(frame)
    image, pitch = untouched.mean(), None
    if image is None:
        raise GelformError(untouched.reason)
    if before is not None and (before.settings.starter or {}).get("sensor") == starter.sensor:
        pitch = None if before.mm_per_px == starter.calibration.mm_per_px else before.mm_per_px
    # Whole gray levels, so that the background in a recording is exactly the image in use.
    return starter.for_unit(np.rint(image), view=untouched.view, mm_per_px=pitch, serial=serial)


class UntouchedFirst:
    """Feed and sequence of a stream that starts once the gel was at rest; of a recording every frame is then given.

    `memory_of` makes the memory of the sequence from a Reconstructor, before the first frame is given.
    """

    def __init__(self, feed: Feed, starter: Starter, memory_of: Callable[[Reconstructor], Memory]) -> None:
        self.every, self.camera = feed.every, feed.camera
        self._feed, self._starter, self._memory_of = feed, starter, memory_of
        self._untouched = UntouchedImage(starter)
        self._held: deque[Frame] = deque()
        self._after = -1
        self._memory: Memory | None = None
        self.examine: Callable[[Work], None] = lambda work: work()

    @property
    def state(self) -> str:
        return "starting" if self._memory is None and self._feed.state == "running" else self._feed.state

    @property
    def reason(self) -> str:
        return self._untouched.reason if self.state == "starting" else self._feed.reason

    @property
    def skipped(self) -> int:
        return self._feed.skipped

    def next(self, after_index: int) -> Frame | None:
        """As the feed's; None while it waits for the gel at rest.

        CalibrationError: the background image is of another make, or a recording does not begin with the gel at rest.
        """
        if self._memory is None:
            self._look()
        if self._memory is None:
            return None
        return self._held.popleft() if self._held else self._feed.next(after_index)

    def close(self) -> None:
        self._feed.close()

    def _look(self) -> None:
        """Look at one frame of a sensor, or at the first ones of a recording."""
        ready = False
        if self.every:
            while len(self._held) < HELD and sum(one.image.nbytes for one in self._held) < MAX_BYTES:
                frame = self._feed.next(-1)
                if frame is None:
                    break
                self._held.append(frame)
                self._untouched.keep(frame)
            ready = bool(self._held)
        elif (frame := self._feed.next(self._after)) is not None:
            self._after, ready = frame.index, self._untouched.keep(frame)
        image = self._untouched.mean(0.0 if self.every else STEADY_S) if ready else None
        if image is not None:
            made = self._starter.for_unit(image, view=self._untouched.view, serial=self.camera.serial)
            self._memory = self._memory_of(Reconstructor(made))
            self._memory.examine = self.examine
        elif self.every or self._feed.state == "ended":
            raise CalibrationError(
                f"Expected the gel at rest in the first frames, to make a calibration of the {self._starter.make} from it. "
                f"{self._untouched.reason} Or give a background image with background= (--background)."
            )

    @property
    def memory(self) -> Memory:
        """The memory of the sequence; StaleError if the gel was not at rest yet."""
        if self._memory is None:
            raise StaleError(f"The stream is starting. {TOUCH_NOTHING}")
        return self._memory

    @property
    def reconstruct(self) -> Reconstructor:
        return self.memory.reconstruct

    def reconstructed(self, frame: Frame, timed: Timed) -> StreamFrame:
        return self.memory.reconstructed(frame, timed)

    def learn_from(self, given: StreamFrame) -> None:
        self.memory.learn_from(given)

    def take_background(self) -> None:
        """As `Memory.take_background`; does nothing before there is a calibration, which awaits the gel at rest anyway."""
        if self._memory is not None:
            self._memory.take_background()

    @property
    def background_request(self) -> tuple[bool, tuple[Finding, ...]]:
        return (False, ()) if self._memory is None else self._memory.background_request


def stream(
    source: SourceLike,
    calibration: Calibration | str | PathLike[str] | None = None,
    *,
    sensor: str | None = None,
    background: ArrayLike | None = None,
    smoothing: float | None = None,
) -> Stream:
    """Start to reconstruct the frames of a sensor.

        with gelform.stream("simulated", "mini.npz") as stream:
            for result in stream:
                print(result.peak_mm)

    Parameters
    ----------
    source : argument of `open_source`: "simulated", a serial number, a name, a device path, a video, a folder, an
        address; or an open Source, a function that opens one, or a running Grabber that several streams share
    calibration : the sensor's calibration, or the path of its file. None: the newest one in the user's library with the
        camera's serial number, or the one attached to a recording, or the simulated sensor's own; without any, a starter's
    sensor : without a calibration, the make whose starter is used, such as "gelsight-mini"; by default the make of the
        camera or of the recording. Results begin after a second in which nothing touches the gel. Until then the
        stream's state is "starting", and `stats.reason` says what it waits for
    background : (H, W, 3), 0-255, a current background image; with a starter, at the size of the source's frames. By default
        the calibration's own
    smoothing : temporal smoothing, s; None: none. Noise is averaged over this time. A change of depth above the noise is
        followed at once, a smaller one is delayed by at most this time

    Returns
    -------
    Stream
        Running. `close` it, use it as a context manager, or loop over it until the loop ends.

    Raises
    ------
    SensorError, DataError
        The source cannot be opened; the message lists the available ones.
    CalibrationError
        The background clearly belongs to another sensor; the calibration cannot be read; or none was given, the library has
        none, and the make is unknown.
    ValueError, TypeError
        The background has another size, or the smoothing is no time.
    """
    if smoothing is not None:
        Smoothing(smoothing)  # check before a device is opened
    if sensor is not None and calibration is not None:
        raise ValueError("Expected calibration=, or sensor= for its starter, got both. Leave one out.")
    named = None if sensor is None else load_starter(sensor)
    missing: NoCalibration | None = None
    if calibration is None:
        try:
            calibration = choose_calibration(unit_of(source), ready=sensor is None).calibration
        except NoCalibration as problem:
            missing = problem
    reconstruct = None if calibration is None else Reconstructor(calibration, background)
    feed = feed_from_source(source)

    def memory_of(reconstruct: Reconstructor) -> Memory:
        own = reconstruct.calibration
        return Memory(
            reconstruct,
            smoothing=smoothing,
            standing=lambda: camera_findings(own, feed.camera),
            look_s=0.0 if feed.every else LOOK_S,
        )

    try:
        if reconstruct is None:
            starter = named or _starter_of(feed.camera, missing)
            if background is None:
                first = UntouchedFirst(feed, starter, memory_of)
                return Stream(Pipeline(first, first, keep=KEPT), first)
            reconstruct = Reconstructor(starter.for_frame(background, serial=feed.camera.serial))
        memory = memory_of(reconstruct)
        return Stream(Pipeline(feed, memory, keep=KEPT), memory)
    except BaseException:
        feed.close()
        raise


def _starter_of(camera: Source | Grabber, missing: NoCalibration | None) -> Starter:
    """The starter of the camera's make."""
    name = starter_of_source(getattr(camera, "source", camera))
    if name is None:
        raise CalibrationError(
            f"{missing} If its make has a starter, name the make: sensor= (--sensor), one of {', '.join(starter_names())}."
        )
    return load_starter(name)


class Stream(Closing):
    """Results of a running sensor, newest first, for any number of consumers in any threads.

    A recording (a video or folder that is not paced) is no live source: each of its frames is reconstructed in order, and
    waits until someone has read it.

    Parameters
    ----------
    pipeline : not yet started
    memory : of its sequence
    """

    def __init__(self, pipeline: Pipeline[StreamFrame], memory: Memory | UntouchedFirst) -> None:
        self._pipeline, self._memory = pipeline, memory
        self._entered = False
        self._finalizer = weakref.finalize(self, pipeline.close)
        pipeline.start()

    def __enter__(self) -> Stream:
        self._entered = True
        return self

    def close(self) -> None:
        """Stop, and release the sensor; repeated calls do no harm."""
        self._finalizer()

    def __iter__(self) -> Iterator[Reconstruction]:
        """Results, newest first: of several that arrived during the loop's body, only the newest is given.

        Threads that share one iterator share its results; with its own, each has all. Outside a `with` block, the end of the
        loop closes the stream.
        """
        return Shared(given.result for given in self.pairs())

    def pairs(self) -> Iterator[StreamFrame]:
        """As the loop over the stream, with the image of each result."""
        return Shared(self._pairs())

    def _pairs(self) -> Iterator[StreamFrame]:
        try:
            yield from self._pipeline.results
        finally:
            if not self._entered:
                self.close()

    def newest(self, after_index: int = -1, timeout_s: float | None = None) -> StreamFrame | None:
        """The newest result of a frame numbered above `after_index`, with its image.

        Parameters
        ----------
        after_index : int, `result.index` of the last known result
        timeout_s : longest wait, s; None: until there is a result or the stream ends

        Returns
        -------
        StreamFrame or None
            None after the timeout or the end of the stream.

        Raises
        ------
        Exception
            The error of a failed stage of the stream.
        """
        return self._pipeline.results.newest(after_index, timeout_s)

    def latest(self, max_age_s: float) -> Reconstruction:
        """The newest result, captured at most `max_age_s` ago; waits for one at most as long.

        Raises
        ------
        StaleError
            There is none; the message gives the age of the newest one and the state of the stream.
        Exception
            The error of a failed stage of the stream.
        """
        deadline, newest = time.monotonic() + max_age_s, self._pipeline.results.newest
        given = newest(-1, 0)
        if given is not None and (left_s := self._left_s(given, max_age_s)) >= 0:
            # Prefer the result that is being made; take this one if that takes too long.
            return (newest(-1, left_s / 2) or given).result
        while given is None or self._left_s(given, max_age_s) < 0:
            given = newest(-1 if given is None else given.index, max(0.0, deadline - time.monotonic()))
            if given is None:
                stats = self.stats
                raise StaleError(
                    f"Expected a result at most {max_age_s:g} s old, the newest is {stats.age_s:.3g} s old. "
                    f"The stream is {stats.state}{f': {stats.reason}' if stats.reason else '.'}"
                )
        return given.result

    def _left_s(self, given: StreamFrame, max_age_s: float) -> float:
        """How long a result stays young enough, negative if it is too old; results of recordings have no age."""
        return 0.0 if self._pipeline.feed.every else max_age_s - (time.monotonic() - given.time_s)

    def image_of(self, result: Reconstruction) -> Array:
        """The image (H, W, 3), RGB, after the view, of one of the last results.

        Raises
        ------
        LookupError
            The result is not among the last 8: read image and result together, with `newest` or `pairs`.
        """
        for given in tuple(self._pipeline.recent):
            if given.index == result.index:
                return given.image
        raise LookupError(
            f"The image of frame {result.index} is no longer in memory. Take both with newest() or pairs()."
        )

    @property
    def calibration(self) -> Calibration:
        """The calibration in use; StaleError while a starter waits for the gel at rest."""
        return self._memory.reconstruct.calibration

    def take_background(self, timeout_s: float = 0.0) -> tuple[Finding, ...]:
        """Take the next frames (15, or those of a second) as background image, because nothing touches the gel.

        If something does, or they disagree, the background stays, and results have the finding `background_refused`.

        Parameters
        ----------
        timeout_s : longest wait for the outcome, s; 0: none, the next second's results tell it

        Returns
        -------
        tuple of Finding
            What was found in it, such as `background_refused`; empty without a wait.

        Raises
        ------
        StaleError
            Too few frames came until the timeout.
        """
        self._memory.take_background()
        if not timeout_s:
            return ()
        deadline = time.monotonic() + timeout_s
        while self._memory.background_request[0]:
            left_s = deadline - time.monotonic()
            if left_s <= 0:
                stats = self.stats
                raise StaleError(
                    f"Expected a second of frames within {timeout_s:g} s. "
                    f"The stream is {stats.state}{f': {stats.reason}' if stats.reason else '.'}"
                )
            with (changed := self._pipeline.results.changed):  # each frame brings it nearer
                changed.wait(left_s)
        return self._memory.background_request[1]

    @property
    def stats(self) -> StreamStats:
        """Rate, drops, age, time of each stage, and the state."""
        return self._pipeline.stats()
