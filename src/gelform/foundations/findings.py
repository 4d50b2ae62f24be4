"""What work tells its caller: findings, the tally of those of many frames, and the progress of long work."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

# Findings after which the depth of the whole frame is doubtful: the calibration, the background or the light is not this
# frame's. Other findings are about a part of it, or are covered by its standard deviation.
DOUBTFUL = frozenset(
    {
        "background_differs",
        "background_pressed",
        "background_ratio",
        "beyond_gel",
        "camera_moved",
        "contact_unknown",
        "frozen",
        "not_this_gel",
        "other_camera",
        "other_gel",
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
