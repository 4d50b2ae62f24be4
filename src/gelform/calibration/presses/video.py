"""Presses in a film, or in live frames: the gel at rest, and one still frame of each press.

The film is searched in thumbnails, because a contact changes a large area and noise averages out in them. All distances are
in gray levels: the mean over the 0.7 % of pixels that changed most, after subtracting the change that all pixels share
(flicker, exposure).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.arrays import MIB
from gelform.errors import DataError, Progress
from gelform.foundations.checks import check_image, check_is
from gelform.image.background import trimmed_mean
from gelform.image.view import Frame, View, image_from_frame
from gelform.sensors.playback import USUAL_RATE_HZ, Film

MAX_THUMBS = 6000  # thumbnails that are kept: four minutes at 25 frames a second
STEPS = 64  # steps of a gray level that thumbnails keep
CHUNK = 64  # thumbnails compared at once, to limit memory
MIN_TOUCH = 3.0  # gray levels, smallest change by a contact
MIN_STILL = 5  # frames
BACKGROUND_FRAMES = 60  # frames that are averaged at most
MAX_KEPT_BYTES = 1024 * MIB  # bytes of images kept from an iterator


class Thumbnails:
    """Small copies of a film's frames; if there are too many, every second one is dropped."""

    def __init__(self, most: int = MAX_THUMBS) -> None:
        self.index: list[int] = []  # of the frames that are kept
        self.time_s: list[float] = []
        self.factor = 1.0  # image pixels per thumbnail pixel
        self._small: list[NDArray[np.uint16]] = []
        self._stride, self._most, self._seen = 1, most, 0

    def add(self, image: NDArray[np.uint8], index: int, time_s: float) -> None:
        """Add the next frame of the film."""
        self._seen += 1
        if (self._seen - 1) % self._stride:
            return
        self._small.append((thumbnail(image) * STEPS).astype(np.uint16))
        self.index.append(index)
        self.time_s.append(time_s)
        self.factor = min(image.shape[:2]) / min(self._small[-1].shape[:2])
        if len(self._small) > self._most:
            self._stride *= 2
            for kept in (self._small, self.index, self.time_s):
                del kept[1::2]  # type: ignore[attr-defined]

    def levels(self) -> NDArray[np.float32]:
        """(n, h, w, 3) gray levels."""
        return np.asarray(np.asarray(self._small, dtype=np.float32) / np.float32(STEPS))


@dataclass(frozen=True)
class Still:
    """A stretch in which a contact stands still."""

    best: int  # the thumbnail that is most like all of it
    touch: float  # gray levels by which it differs from the gel at rest
    center_px: tuple[float, float]  # (x, y) of the change, in thumbnail pixels


@dataclass(frozen=True)
class Stretch:
    """A stretch of contact, from thumbnail `start` to before `stop`."""

    start: int
    stop: int
    stills: tuple[Still, ...]
    reason: str | None  # that it has none


