"""A recording with random access by frame number, and as a source with controls: play, pause, seek, step, speed, loop."""

from __future__ import annotations

import os
import threading
import time
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple

import cv2
import numpy as np

from gelform.errors import DataError, GelformError
from gelform.foundations.files import way_for
from gelform.image.frame import Frame, in_rgb
from gelform.sensors.files import USUAL_RATE_HZ, Video, grabbed_image, is_stack, is_video, opened_video
from gelform.sensors.playback import RecordingFacts, facts_of_video, images_by_number, reduction_in
from gelform.sensors.recordings.mcap_reader import (
    frame_from_message,
    is_bag_folder,
    mcap_file_in,
    picture_topic_of,
    records_from,
)


@dataclass(frozen=True)
class Indexed:
    """A recording with random access.

    Attributes
    ----------
    path : file or folder
    facts : of the camera
    times_s : time of each frame, counted from the first, increasing
    frame : number from 0 -> Frame, in any thread; DataError if it is damaged
    """

    path: Path
    facts: RecordingFacts
    times_s: tuple[float, ...]
    frame: Callable[[int], Frame]

    def __len__(self) -> int:
        return len(self.times_s)


def is_recording(spec: str) -> bool:
    """Whether a spec is a file or a folder of frames, not a device."""
    return os.path.exists(spec) and not spec.startswith("/dev/")


def recordings_in(folder: Path) -> list[Path]:
    """The recordings in a folder: *.mcap, videos and files of several images."""
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    return [one for one in found if one.suffix.lower() == ".mcap" or is_video(one) or is_stack(one)]


def indexed(path: Path, *, bgr: bool = False) -> Indexed:
    """Scan a recording once; `bgr`: its frames are blue, green, red.

    DataError: the recording is missing, damaged, empty, or of an unknown kind.
    """
    if path.suffix.lower() == ".mcap" or is_bag_folder(path):
        index = McapIndex(mcap_file_in(path) if path.is_dir() else path)
        found = Indexed(path, index.facts, index.times_s, index.frame)
    elif path.is_dir() or is_stack(path):
        found = _of_images(path)
    elif is_video(path):
        found = _of_video(path)
    else:
        raise DataError(f"{path} is no video, no folder of images and no recording (*.mcap).{way_for(path)}")
    if not found.times_s:
        raise DataError(f"{path} holds no frame.")
    alone = Lock()  # decoders keep their place, and a recording may be shared while it plays

    def frame(number: int) -> Frame:
        with alone:
            return in_rgb(found.frame(number)) if bgr else found.frame(number)

    return replace(found, frame=frame)


def _of_images(path: Path) -> Indexed:
    frame, count = images_by_number(path, USUAL_RATE_HZ)
    times_s = tuple(number / USUAL_RATE_HZ for number in range(count))
    return Indexed(path, RecordingFacts(path.resolve().name, rate_hz=USUAL_RATE_HZ), times_s, frame)


def _of_video(path: Path) -> Indexed:
    video = Video(path)
    reel = _Reel(path, video.facts.frame_rate_hz or USUAL_RATE_HZ)
    return Indexed(path, facts_of_video(video), reel.times_s, reel.frame)


class _Reel:
    """Frames of a video in any order.

    Most frames of a video are stored as changes against others. OpenCV seeks by time, which is inexact in some files. If the
    frame after a seek has another time than in the first pass, the video is read again from its start.
    """

    def __init__(self, path: Path, rate_hz: float) -> None:
        self._path, self._rate_hz = path, rate_hz
        self._capture = opened_video(path)
        self._stamps: list[float] = []
        while self._capture.grab():
            self._stamps.append(self._capture.get(cv2.CAP_PROP_POS_MSEC))
        self._next = len(self._stamps)
        grows = len(self._stamps) < 2 or float(np.diff(self._stamps).min()) > 0
        first = self._stamps[0] if self._stamps else 0.0
        self.times_s = tuple(
            (stamp - first) / 1000 if grows else number / rate_hz for number, stamp in enumerate(self._stamps)
        )

    def frame(self, number: int) -> Frame:
        if not self._grabbed(number):
            raise DataError(f"Frame {number} of {self._path} cannot be read again.")
        return Frame(
            grabbed_image(self._capture, f"Frame {number} of {self._path}"), self.times_s[number], 0, number
        )

    def _grabbed(self, number: int) -> bool:
        """Whether the frame was reached: as the next one, by a seek, or from the start."""
        if number != self._next:
            self._capture.set(cv2.CAP_PROP_POS_FRAMES, number)
        if self._is_now(number):
            return True
        self._capture.release()
        self._capture = opened_video(self._path)
        for _ in range(number):
            self._capture.grab()
        return self._is_now(number)

    def _is_now(self, number: int) -> bool:
        grabbed = self._capture.grab()
        self._next = number + 1
        return grabbed and abs(self._capture.get(cv2.CAP_PROP_POS_MSEC) - self._stamps[number]) < 0.5


