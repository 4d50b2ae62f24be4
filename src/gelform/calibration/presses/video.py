"""Presses from a video or from live frames: the stretch at rest, and one still frame of each press.

The parts of a sequence with the gel at rest, and those in which a contact stands still.

It works on thumbnails, because a contact changes a large area and noise averages out in them. All distances are
in gray levels: the mean over the pixels that changed most, after subtracting the change that all pixels share
(flicker, exposure).
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses.press_set import (
    Listed,
    Presses,
    ReadOptions,
    press_from_frame,
    presses_from_settings,
)
from gelform.errors import DataError
from gelform.foundations.checks import check_is, check_path
from gelform.foundations.findings import Progress, no_progress
from gelform.image.background import trimmed_mean
from gelform.image.frame import Frame
from gelform.image.view import View, image_from_frame
from gelform.sensors.files import read_background
from gelform.sensors.films import Video, open_film

THUMB_ROWS = 36  # px of a thumbnail's shorter side
MAX_THUMBS = 6000  # thumbnails that are kept: four minutes at 25 frames a second
MOST_CHANGED = 0.007  # fraction of a thumbnail's pixels that changed most
MIN_TOUCH = 3.0  # gray levels, smallest change by a contact
TOUCH_OVER_NOISE = 4.0  # times the noise
TOUCH_OVER_STRONGEST = 0.12  # of the strongest contact's change
MIN_STILL = 5  # frames
MIN_STILL_S = 0.2  # seconds
MOVED_OVER_TOUCH = 0.08  # of the contact's change; more is motion
SAME_PLACE_PX = 2.0  # px of a thumbnail; closer contacts are at the same place
MOVED_PX = 0.6  # px of a thumbnail; a contact that moved more slid or rolled
LIGHT_TOUCH = 0.35  # of the median contact's change; less is too light
MAX_STATES = 80  # states that are tried as the one at rest
MAX_NOISE = 2.0  # gray levels of a thumbnail
CHUNK = 64  # thumbnails compared at once, to limit memory
_SCALE = 64  # steps of a gray level that thumbnails keep


class Thumbnails:
    """Small copies of a sequence's frames; if there are too many, every second one is dropped.

    Attributes
    ----------
    index, time_s : of the frames that are kept
    factor : image pixels per thumbnail pixel
    """

    def __init__(self, most: int = MAX_THUMBS) -> None:
        self.index: list[int] = []
        self.time_s: list[float] = []
        self.factor = 1.0
        self._small: list[NDArray[np.uint16]] = []
        self._stride, self._most, self._seen = 1, most, 0

    def add(self, image: NDArray[np.uint8], index: int, time_s: float) -> None:
        """Add the next frame of the sequence."""
        self._seen += 1
        if (self._seen - 1) % self._stride:
            return
        self._small.append((thumbnail(image) * _SCALE).astype(np.uint16))
        self.index.append(index)
        self.time_s.append(time_s)
        self.factor = min(image.shape[:2]) / min(self._small[-1].shape[:2])
        if len(self._small) > self._most:
            self._stride *= 2
            for kept in (self._small, self.index, self.time_s):
                del kept[1::2]  # type: ignore[attr-defined]

    def levels(self) -> NDArray[np.float32]:
        """(n, h, w, 3) gray levels."""
        return np.asarray(np.asarray(self._small, dtype=np.float32) / np.float32(_SCALE))


@dataclass(frozen=True)
class Still:
    """A stretch in which a contact stands still.

    Attributes
    ----------
    start, stop : thumbnails from start to before stop
    best : the thumbnail that is most like all of them
    touch : gray levels by which they differ from the gel at rest
    center_px : (x, y) of the change, in thumbnail pixels
    """

    start: int
    stop: int
    best: int
    touch: float
    center_px: tuple[float, float]


@dataclass(frozen=True)
class Stretch:
    """A stretch of contact: its stills, and the reason that it has none or that others were left out."""

    start: int
    stop: int
    stills: tuple[Still, ...]
    reason: str | None


def thumbnail(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """The image averaged down to 36 rows (or columns, whichever are fewer), float32."""
    height, width = image.shape[:2]
    scale = min(1.0, THUMB_ROWS / min(height, width))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(image.astype(np.float32), size, interpolation=cv2.INTER_AREA))


def distances(levels: NDArray[np.float32], reference: NDArray[np.float32]) -> NDArray[np.float64]:
    """Distances of thumbnails (n, h, w, 3) to one (h, w, 3), or to one each."""
    references = np.broadcast_to(reference, levels.shape)
    parts = [
        _distances(levels[at : at + CHUNK], references[at : at + CHUNK])
        for at in range(0, len(levels), CHUNK)
    ]
    return np.concatenate(parts) if parts else np.zeros(0)


def _distances(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float64]:
    size = _changed(a, b).reshape(len(a), -1)
    top = max(3, int(MOST_CHANGED * size.shape[1]))
    strongest = np.partition(size, size.shape[1] - top, axis=1)[:, -top:]
    return np.asarray(strongest.mean(axis=1), dtype=np.float64)


def _changed(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """Size (..., h, w) of the change of each pixel, in gray levels of its strongest channel."""
    change = a - b
    change -= np.median(change[..., ::3, ::3, :], axis=(-3, -2), keepdims=True)
    np.abs(change, out=change)
    size: NDArray[np.float32] = np.maximum(np.maximum(change[..., 0], change[..., 1]), change[..., 2])
    return size


def noise_of(motion: NDArray[np.float64]) -> float:
    """Noise: the distance of two frames without an event; a tenth of the steps are that quiet.

    If everything moves, that is no noise: averaged over a thumbnail's pixel, noise never exceeds `MAX_NOISE`.
    """
    return min(float(np.percentile(motion, 10)), MAX_NOISE) if len(motion) else 0.0


def untouched(levels: NDArray[np.float32], motion: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Thumbnails (n,) that show the gel at rest.

    The state at rest is the one that returns: each press looks different, but the gel between them does not. If no state
    returns, the smoothest one is at rest.
    """
    noise = noise_of(motion)
    tolerance = max(3 * noise, 2.0)
    quiet = np.concatenate([[True], motion <= tolerance]) & np.concatenate([motion <= tolerance, [True]])
    states: list[NDArray[np.bool_]] = []
    unassigned = quiet.copy()
    while unassigned.any() and len(states) < MAX_STATES:
        first = int(np.argmax(unassigned))
        near = quiet.copy()
        near[quiet] = distances(levels[quiet], levels[first]) <= tolerance
        states.append(near)
        unassigned &= ~near
        unassigned[first] = False
    states = [state for state in states if np.count_nonzero(state) >= MIN_STILL]
    if not states:
        return np.zeros(len(levels), dtype=bool)
    visits = np.array([_visits(state) for state in states])
    often = [state for state, count in zip(states, visits) if count == visits.max()]
    return often[0] if len(often) == 1 else min(often, key=lambda state: _roughness(levels[state]))


