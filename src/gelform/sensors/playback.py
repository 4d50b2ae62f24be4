"""Frames that end: what every film is, its camera, and sources that play it at any pace, or with controls."""

from __future__ import annotations

import json
import math
import threading
import time
from bisect import bisect_right
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar

from gelform.arrays import Image
from gelform.errors import DataError, GelformError, said
from gelform.foundations.files import LIVE_PNG, picture_bytes
from gelform.image.view import MAX_PIXELS, Frame, in_rgb
from gelform.sensors.pictures import JPEG, check_declared, image_from_bytes, image_from_jpeg

Own = TypeVar("Own", bound="Closing")
USUAL_RATE_HZ = 25.0  # usual rate of videos and images without time stamps
FORMAT_VERSION = 1
CALIBRATION, BACKGROUND = "calibration.npz", "background.png"
# What a recording may carry, with its types.
ATTACHABLE = {CALIBRATION: "application/x-npz", BACKGROUND: "image/png"}


@dataclass(frozen=True)
class RecordingFacts:
    """The recorded camera, with what a `Source` tells of it."""

    name: str
    serial: str | None = None
    settings: Mapping[str, float | str] = field(default_factory=dict)
    rate_hz: float | None = None
    calibration_digest: str = ""  # of the calibration in use; empty without one
    library_version: str = ""  # gelform's

    def to_json(self) -> str:
        """All facts as one JSON object."""
        return json.dumps({**vars(self), "settings": dict(self.settings), "format_version": FORMAT_VERSION})

    @classmethod
    def from_json(cls, text: str, where: str) -> RecordingFacts:
        """The facts that `to_json` wrote; DataError if the text is damaged or of a newer format."""
        try:
            content: dict[str, Any] = json.loads(text)
            version = content.pop("format_version")
            if version > FORMAT_VERSION:
                raise DataError(
                    f"{where} has format version {version}, written by gelform {content.get('library_version')}; this "
                    f"one reads up to {FORMAT_VERSION}. Install that release."
                )
            return cls(**content)
        except (ValueError, TypeError, KeyError, AttributeError) as problem:
            raise DataError(f"{where} is damaged: its facts about the camera cannot be read.") from problem


def encoded_from_frame(frame: Frame) -> tuple[str, bytes]:
    """("jpeg", the bytes as the camera sent them), or ("png", the pixels without loss)."""
    if frame.encoded is not None:
        return "jpeg", frame.encoded
    return "png", picture_bytes(frame.image, settings=LIVE_PNG)


def image_from_encoded(content: bytes, reduction: int, where: str) -> Image:
    """The pixels (H, W, 3) uint8 RGB of the result of `encoded_from_frame`; JPEGs are reduced as the camera's frames were.

    DataError: the bytes are damaged.
    """
    if not content.startswith(JPEG):
        return image_from_bytes(content, where)
    try:
        check_declared(content)
    except ValueError as problem:
        raise DataError(f"{where}: {said(problem)}. It is damaged.") from problem
    image = image_from_jpeg(content, reduction)
    if image is None:
        raise DataError(f"{where} is damaged: its picture cannot be decoded.")
    return image


def reduction_in(settings: Mapping[str, float | str]) -> int:
    """The reduction of the camera's JPEGs during decoding."""
    return int(float(settings.get("reduced", 1)))


class Pace:
    """The times of frames by a clock that starts now."""

    def __init__(self) -> None:
        self._start_s = time.monotonic()

    def wait_until(self, after_s: float) -> float:
        """Wait until `after_s` seconds after the start; return that time, on the clock."""
        due = self._start_s + after_s
        time.sleep(max(0.0, due - time.monotonic()))
        return due

    def late_s(self, after_s: float) -> float:
        """Seconds since the moment `after_s` after the start; negative if it is in the future."""
        return time.monotonic() - self._start_s - after_s


class Every:
    """Whether to do something at a time that does not go back: on average once a period, s, whatever the times between."""

    def __init__(self, period_s: float = 0.0) -> None:
        self.period_s, self._due_s = period_s, -math.inf

    def __call__(self, time_s: float) -> bool:
        """Whether it is due."""
        left_s = self._due_s - time_s
        if 0 < left_s <= self.period_s:  # later than that, the times have begun again
            return False
        self._due_s = (self._due_s if -self.period_s < left_s <= 0 else time_s) + self.period_s
        return True


class Closing:
    """A source that the end of a `with` block closes."""

    def __enter__(self: Own) -> Own:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        raise NotImplementedError