def thumbnail(image: NDArray[Any]) -> NDArray[np.float32]:
    """The image averaged down to 36 rows (or columns, whichever are fewer), float32."""
    height, width = image.shape[:2]
    scale = min(1.0, 36 / min(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def distances(levels: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.float64]:
    """Distances of thumbnails (n, h, w, 3) to one (h, w, 3), or to one each."""
    references = np.broadcast_to(reference, levels.shape)
    parts = [np.zeros(0)]
    for at in range(0, len(levels), CHUNK):
        chunk = levels[at : at + CHUNK]
        size = _changed(chunk, references[at : at + CHUNK]).reshape(len(chunk), -1)
        top = max(3, int(0.007 * size.shape[1]))
        strongest = np.partition(size, size.shape[1] - top, axis=1)[:, -top:]
        parts.append(strongest.mean(axis=1).astype(np.float64))
    return np.concatenate(parts)


def _changed(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Size (..., h, w) of the change of each pixel, in gray levels of its strongest channel."""
    change = a - b
    change -= np.median(change[..., ::3, ::3, :], axis=(-3, -2), keepdims=True)
    np.abs(change, out=change)
    size: NDArray[np.float32] = np.maximum(np.maximum(change[..., 0], change[..., 1]), change[..., 2])
    return size


def noise_of(motion: NDArray[np.float64]) -> float:
    """Noise: the distance of two frames without an event; a tenth of the steps are that quiet.

    If everything moves, that is no noise: averaged over a thumbnail's pixel, noise never exceeds 2 gray levels.
    """
    return min(float(np.percentile(motion, 10)), 2.0) if len(motion) else 0.0


def untouched(levels: NDArray[np.float32], motion: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Thumbnails (n,) that show the gel at rest.

    The state at rest is the one that returns: each press looks different, but the gel between them does not. If no state
    returns, the smoothest one is at rest.
    """
    tolerance = max(3 * noise_of(motion), 2.0)
    quiet = np.concatenate([[True], motion <= tolerance]) & np.concatenate([motion <= tolerance, [True]])
    states: list[NDArray[np.bool_]] = []
    unassigned = quiet.copy()
    while unassigned.any() and len(states) < 80:  # so many are tried
        first = int(np.argmax(unassigned))
        near = quiet.copy()
        near[quiet] = distances(levels[quiet], levels[first]) <= tolerance
        states.append(near)
        unassigned &= ~near
        unassigned[first] = False
    states = [state for state in states if np.count_nonzero(state) >= MIN_STILL]
    if not states:
        return np.zeros(len(levels), dtype=bool)
    # times that each state is entered; a single odd frame does not leave it
    visits = [np.count_nonzero(np.diff(np.flatnonzero(state)) > 3) for state in states]
    often = [state for state, count in zip(states, visits) if count == max(visits)]
    means = [levels[state].mean(axis=0) for state in often]
    rough = [np.abs(np.diff(one, axis=0)).mean() + np.abs(np.diff(one, axis=1)).mean() for one in means]
    return often[int(np.argmin(rough))]


def touch_threshold(touch: NDArray[np.float64], noise: float) -> float:
    """Gray levels from which the gel counts as touched: well over the noise, and an eighth of the strongest contact's."""
    strongest = float(np.percentile(touch, 98)) if len(touch) else 0.0
    return max(MIN_TOUCH, 4 * noise, 0.12 * strongest)


def stretches(
    levels: NDArray[np.float32], rest: NDArray[np.float32], noise: float, *, rate_hz: float, factor: float
) -> list[Stretch]:
    """Stretches of contact, with their stills of 0.2 s or more, without those much lighter than the others.

    `levels` (n, h, w, 3) are thumbnails in the order of time, `rate_hz` per second, each pixel `factor` image pixels wide;
    `rest` (h, w, 3) is the one at rest.
    """
    touch = distances(levels, rest)
    shortest = max(MIN_STILL, round(0.2 * rate_hz))
    found = []
    touched = np.concatenate([[False], touch > touch_threshold(touch, noise), [False]])
    edges = np.flatnonzero(np.diff(touched)).reshape(-1, 2)  # from False to True, and back
    for start, stop in edges.tolist():
        stills = []
        for first, last in _still_runs(levels, touch, start, stop, noise, shortest):
            of_still = levels[first:last]
            best = first + int(np.argmin(distances(of_still, of_still.mean(axis=0))))
            stills.append(Still(best, float(np.median(touch[first:last])), center_of(levels[best], rest)))
        found.append((start, stop, _deepest_per_place(stills)))
    touches = [still.touch for _, _, stills in found for still in stills]
    limit = 0.35 * float(np.median(touches)) if touches else 0.0
    kept = []
    for start, stop, stills in found:
        firm = tuple(still for still in stills if still.touch >= limit)
        reason = "the contact is much lighter than the others" if stills and not firm else None
        if not stills:
            reason = _why_no_still(levels[start:stop], rest, touch[start:stop], factor)
        kept.append(Stretch(start, stop, firm, reason))
    return kept


def _still_runs(
    levels: NDArray[np.float32], touch: NDArray[np.float64], start: int, end: int, noise: float, shortest: int
) -> Iterator[tuple[int, int]]:
    """Runs before `end` in which no frame differs from the first by more than 8 % of the contact's change."""
    while start + shortest <= end:
        tolerance, stop = max(3 * noise, 0.08 * float(touch[start])), end
        for at in range(start, end, CHUNK):
            far = distances(levels[at : min(at + CHUNK, end)], levels[start]) > tolerance
            if far.any():
                stop = at + int(np.argmax(far))
                break
        if stop - start >= shortest:
            yield start, stop
            start = stop
        else:
            start += 1


def center_of(level: NDArray[np.float32], rest: NDArray[np.float32]) -> tuple[float, float]:
    """(x, y) of the middle of the changed pixels, in thumbnail pixels, to a fraction of one."""
    size = _changed(level, rest)
    weight = np.maximum(size - 0.3 * size.max(), 0)
    rows, cols = np.indices(size.shape)
    total = max(float(weight.sum()), 1e-9)
    return float((weight * cols).sum() / total), float((weight * rows).sum() / total)


def _deepest_per_place(stills: Sequence[Still]) -> list[Still]:
    """The deepest of the stills at one place (2 px), because a hand that pauses on its way down makes no second press."""
    kept: list[Still] = []
    for still in sorted(stills, key=lambda one: -one.touch):
        if all(np.hypot(*np.subtract(still.center_px, one.center_px)) > 2 for one in kept):
            kept.append(still)
    return sorted(kept, key=lambda one: one.best)


def _why_no_still(
    levels: NDArray[np.float32], rest: NDArray[np.float32], touch: NDArray[np.float64], factor: float
) -> str:
    firm = np.flatnonzero(touch > 0.5 * touch.max())
    moved = float(np.hypot(*np.ptp([center_of(levels[k], rest) for k in firm], axis=0)))
    if len(firm) >= 3 and moved > 0.6:  # px of a thumbnail
        return f"the contact moved by {moved * factor:.0f} px without resting: it slid or rolled"
    if len(levels) <= MIN_STILL:
        return f"the contact lasted {len(levels)} frames: too short"
    return "the contact never rested: its depth kept changing"


@dataclass(frozen=True)
class FilmedPresses:
    """What a film shows of presses."""

    stills: dict[int, NDArray[np.uint8]]  # number of the frame -> image of a press, after the view
    background: NDArray[np.float32]  # (H, W, 3), after the view
    noise: NDArray[np.float64] | None  # (3,), standard deviation of a pixel at rest; None: too few frames
    view: View
    notes: tuple[str, ...]  # parts that were left out, and light that drifted


class _Images:
    """The images of frames, through a view that the first one determines; those of an iterator are kept for later."""

    def __init__(self, frames: Iterable[Frame], view_of: Callable[[tuple[int, int]], View]) -> None:
        self._frames, self._view_of = frames, view_of
        self._once = iter(frames) is frames
        self.view: View | None = None  # from the first frame on
        self._shape: tuple[int, ...] = ()  # (H, W) of the frames
        self._kept: list[Frame] = []
        self._kept_bytes = 0

    def all(self) -> Iterator[Frame]:
        """An image in the place of each frame, which has its position as its number."""
        for frame in self._numbered(None):
            image = self._through_view(frame)
            if self._once:
                self._kept_bytes += image.image.nbytes
                if self._kept_bytes > MAX_KEPT_BYTES:
                    raise DataError(
                        f"Expected at most {MAX_KEPT_BYTES // (1024 * MIB)} GiB of frames from an iterator, got more after "
                        f"{len(self._kept)} frames. Record a video and read that: it is not kept in memory."
                    )
                self._kept.append(image)
            yield image

    def at(self, positions: Collection[int]) -> Iterator[Frame]:
        """The images at some positions, in a second pass."""
        if self._kept:
            return (self._kept[k] for k in sorted(positions))
        return map(self._through_view, self._numbered(positions))

    def _numbered(self, only: Collection[int] | None) -> Iterator[Frame]:
        numbered: Iterable[tuple[int, Frame]] = enumerate(self._frames)
        if isinstance(self._frames, Film):  # decodes no others
            numbered = zip(count() if only is None else sorted(only), self._frames.frames(only))
        for position, frame in numbered:
            check_is(frame, Frame, "each frame")
            if only is None or position in only:
                yield replace(frame, index=position, image=check_image(frame.image, name="each frame"))

    def _through_view(self, frame: Frame) -> Frame:
        height, width = frame.image.shape[:2]
        if self.view is None:
            self.view, self._shape = self._view_of((height, width)), (height, width)
        if (height, width) != self._shape:
            raise DataError(
                f"Expected frames of one size, got {height}x{width} after {self._shape[0]}x{self._shape[1]} px. "
                "Record without changing the camera's mode."
            )
        image = np.ascontiguousarray(image_from_frame(frame.image, self.view))
        return replace(frame, image=image, encoded=None)


def presses_in_film(
    frames: Iterable[Frame],
    view_of: Callable[[tuple[int, int]], View],
    background: NDArray[Any] | None,
    name: str,
    progress: Progress,
) -> FilmedPresses:
    """The presses in frames, or with a given background frame; `view_of` gives the view of frames (H, W).

    The frames are read twice if possible. Errors as in `presses_from_frames`; `name` is for messages.
    """
    images, thumbs = _Images(frames, view_of), Thumbnails()
    shape: tuple[int, ...] = ()
    for frame in images.all():
        thumbs.add(frame.image, frame.index, frame.time_s)
        shape = frame.image.shape
        if frame.index % round(USUAL_RATE_HZ) == 0:
            progress(frame.index, 0, "looking through the frames")
    if images.view is None:
        raise DataError(f"No frame in {name}. Expected a sequence that shows the gel at rest and presses.")
    given = None if background is None else image_from_frame(background, images.view).astype(np.float32)
    if given is not None and given.shape != shape:
        raise DataError(f"Expected a background of the frames' size, {shape[:2]} px, got {given.shape[:2]}.")
    rest, found = _analysed(thumbs, given, name)
    pressed = {thumbs.index[still.best] for stretch in found for still in stretch.stills}
    (at_rest,) = np.nonzero(rest)
    if len(at_rest) > BACKGROUND_FRAMES:  # so many of them, evenly spaced
        at_rest = at_rest[np.linspace(0, len(at_rest) - 1, BACKGROUND_FRAMES).round().astype(int)]
    stills, rests = {}, []
    for frame in images.at(pressed | {thumbs.index[k] for k in at_rest}):
        if frame.index in pressed:
            stills[frame.index] = frame.image
        else:
            rests.append(frame.image)
        progress(len(stills), len(pressed), "taking the stills")
    average, noise = trimmed_mean(rests) if rests else (given, None)
    mean = average if given is None else given
    assert mean is not None
    noise = noise if len(rests) >= MIN_STILL else None
    left_out = [
        f"{thumbs.time_s[one.start]:.2f}-{thumbs.time_s[one.stop - 1]:.2f} s are left out: {one.reason}."
        for one in found
        if one.reason is not None
    ]
    return FilmedPresses(stills, mean, noise, images.view, (*left_out, *_drift(thumbs, rest)))


def _analysed(
    thumbs: Thumbnails, background: NDArray[Any] | None, name: str
) -> tuple[NDArray[np.bool_], list[Stretch]]:
    """The thumbnails at rest and the stretches of contact, checked for a usable film."""
    levels = thumbs.levels()
    motion = distances(levels[1:], levels[:-1])
    noise = noise_of(motion)
    if background is None:
        rest = untouched(levels, motion)
        if np.count_nonzero(rest) < MIN_STILL:
            raise DataError(
                f"No stretch of the gel at rest in {name}: expected at least {MIN_STILL} such frames in a row "
                f"among its {len(levels)}. Film the gel at rest for two seconds before the first press, or give "
                "background= (--background)."
            )
        reference = levels[rest].mean(axis=0)
    else:
        reference = thumbnail(background)
        rest = distances(levels, reference) <= max(2.0, 3 * noise)
    span = thumbs.time_s[-1] - thumbs.time_s[0]
    rate = (len(levels) - 1) / span if span > 0 else USUAL_RATE_HZ
    found = stretches(levels, reference, noise, rate_hz=rate, factor=thumbs.factor)
    if not found:
        touch = distances(levels, reference)
        raise DataError(
            f"No contact in {name}: over {len(touch)} frames no part of the image changes by more than "
            f"{touch.max():.1f} gray levels (expected over {touch_threshold(touch, noise):.1f}; a firm press changes "
            f"{10 * MIN_TOUCH:.0f} or more). Press a ball firmly at many places."
        )
    if not any(stretch.stills for stretch in found):
        reasons = sorted({stretch.reason.split(" by ")[0] for stretch in found if stretch.reason})
        raise DataError(
            f"No press in {name}: none of the {len(found)} contacts rests ({'; '.join(reasons)}). Press the ball "
            "down, hold it still for half a second, lift it, and go to the next place."
        )
    return rest, found


def _drift(thumbs: Thumbnails, rest: NDArray[np.bool_]) -> list[str]:
    """A note if the brightness of the gel at rest changes by over 3 % from start to end."""
    (times,) = np.nonzero(rest)
    if len(times) < 2 * MIN_STILL:
        return []
    levels = thumbs.levels()
    first, last = (levels[part].mean(axis=(0, 1, 2)) for part in (times[:MIN_STILL], times[-MIN_STILL:]))
    ratio = last / np.maximum(first, 1)
    if np.abs(ratio - 1).max() <= 0.03:
        return []
    figures = ", ".join(f"{name} {value:.2f}" for name, value in zip("RGB", ratio))
    return [
        f"The light drifted: the gel at rest is {figures} times as bright at the end as at the start. Fix exposure "
        "and white balance, and let the sensor warm up."
    ]