def _visits(state: NDArray[np.bool_]) -> int:
    """Number of times that a state is entered; a single odd frame does not leave it."""
    return int(1 + np.count_nonzero(np.diff(np.flatnonzero(state)) > 3))


def _roughness(levels: NDArray[np.float32]) -> float:
    mean = levels.mean(axis=0)
    return float(np.abs(np.diff(mean, axis=0)).mean() + np.abs(np.diff(mean, axis=1)).mean())


def touch_threshold(touch: NDArray[np.float64], noise: float) -> float:
    """Gray levels from which the gel counts as touched."""
    strongest = float(np.percentile(touch, 98)) if len(touch) else 0.0
    return max(MIN_TOUCH, TOUCH_OVER_NOISE * noise, TOUCH_OVER_STRONGEST * strongest)


def stretches(
    levels: NDArray[np.float32], rest: NDArray[np.float32], noise: float, *, rate_hz: float, factor: float
) -> list[Stretch]:
    """Stretches of contact, with their stills.

    `levels` (n, h, w, 3) are thumbnails in the order of time, `rate_hz` per second, each pixel `factor` image pixels wide;
    `rest` (h, w, 3) is the one at rest.
    """
    touch = distances(levels, rest)
    touched = touch > touch_threshold(touch, noise)
    shortest = max(MIN_STILL, round(MIN_STILL_S * rate_hz))
    found = []
    for start, stop in runs(touched):
        runs_of = _still_runs(levels[start:stop], touch[start:stop], noise, shortest)
        stills = [_still(levels, rest, touch, start + a, start + b) for a, b in runs_of]
        found.append(_stretch(levels, rest, touch, start, stop, _deepest_per_place(stills), factor))
    return _without_light(found)


def runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """(start, stop) of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(np.int8), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2])]


def _still_runs(
    levels: NDArray[np.float32], touch: NDArray[np.float64], noise: float, shortest: int
) -> list[tuple[int, int]]:
    """Runs in which no frame differs from the first by more than a small part of the contact's change."""
    found, start = [], 0
    while start + shortest <= len(levels):
        tolerance = max(3 * noise, MOVED_OVER_TOUCH * float(touch[start]))
        stop = start + _length_within(levels[start:], tolerance)
        if stop - start >= shortest:
            found.append((start, stop))
            start = stop
        else:
            start += 1
    return found


def _length_within(levels: NDArray[np.float32], tolerance: float) -> int:
    """Number of thumbnails from the first on that are within a distance of it."""
    for at in range(0, len(levels), CHUNK):
        far = distances(levels[at : at + CHUNK], levels[0]) > tolerance
        if far.any():
            return at + int(np.argmax(far))
    return len(levels)


def _still(
    levels: NDArray[np.float32],
    rest: NDArray[np.float32],
    touch: NDArray[np.float64],
    start: int,
    stop: int,
) -> Still:
    mean = levels[start:stop].mean(axis=0)
    best = start + int(np.argmin(distances(levels[start:stop], mean)))
    return Still(start, stop, best, float(np.median(touch[start:stop])), center_of(levels[best], rest))


def center_of(level: NDArray[np.float32], rest: NDArray[np.float32]) -> tuple[float, float]:
    """(x, y) of the middle of the changed pixels, in thumbnail pixels, to a fraction of one."""
    size = _changed(level, rest)
    weight = np.maximum(size - 0.3 * size.max(), 0)
    rows, cols = np.indices(size.shape)
    total = max(float(weight.sum()), 1e-9)
    return float((weight * cols).sum() / total), float((weight * rows).sum() / total)


def _deepest_per_place(stills: Sequence[Still]) -> tuple[Still, ...]:
    """The deepest of the stills at one place, because a hand that pauses on its way down makes no second press."""
    kept: list[Still] = []
    for still in sorted(stills, key=lambda one: -one.touch):
        if all(np.hypot(*np.subtract(still.center_px, one.center_px)) > SAME_PLACE_PX for one in kept):
            kept.append(still)
    return tuple(sorted(kept, key=lambda one: one.start))


def _stretch(
    levels: NDArray[np.float32],
    rest: NDArray[np.float32],
    touch: NDArray[np.float64],
    start: int,
    stop: int,
    stills: tuple[Still, ...],
    factor: float,
) -> Stretch:
    if stills:
        return Stretch(start, stop, stills, None)
    firm = start + np.flatnonzero(touch[start:stop] > 0.5 * touch[start:stop].max())
    moved = float(np.hypot(*np.ptp([center_of(levels[k], rest) for k in firm], axis=0)))
    if len(firm) >= 3 and moved > MOVED_PX:
        reason = f"the contact moved by {moved * factor:.0f} px without resting: it slid or rolled"
    elif stop - start <= MIN_STILL:
        reason = f"the contact lasted {stop - start} frames: too short"
    else:
        reason = "the contact never rested: its depth kept changing"
    return Stretch(start, stop, (), reason)


def _without_light(found: Sequence[Stretch]) -> list[Stretch]:
    """Stretches without the stills that are much lighter than the others."""
    touches = [still.touch for stretch in found for still in stretch.stills]
    limit = LIGHT_TOUCH * float(np.median(touches)) if touches else 0.0
    kept = []
    for stretch in found:
        firm = tuple(still for still in stretch.stills if still.touch >= limit)
        light = len(firm) < len(stretch.stills) and not firm
        reason = "the contact is much lighter than the others" if light else stretch.reason
        kept.append(Stretch(stretch.start, stretch.stop, firm, reason))
    return kept


BACKGROUND_FRAMES = 60  # frames that are averaged at most
MAX_KEPT_BYTES = 1 << 30  # bytes of images kept from an iterator
DRIFT_WARN = 0.03  # relative change of the brightness of the gel at rest