class FrameReader:
    """What a loop gives frames of, in RGB, also where `bgr` says that they are read as blue, green, red."""

    bgr = False

    def __iter__(self) -> Iterator[Frame]:
        return map(self._in_rgb, self._frames())

    def _in_rgb(self, found: Any) -> Any:
        """A frame in RGB; errors unchanged."""
        return in_rgb(found) if self.bgr and isinstance(found, Frame) else found

    def _frames(self) -> Iterator[Frame]:
        raise NotImplementedError


class Film(FrameReader):
    """Frames that end, in the order of time; a loop reads them from the start, `film[number]` gives any, in any thread.

    A kind of film has `_frame`, the one of a number, and, unless its frames are counted and evenly spaced, `_frames` and
    `times_s`. It knows the facts of its camera as far as they are known.
    """

    count = 0  # number of frames that it states, or 0; a damaged file may hold fewer
    most_pixels: float = MAX_PIXELS  # larger pictures are not decoded

    def __init__(self, path: Path, camera: RecordingFacts) -> None:
        self.path, self.camera = path, camera
        self._alone = Lock()  # decoders keep their place, and a film may be shared while it plays

    def __getitem__(self, number: int) -> Frame:
        """The frame of a number from 0; DataError if it is damaged."""
        with self._alone:
            return self._in_rgb(self._frame(number))

    def frames(self, only: Container[int] | None = None) -> Iterator[Frame]:
        """The frames, or those with a position in `only`; most films do not decode the others."""
        return map(self._in_rgb, self._frames(only))

    def each(self, start: int = 0, count: int = 0) -> Iterator[Frame | BaseException]:
        """The frames of a range (0: to the end), or in the place of one its error; raises where nothing more can be read."""
        return map(self._in_rgb, self._each(start, count or self.count - start))

    @cached_property
    def times_s(self) -> Sequence[float]:
        """Time of each frame, counted from the first, increasing; asking for it scans the file."""
        return tuple(number / (self.camera.rate_hz or USUAL_RATE_HZ) for number in range(self.count))

    def _frames(self, only: Container[int] | None = None) -> Iterator[Frame]:
        for number in range(self.count):
            if only is None or number in only:
                with self._alone:
                    frame = self._frame(number)
                yield frame

    def _each(self, start: int, count: int) -> Iterator[Frame | BaseException]:
        return islice(self._frames(), start, None)

    def _frame(self, number: int) -> Frame:
        raise NotImplementedError


class Playback(Closing, FrameReader):
    """A film, or other frames that end, as a source, with the facts of the camera as far as they are known.

    Each frame comes as fast as it can be read, with the file's `time_s`; paced, at the original pace and with `time_s` on
    the monotonic clock. Paced frames more than one frame period late are skipped.
    """

    def __init__(self, frames: Iterable[Frame], facts: RecordingFacts, *, paced: bool = False) -> None:
        self.name, self.serial, self.rate_hz = facts.name, facts.serial, facts.rate_hz
        self.settings = dict(facts.settings)
        self.live = paced
        self._film = frames
        self._closed = False

    def _frames(self) -> Iterator[Frame]:
        rate_hz, first_s, pace = self.rate_hz or USUAL_RATE_HZ, None, Pace()
        for frame in self._film:
            if self.live:
                first_s = frame.time_s if first_s is None else first_s
                after_s = frame.time_s - first_s
                if after_s > 0 and pace.late_s(after_s) > 1 / rate_hz:
                    continue
                time_s = pace.wait_until(after_s)
                frame = replace(frame, time_s=time_s, wall_time_ns=frame.wall_time_ns or time.time_ns())
            if self._closed:
                return
            yield frame

    def close(self) -> None:
        """End the loop over this source."""
        self._closed = True


SLOWEST, FASTEST = 1 / 16, 16.0  # times the original pace


@dataclass(frozen=True)
class ReplayedFrame(Frame):
    """A frame of a recording, shown now."""

    number: int = 0  # in the recording
    recorded_s: float = 0.0  # recording time, from the first frame


