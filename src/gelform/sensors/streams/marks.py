"""Scratch, dust and tear: small parts of the image that differ permanently from the start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.foundations.filters import robust_sigma
from gelform.foundations.findings import Finding
from gelform.sensors.streams.background_drift import DriftEvidence

SMOOTH_PX, WIDE_PX = 1.0, 8.0  # px, widths of the blur of the image and of its surroundings
MARK_SIGMAS, LEAST_MARK_CHANGE = 6.0, 0.04  # standard deviations of noise; least fraction of the brightness
MARK_STAYS = 3  # consecutive evidences, about ten seconds each
LEAST_AREA_PX = 4  # px; a smaller area is noise
LONG_PX, THIN = 10.0, 0.4  # a scratch: least length, px, and largest width / length; or ...
GROOVE_THIN, BOTH_SIGNS = 0.6, 0.4  # ... width / length, if it is bright on one side and dark on the other
TORN, TORN_AREA = 0.2, 0.0045  # a tear: fraction of the brightness, all channels; of the image
DARK = 0.06  # mean loss of light by dust, a fraction; a slight bright spot does no harm
CONTACT_AROUND = 0.5  # fraction of a mark's surroundings in contact; above it an object rests there
AROUND_PX = 8  # px, width of a mark's surroundings
BODY_PX = 15  # px; a wider contact is an object


@dataclass(frozen=True)
class Mark:
    """One connected part of the image that differs from the start.

    Attributes
    ----------
    name : "scratch", "dust", "tear"
    area_px, length_px : int, float
    change : float, relative, mean of all channels
    """

    name: str
    area_px: int
    length_px: float
    change: float


class Marks:
    """Counts for how long each pixel has differed from the start without contact around it."""

    def __init__(self) -> None:
        self._stays: NDArray[np.uint8] | None = None

    def __call__(self, evidence: DriftEvidence) -> tuple[Finding, ...]:
        """Find `scratch`, `dust` and `tear`.

        Their figures are the largest one's length or diameter, px, and image fraction.
        """
        change = np.asarray(evidence.image / np.maximum(evidence.lit, 1) - 1, dtype=np.float32)
        odd = _stands_out(change, _near_a_body(evidence.contact))
        if self._stays is None:
            self._stays = np.zeros(odd.shape, np.uint8)
        self._stays[:] = np.where(_dilated(odd, 1), np.minimum(self._stays + 1, 250), 0)
        marks = _marks(odd & (self._stays >= MARK_STAYS), change, evidence.contact)
        return tuple(_finding(name, marks, odd.size) for name in _WORDS if any(m.name == name for m in marks))


_WORDS = {
    "scratch": "A new line of {length:.0f} px has stayed on the gel: a scratch, or a fiber. Depth along it is wrong.",
    "dust": "A new spot of {length:.0f} px has stayed on the gel: dust. Clean it.",
    "tear": "{percent:.1f} % of the image has become {change:+.0f} % brighter and has stayed so. The coating is torn or "
    "worn. Replace the gel.",
}


def _finding(name: str, marks: list[Mark], pixels: int) -> Finding:
    largest = max((mark for mark in marks if mark.name == name), key=lambda mark: mark.area_px)
    fraction = largest.area_px / pixels
    message = _WORDS[name].format(
        length=largest.length_px, percent=100 * fraction, change=100 * largest.change
    )
    return Finding(name, message, fraction if name == "tear" else largest.length_px)


def _near_a_body(contact: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) in or near a contact that is wider than a mark: their relief belongs to the touching object."""
    map8 = contact.view(np.uint8)
    wide = cv2.morphologyEx(map8, cv2.MORPH_OPEN, np.ones((BODY_PX, BODY_PX), np.uint8))
    count, labels = cv2.connectedComponents(map8, connectivity=8)
    bodies = np.zeros(count, np.uint8)
    bodies[labels[wide > 0]] = 1
    return _dilated(bodies[labels], BODY_PX)


def _dilated(mask: NDArray[Any], by_px: int) -> NDArray[np.bool_]:
    """A mask (H, W) with a square margin."""
    wide: NDArray[np.bool_] = cv2.dilate(mask.view(np.uint8), np.ones((2 * by_px + 1,) * 2, np.uint8)).view(
        np.bool_
    )
    return wide


def _stands_out(change: NDArray[np.float32], near_a_body: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels (H, W) that are torn, or differ far more than others from their wide surroundings, in any channel."""
    smooth = cv2.GaussianBlur(change, (0, 0), SMOOTH_PX)
    height, width = change.shape[:2]
    step = max(1, round(WIDE_PX / 2))
    small = cv2.resize(smooth, (max(1, width // step), max(1, height // step)), interpolation=cv2.INTER_AREA)
    wide = cv2.resize(cv2.medianBlur(small, 5), (width, height), interpolation=cv2.INTER_LINEAR)
    off = np.abs(smooth - wide)
    torn = np.abs(smooth).min(axis=-1) > TORN  # wider than the median's window
    noise = robust_sigma(off[::2, ::2], axis=(0, 1))
    odd = (off > np.maximum(MARK_SIGMAS * noise, LEAST_MARK_CHANGE)).any(axis=-1)
    return np.asarray((odd & ~near_a_body) | torn)


def _marks(where: NDArray[np.bool_], change: NDArray[np.float32], contact: NDArray[np.bool_]) -> list[Mark]:
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(where.view(np.uint8), connectivity=8)
    marks = []
    for label in range(1, count):
        area = int(boxes[label][cv2.CC_STAT_AREA])
        if area < LEAST_AREA_PX:
            continue
        mine = labels == label
        name, length = _kind(mine, change[mine], area)
        brighter = float(change[mine].mean())
        if name == "dust" and brighter > -DARK:
            continue
        if name == "tear" or not _rests(mine, contact):
            marks.append(Mark(name, area, length, brighter))
    return marks


def _kind(mine: NDArray[np.bool_], change: NDArray[np.float32], area: int) -> tuple[str, float]:
    """The name and the length, px, of a mark (H, W) whose pixels changed by (N, 3)."""
    y, x = np.nonzero(mine)
    covariance = np.cov(np.stack([x, y])) if area > 1 else np.zeros((2, 2))
    small, large = np.sqrt(np.maximum(np.linalg.eigvalsh(covariance), 0)) * np.sqrt(12) + 1
    if area > TORN_AREA * mine.size and abs(change.mean()) > TORN:
        return "tear", float(large)
    thin = GROOVE_THIN if _has_both_signs(change) else THIN
    return ("scratch" if large > LONG_PX and small < thin * large else "dust"), float(large)


def _has_both_signs(change: NDArray[np.float32]) -> bool:
    """Whether pixels (N, 3) became brighter and darker in equal measure, in the channel that changed most."""
    sizes = np.abs(change).mean(axis=0)
    most = int(sizes.argmax())
    return float(abs(change[:, most].mean())) < BOTH_SIGNS * float(sizes[most])


def _rests(mine: NDArray[np.bool_], contact: NDArray[np.bool_]) -> bool:
    """Whether the mark lies inside a wide contact: an object rests on the gel, and the gel itself is unchanged."""
    around = _dilated(mine, AROUND_PX) & ~mine
    return float(contact[around].mean()) > CONTACT_AROUND