def presses_from_frames(
    frames: Iterable[Frame],
    *,
    ball_diameter_mm: float,
    mm_per_px: float | tuple[float, float] | None = None,
    sensor: str | None = None,
    background: NDArray[Any] | None = None,
    crop: tuple[float, float, float, float] | None = None,
    name: str = "frames",
    progress: Progress = no_progress,
) -> Presses:
    """Find the presses of a ball in a sequence of frames.

    The gel at rest is the state that returns between the presses. The background is the trimmed mean of its frames, and
    their scatter is the noise. One frame of each contact that stands still becomes a press. Frames in which a contact
    slides, rolls or is pressed down are left out; `notes` of the result list them with the reasons.

    Parameters
    ----------
    frames : in the order of time, with some of the gel at rest; RGB
        They are read twice if possible (`gelform.Video`, a list). The images of an iterator, such as a camera, are kept
        in memory, up to 1 GiB.
    ball_diameter_mm : diameter of the ball
    mm_per_px, sensor : the scale, or the profile that has it
    background : (H, W, 3) background frame, 0-255, for a sequence without one
    crop : (left, top, width, height) in pixels of the frame
    name : prefix of the presses' names
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        No frame, no scale, no stretch at rest, no contact, none that stands still, or an iterator of more
        than 1 GiB.
    """
    check_is(frames, Iterable, "frames")  # type: ignore[type-abstract]
    place = check_path(check_is(name, str, "name"), "name")
    view = _ViewOfFrames(ReadOptions(sensor, mm_per_px, ball_diameter_mm, None, crop), place)
    if iter(frames) is frames:
        frames = _kept(frames, view)
    return _presses(frames, view, background, name, progress)


def presses_from_film(path: Path, options: ReadOptions, progress: Progress = no_progress) -> Presses:
    """`presses_from_frames` for a video or a recording, read twice; a `sensor.toml` next to it can hold settings."""
    options.ball(str(path))
    background = None if options.background is None else read_background(options.background, bgr=options.bgr)
    film = open_film(path)
    return _presses(film, _ViewOfFrames(options, path), background, str(path), progress)


class _ViewOfFrames:
    """The view of frames, known from the first frame on."""

    def __init__(self, options: ReadOptions, place: Path) -> None:
        self.options, self.settings = options, options.settings(place)
        self.view: View | None = None
        self.frame_shape: tuple[int, int] | None = None
        self.is_done = False  # the frames are already images

    def __call__(self, frame: NDArray[Any]) -> NDArray[Any]:
        if self.is_done:
            return frame
        frame = self.options.in_rgb(frame)
        shape = (frame.shape[0], frame.shape[1])
        if self.view is None:
            self.view, self.frame_shape = self.options.view(self.settings, shape), shape
        if shape != self.frame_shape:
            assert self.frame_shape is not None
            height, width = self.frame_shape
            raise DataError(
                f"Expected frames of one size, got {shape[0]}x{shape[1]} after {height}x{width} px. "
                "Record without changing the camera's mode."
            )
        return image_from_frame(frame, self.view)


def _kept(frames: Iterable[Frame], view: _ViewOfFrames) -> list[Frame]:
    """The frames of an iterator, as images, because it can be read only once."""
    kept: list[Frame] = []
    size = 0
    for frame in frames:
        image = np.ascontiguousarray(view(frame.image))
        size += image.nbytes
        if size > MAX_KEPT_BYTES:
            raise DataError(
                f"Expected at most {MAX_KEPT_BYTES >> 30} GiB of frames from an iterator, got more after "
                f"{len(kept)} frames. Record a video and read that: it is not kept in memory."
            )
        kept.append(Frame(image, frame.time_s, frame.wall_time_ns, frame.index))
    view.is_done = True
    return kept


def _selected(frames: Iterable[Frame], only: Container[int] | None = None) -> Iterator[Frame]:
    """The frames, or those at a position in `only`; each has its position as its number."""
    if isinstance(frames, Video):  # decodes no others
        yield from frames.frames(only)
        return
    for position, frame in enumerate(frames):
        check_is(frame, Frame, "each frame")
        if not isinstance(frame.time_s, (int, float)) or not np.isfinite(frame.time_s):
            raise TypeError(
                f"Expected time_s of frame {position} in seconds, got {frame.time_s!r}. Without a clock, divide the frame's "
                "number by the rate of the camera."
            )
        if only is None or position in only:
            yield Frame(frame.image, frame.time_s, frame.wall_time_ns, position)


