"""The frames of a stream: the newest one of a live source, every one of a recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from os import PathLike
from typing import Any, Protocol

from gelform.image.frame import Frame
from gelform.sensors.grabber import Grabber
from gelform.sensors.source import Source, checked_frame, open_source

WAKE_S = 0.2  # s, longest wait for a frame before a request to stop is checked
PAUSED_S = 0.05  # s between checks whether the pause is over

SourceLike = str | PathLike[str] | Source | Callable[[], Source] | Grabber


class Feed(Protocol):
    """Frames for one stream.

    Attributes
    ----------
    every : True if each frame is given, False if only the newest one
    camera : has the serial number, and the settings as read back
    state, reason : "starting", "running", "reconnecting" or "ended"; the reason as a sentence
    skipped : number of frames that arrived, and that a newer one replaced before this feed was asked for them
    """

    every: bool
    camera: Source | Grabber

    @property
    def skipped(self) -> int: ...

    @property
    def state(self) -> str: ...

    @property
    def reason(self) -> str: ...

    def next(self, after_index: int) -> Frame | None:
        """A frame with a number above `after_index`; None if none arrived within a moment, or at the end."""

    def close(self) -> None:
        """Close the objects that the feed itself opened."""


class NewestFrames:
    """The newest frames of a grabber.

    Parameters
    ----------
    grabber : running
    owned : True if the grabber closes with the feed; a grabber that the caller passed stays open for other consumers
    paused : returns True while no frame is to be given; frames of that time are not skipped
    """

    every = False

    def __init__(self, grabber: Grabber, *, owned: bool, paused: Callable[[], bool] = lambda: False) -> None:
        self.camera: Source | Grabber = grabber
        self._grabber, self._owned, self._paused = grabber, owned, paused
        self.skipped, self._lost, self._waited = 0, 0, True

    @property
    def state(self) -> str:
        return self._grabber.state

    @property
    def reason(self) -> str:
        return self._grabber.reason

    def next(self, after_index: int) -> Frame | None:
        if self._paused():
            self._waited = True
            time.sleep(PAUSED_S)
            return None
        frame = self._grabber.newest(after_index, WAKE_S)
        if frame is not None:
            self._count_skipped(frame.index - after_index - 1)
        return frame

    def _count_skipped(self, missing: int) -> None:
        """Count the frames between two that were given, except those that were lost before, or not wanted."""
        before, self._lost = self._lost, self._grabber.stats.drops
        if not self._waited:
            self.skipped += max(0, missing - (self._lost - before))
        self._waited = False

    def close(self) -> None:
        if self._owned:
            self._grabber.close()


class EveryFrame:
    """Each frame of a recording in order, on request."""

    every = True
    skipped = 0

    def __init__(self, source: Source) -> None:
        self.camera: Source | Grabber = source
        self._frames = iter(source)
        self.state, self.reason = "running", ""

    def next(self, after_index: int) -> Frame | None:
        frame = next(self._frames, None)
        if frame is None:
            self.state, self.reason = "ended", "the source has no more frames"
            return None
        return checked_frame(frame, after_index, self.camera.name)

    def close(self) -> None:
        self.camera.close()


def feed_from_source(source: SourceLike) -> Feed:
    """Open the feed of a source.

    Parameters
    ----------
    source : argument of `open_source`, or a function that opens a source and is called again after a loss; an open
        Source; or a running Grabber, which other streams may share

    Raises
    ------
    SensorError, DataError
        The source cannot be opened; the message lists the available ones.
    """
    if isinstance(source, Grabber):
        return NewestFrames(source, owned=False)
    if hasattr(source, "live"):
        opened: Any = source
        return (
            NewestFrames(Grabber(lambda: opened).__enter__(), owned=True)
            if opened.live
            else EveryFrame(opened)
        )
    if not (callable(source) or isinstance(source, (str, PathLike))):
        raise TypeError(
            f"Expected a source: text, a path, a Source or a Grabber, got {type(source).__name__}."
        )
    grabber = Grabber(source).__enter__()
    if grabber.source.live:
        return NewestFrames(grabber, owned=True)
    grabber.close()  # a recording must give every frame: read it again, frame by frame
    return EveryFrame(source() if callable(source) else open_source(source))