class MessagePlace(NamedTuple):
    """Place of a message: its time, the file offset of its record (a chunk, or itself), its number within the record."""

    log_time: int
    offset: int
    nth: int
    sequence: int


class McapIndex:
    """The frames of an MCAP file by number.

    The file is scanned once; 32 bytes per frame and the two last used chunks stay in memory. If the recorder was killed, the
    frames up to the last complete chunk are available.

    Parameters
    ----------
    path : of the file

    Attributes
    ----------
    facts : RecordingFacts
    times_s : time of each frame, counted from the first

    Raises
    ------
    DataError
        The file is missing, no MCAP file or damaged, has no readable topic of pictures, or the extra `mcap` is missing.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.facts, self._topic = picture_topic_of(path)
        self._channels: set[int] = set()
        self._places = sorted(self._placed())
        first = self._places[0].log_time if self._places else 0
        self.times_s = tuple((place.log_time - first) / 1e9 for place in self._places)
        self._chunks: OrderedDict[int, list[Any]] = OrderedDict()

    def frame(self, number: int) -> Frame:
        """A frame; DataError if it is damaged or the file has changed."""
        place = self._places[number]
        messages = self._messages_at(place.offset)
        if place.nth >= len(messages) or messages[place.nth].log_time != place.log_time:
            raise DataError(f"{self._path} was changed while it was open. Open it again.")
        index = place.sequence if self._topic.numbered else number
        return frame_from_message(
            messages[place.nth].data,
            self._topic,
            reduction_in(self.facts.settings),
            self.times_s[number],
            index,
            f"Frame {index} of {self._path}",
        )

    def _placed(self) -> Iterator[MessagePlace]:
        """Every message of the topic, in file order."""
        for offset, inside in records_from(self._path):
            for nth, message in enumerate(self._wanted(inside)):
                yield MessagePlace(message.log_time, offset, nth, message.sequence)

    def _messages_at(self, offset: int) -> list[Any]:
        if offset not in self._chunks:
            self._chunks[offset] = list(self._wanted(next(records_from(self._path, offset))[1]))
            while len(self._chunks) > 2:
                self._chunks.popitem(last=False)
        self._chunks.move_to_end(offset)
        return self._chunks[offset]

    def _wanted(self, inside: list[Any]) -> Iterator[Any]:
        """The topic's messages among records; also notes the numbers of its channels."""
        for one in inside:
            kind = type(one).__name__
            if kind == "Channel" and one.topic == self._topic.name:
                self._channels.add(one.id)
            elif kind == "Message" and one.channel_id in self._channels:
                yield one


BEGIN_POLL_S = 0.1  # s between two looks whether it may begin
SLOWEST, FASTEST = 1 / 16, 16.0  # times the original pace


@dataclass(frozen=True)
class ReplayedFrame(Frame):
    """A frame of a recording, shown now.

    Attributes
    ----------
    number : in the recording, from 0
    recorded_s : recording time, from the first frame
    """

    number: int = 0
    recorded_s: float = 0.0