def _presses(
    frames: Iterable[Frame],
    view: _ViewOfFrames,
    background: NDArray[Any] | None,
    name: str,
    progress: Progress,
) -> Presses:
    thumbs, shape = Thumbnails(), (0, 0)
    for count, frame in enumerate(_selected(frames)):
        image = view(frame.image)
        shape = image.shape
        thumbs.add(image, frame.index, frame.time_s)
        if count % 25 == 0:
            progress(count, 0, "looking through the frames")
    if not thumbs.index:
        raise DataError(f"No frame in {name}. Expected a sequence that shows the gel at rest and presses.")
    rest_reference = None if background is None else image_from_frame(background, view.view or View())
    if rest_reference is not None and rest_reference.shape != shape:
        raise DataError(
            f"Expected a background of the frames' size, {shape[:2]} px, got {rest_reference.shape[:2]}."
        )
    rest, found = _analysed(thumbs, rest_reference, name)
    picked = {thumbs.index[still.best]: still for stretch in found for still in stretch.stills}
    at_rest = _spread(np.flatnonzero(rest), BACKGROUND_FRAMES)
    wanted = {thumbs.index[k] for k in at_rest} | picked.keys()
    presses, rest_images = [], []
    for frame in _selected(frames, wanted):
        if frame.index in picked:
            assert view.view is not None
            listed = Listed(f"{Path(name).stem}, frame {frame.index}", view.options.ball(name))
            presses.append(press_from_frame(listed, view(frame.image), View()))
        else:
            rest_images.append(np.ascontiguousarray(view(frame.image)))
        progress(len(presses), len(picked), "taking the stills")
    mean, noise = trimmed_mean(rest_images) if rest_images else (None, None)
    if len(rest_images) < MIN_STILL:
        noise = None  # too few to measure it
    notes = (*_notes(thumbs, found), *_drift(thumbs, rest))
    if rest_reference is not None:
        mean = rest_reference.astype(np.float32)
    assert mean is not None
    assert view.view is not None
    more = {"background_noise": noise, "notes": notes}
    return presses_from_settings(view.settings, name, presses, mean, view.view, **more)


def _analysed(
    thumbs: Thumbnails, background: NDArray[Any] | None, name: str
) -> tuple[NDArray[np.bool_], list[Stretch]]:
    """The thumbnails at rest and the stretches of contact, checked for a usable sequence."""
    levels = thumbs.levels()
    motion = distances(levels[1:], levels[:-1])
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
        reference = thumbnail(np.asarray(background))
        rest = distances(levels, reference) <= max(2.0, 3 * noise_of(motion))
    noise = noise_of(motion)
    span = thumbs.time_s[-1] - thumbs.time_s[0]
    rate = (len(levels) - 1) / span if span > 0 else 25.0
    found = stretches(levels, reference, noise, rate_hz=rate, factor=thumbs.factor)
    _check_presses(found, distances(levels, reference), noise, name)
    return rest, found


def _check_presses(found: list[Stretch], touch: NDArray[np.float64], noise: float, name: str) -> None:
    if not found:
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


def _spread(indices: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """At most a given number of items, evenly spaced."""
    if len(indices) <= most:
        return indices
    return indices[np.linspace(0, len(indices) - 1, most).round().astype(int)]


def _notes(thumbs: Thumbnails, found: list[Stretch]) -> tuple[str, ...]:
    notes = []
    for stretch in found:
        if stretch.reason is not None:
            start, stop = thumbs.time_s[stretch.start], thumbs.time_s[stretch.stop - 1]
            notes.append(f"{start:.2f}-{stop:.2f} s are left out: {stretch.reason}.")
    return tuple(notes)


def _drift(thumbs: Thumbnails, rest: NDArray[np.bool_]) -> tuple[str, ...]:
    """A note if the brightness of the gel at rest changes from start to end."""
    times = np.flatnonzero(rest)
    if len(times) < 2 * MIN_STILL:
        return ()
    levels = thumbs.levels()
    first, last = (levels[part].mean(axis=(0, 1, 2)) for part in (times[:MIN_STILL], times[-MIN_STILL:]))
    ratio = last / np.maximum(first, 1)
    if np.abs(ratio - 1).max() <= DRIFT_WARN:
        return ()
    figures = ", ".join(f"{name} {value:.2f}" for name, value in zip("RGB", ratio))
    return (
        f"The light drifted: the gel at rest is {figures} times as bright at the end as at the start. Fix exposure "
        "and white balance, and let the sensor warm up.",
    )