class Player(Closing):
    """Plays a recording: at first from its start, at its own pace and once. `playing` says whether it is.

    A reader that is too slow gets the newest frame that is due. At a damaged frame playing stops, and `problem` gives
    the reason; the frame is skipped. Methods may be called in any thread.

    It shows the first frame of the scanned recording until `may_begin()`, such as once somebody looks. Another `clock` runs
    it faster or slower than real time.
    """

    live = True

    def __init__(
        self,
        recording: Film,
        *,
        clock: Callable[[], float] = time.monotonic,
        may_begin: Callable[[], bool] = lambda: True,
    ) -> None:
        self.recording, self._may_begin = recording, may_begin
        facts = recording.camera
        self.name, self.serial, self.rate_hz = facts.name, facts.serial, facts.rate_hz
        self.settings = dict(facts.settings)
        self.problem = ""
        self._clock = clock
        self._changed = threading.Condition()
        self._closed, self._waits = False, True
        self.playing, self._loops, self._speed = True, False, 1.0
        self._number, self._asked = -1, 0
        self._from_s, self._since_s = 0.0, clock()

    def __iter__(self) -> Iterator[Frame]:
        index = 0
        while (number := self._next()) is not None:
            try:
                frame = self.recording[number]
            except DataError as problem:
                self.problem = str(problem)
                self.play(False)
                continue
            shown = frame.image, self._clock(), frame.wall_time_ns, index, frame.encoded
            yield ReplayedFrame(*shown, number, self.recording.times_s[number])
            index += 1

    # -- controls -----------------------------------------------------------------------------------------------------

    def play(self, playing: bool = True) -> None:
        """Play, from the start if it is at the end; False: pause."""
        with self._changed:
            if playing and self._number >= len(self.recording.times_s) - 1:
                self._asked = 0
            self._set(playing=playing)

    def seek(self, number: float) -> None:
        """Show a frame, or the first or last one if the number is out of range; continue playing if it was."""
        with self._changed:
            self._asked = min(max(int(number), 0), len(self.recording.times_s) - 1)
            self._set()

    def step(self, by: float) -> None:
        """Pause, and show the next frame (+1) or the previous one (-1)."""
        with self._changed:
            at = self._number if self._asked < 0 else self._asked
            self._asked = min(max(at + int(by), 0), len(self.recording.times_s) - 1)
            self._set(playing=False)

    def again(self) -> None:
        """Show the current frame again, because its reconstruction has changed."""
        with self._changed:
            if not self.playing and self._asked < 0:
                self._asked = max(self._number, 0)
                self._set()

    def set_speed(self, speed: float) -> None:
        """Play at a multiple of the original pace, 1/16 to 16."""
        if not SLOWEST <= speed <= FASTEST:
            raise GelformError(f"Expected a speed from {SLOWEST:g} to {FASTEST:g}, got {speed:g}.")
        with self._changed:
            self._speed = speed
            self._set()

    def loop(self, loops: bool = True) -> None:
        """At the end, start again; False: stop there."""
        with self._changed:
            self._loops = loops
            self._set()

    def facts(self) -> dict[str, Any]:
        """The player's state for the page."""
        with self._changed:
            times = self.recording.times_s
            return {
                "file": self.recording.path.name,
                "number": max(self._number, 0),
                "count": len(times),
                "time_s": times[max(self._number, 0)],
                "duration_s": times[-1],
                "playing": self.playing,
                "speed": self._speed,
                "loop": self._loops,
                "problem": self.problem,
            }

    def close(self) -> None:
        """End the loop over it."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    # -- the pace -----------------------------------------------------------------------------------------------------

    def _set(self, playing: bool | None = None) -> None:
        """Apply a change; the pace counts from the current frame."""
        self.playing = self.playing if playing is None else playing
        self._from_s, self._since_s = self.recording.times_s[max(self._number, 0)], self._clock()
        self._changed.notify_all()

    def _next(self) -> int | None:
        """Wait until the next frame is due; None once the player is closed."""
        with self._changed:
            while not self._closed:
                if self._asked >= 0:
                    self._asked, self._number = -1, self._asked
                    self._set()
                    return self._number
                if not self.playing:
                    self._changed.wait()
                elif self._number < len(self.recording.times_s) - 1:
                    if (number := self._due()) > self._number:
                        self._number = number
                        return number
                elif self._loops and len(self.recording.times_s) > 1:
                    self._asked = 0
                else:
                    self.playing = False
            return None

    def _due(self) -> int:
        """The newest frame that is due; waits for the next one if none is."""
        times = self.recording.times_s
        if self._waits and self._number == 0:
            if not self._may_begin():
                self._changed.wait(0.1)  # s between two looks whether it may begin
                self._since_s = self._clock()
                return self._number
            self._waits = False
        at_s = self._from_s + self._speed * (self._clock() - self._since_s)
        wait_s = (times[self._number + 1] - at_s) / self._speed
        if wait_s > 0:
            self._changed.wait(wait_s)
            return self._number
        return bisect_right(times, at_s) - 1