class Player:
    """Plays a recording: at first from its start, at its own pace and once.

    A reader that is too slow gets the newest frame that is due. At a damaged frame playing stops, and `problem` gives
    the reason; the frame is skipped. Methods may be called in any thread.

    Parameters
    ----------
    recording : Indexed
    clock : replaceable, to run faster or slower than real time
    may_begin : it shows its first frame until this is true, such as once somebody looks
    """

    live = True

    def __init__(
        self,
        recording: Indexed,
        *,
        clock: Callable[[], float] = time.monotonic,
        may_begin: Callable[[], bool] = lambda: True,
    ) -> None:
        self.recording, self._may_begin = recording, may_begin
        facts = recording.facts
        self.name, self.serial, self.rate_hz = facts.name, facts.serial, facts.rate_hz
        self.settings = dict(facts.settings)
        self.problem = ""
        self._clock = clock
        self._changed = threading.Condition()
        self._closed, self._waits = False, True
        self._playing, self._loops, self._speed = True, False, 1.0
        self._number, self._asked = -1, 0
        self._from_s, self._since_s = 0.0, clock()

    def __iter__(self) -> Iterator[Frame]:
        index = 0
        while (number := self._next()) is not None:
            try:
                frame = self.recording.frame(number)
            except DataError as problem:
                self.problem = str(problem)
                self.play(False)
                continue
            yield ReplayedFrame(
                frame.image,
                self._clock(),
                frame.wall_time_ns,
                index,
                frame.encoded,
                number,
                self.recording.times_s[number],
            )
            index += 1

    # -- controls -----------------------------------------------------------------------------------------------------

    def play(self, playing: bool = True) -> None:
        """Play, from the start if it is at the end; False: pause."""
        with self._changed:
            if playing and self._number >= len(self.recording) - 1:
                self._asked = 0
            self._set(playing=playing)

    def seek(self, number: float) -> None:
        """Show a frame, or the first or last one if the number is out of range; continue playing if it was."""
        with self._changed:
            self._asked = min(max(int(number), 0), len(self.recording) - 1)
            self._set()

    def step(self, by: float) -> None:
        """Pause, and show the next frame (+1) or the previous one (-1)."""
        with self._changed:
            at = self._number if self._asked < 0 else self._asked
            self._asked = min(max(at + int(by), 0), len(self.recording) - 1)
            self._set(playing=False)

    def again(self) -> None:
        """Show the current frame again, because its reconstruction has changed."""
        with self._changed:
            if not self._playing and self._asked < 0:
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

    @property
    def playing(self) -> bool:
        """Whether it is playing."""
        return self._playing

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
                "playing": self._playing,
                "speed": self._speed,
                "loop": self._loops,
                "problem": self.problem,
            }

    def close(self) -> None:
        """End the loop over it."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def __enter__(self) -> Player:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # -- the pace -----------------------------------------------------------------------------------------------------

    def _set(self, playing: bool | None = None) -> None:
        """Apply a change; the pace counts from the current frame."""
        self._playing = self._playing if playing is None else playing
        self._from_s, self._since_s = self.recording.times_s[max(self._number, 0)], self._clock()
        self._changed.notify_all()

    def _next(self) -> int | None:
        """Wait until the next frame is due; None once the player is closed."""
        with self._changed:
            while not self._closed:
                if self._asked >= 0:
                    return self._show(self._asked)
                if not self._playing:
                    self._changed.wait()
                elif self._number >= len(self.recording) - 1:
                    self._at_end()
                elif (number := self._due()) > self._number:
                    self._number = number
                    return number
            return None

    def _show(self, number: int) -> int:
        self._asked, self._number = -1, number
        self._set()
        return number

    def _due(self) -> int:
        """The newest frame that is due; waits for the next one if none is."""
        times = self.recording.times_s
        if self._waits and self._number == 0:
            if not self._may_begin():
                self._changed.wait(BEGIN_POLL_S)
                self._since_s = self._clock()
                return self._number
            self._waits = False
        at_s = self._from_s + self._speed * (self._clock() - self._since_s)
        wait_s = (times[self._number + 1] - at_s) / self._speed
        if wait_s > 0:
            self._changed.wait(wait_s)
            return self._number
        return bisect_right(times, at_s) - 1

    def _at_end(self) -> None:
        if self._loops and len(self.recording) > 1:
            self._asked = 0
        else:
            self._playing = False
