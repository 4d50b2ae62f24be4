"""What work tells its caller: errors, findings, the tally of those of many frames, and the progress of long work."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any


class GelformError(Exception):
    """Base of all of gelform's own errors; the command line prints them as one line."""


class CalibrationError(GelformError):
    """A calibration cannot be made, read, or used on this image."""


class SensorError(GelformError):
    """A camera or a sensor profile does not answer as expected."""


class SourceLostError(SensorError):
    """A source of frames is gone, stands still or sends something that is no frame; opening it again may help."""


class ConvergenceError(GelformError):
    """A solver did not reach its tolerance; the message names the cause and a remedy."""


class StaleError(SensorError):
    """A stream has no result that is new enough."""


class DataError(GelformError):
    """A file or folder is missing, unreadable, incomplete or altered, or already exists."""


@contextmanager
def cannot(act: str, remedy: str = "", error: type[GelformError] = DataError) -> Iterator[None]:
    """Raise the error where the system refuses what is inside: "Cannot write a.npz: No space left on device."."""
    try:
        yield
    except OSError as problem:
        raise error(f"Cannot {act}: {problem.strerror or problem}.{remedy and ' ' + remedy}") from problem


def needed(module: str, extra: str, what: str) -> Any:
    """Import a module of an extra where it is used; `what` names the feature that needs it, such as "HDF5".

    DataError: it is not installed; the message says how to install it.
    """
    try:
        return import_module(module)
    except ImportError as missing:
        raise DataError(
            f'{what} needs the extra {extra}: pip install "gelform[{extra}]", or ".[{extra}]" in a checkout.'
        ) from missing


def reason(problem: BaseException) -> str:
    """Why one frame of many gives no result; its lack of memory has no message of its own."""
    return "Not enough memory for this frame." if isinstance(problem, MemoryError) else str(problem)


def said(problem: BaseException) -> str:
    """The message of another library's error about a file, in one line and without its full stop."""
    if isinstance(problem, UnicodeDecodeError):
        return f"byte {problem.start} of a text is no character"
    return str(problem).splitlines()[0].rstrip(".") if str(problem) else type(problem).__name__


def counted(count: int, noun: str) -> str:
    """A number with its noun: "1 press", "2 presses"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{'es' if noun.endswith('s') else 's'}"


# Findings after which the depth of the whole frame is doubtful: the calibration, the background or the light is not this
# frame's. Other findings are about a part of it, or are covered by its standard deviation.
DOUBTFUL = frozenset(
    {
        "background_differs",
        "background_pressed",
        "background_ratio",
        "beyond_gel",
        "camera_moved",
        "frozen",
        "not_this_gel",
        "other_camera",
        "other_gel",
        "slopes_contradict",
    }
)


@dataclass(frozen=True)
class Finding:
    """A fact that a user should know, with its figure."""

    name: str
    message: str
    figure: float


@dataclass
class FrameTally:
    """Counts of the frames of a data set or a stream."""

    # frames, failed: frames with a result, and without one
    frames: int = 0
    failed: int = 0
    unknown: int = 0  # of `frames`, those whose depth is known in no pixel
    doubtful: int = 0  # of `frames`, the unknown ones and those with a finding of `DOUBTFUL`
    findings: dict[str, int] = field(default_factory=dict)  # frames with each finding, by name
    # failed frames by reason, without its numbers and paths
    reasons: dict[str, int] = field(default_factory=dict)
    examples: dict[str, str] = field(default_factory=dict)  # the first text in full of each reason

    def add(self, names: Iterable[str], *, known: bool) -> None:
        """Count a frame with a result: the names of its findings, and whether its depth is known anywhere."""
        own = set(names)
        self.frames += 1
        self.unknown += not known
        self.doubtful += not known or not own.isdisjoint(DOUBTFUL)
        for name in own:
            self.findings[name] = self.findings.get(name, 0) + 1

    def add_failed(self, reason: str) -> None:
        """Count a frame without a result."""
        kind = re.sub(r"\S*[/\\]\S*|\d+", "#", reason)
        self.failed += 1
        self.reasons[kind] = self.reasons.get(kind, 0) + 1
        self.examples.setdefault(kind, reason)

    @property
    def is_doubtful(self) -> bool:
        """Whether most frames with a result are doubtful."""
        return 2 * self.doubtful > self.frames

    @property
    def is_useless(self) -> bool:
        """Whether depth is known in no pixel of any frame."""
        return self.unknown == self.frames


Progress = Callable[[int, int, str], None]


def no_progress(done: int, total: int, what: str) -> None:
    """Report nothing."""
