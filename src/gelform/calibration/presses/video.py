"""Presses from a video or from live frames: the stretch at rest, and one still frame of each press."""

from __future__ import annotations

from collections.abc import Callable, Container, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gelform.calibration.presses.press_set import (
    Listed,
    Presses,
    ReadOptions,
    press_from_frame,
    presses_from_settings,
)
from gelform.calibration.presses.stills import (
    MIN_STILL,
    MIN_TOUCH,
    Stretch,
    Thumbnails,
    distances,
    noise_of,
    stretches,
    thumbnail,
    touch_threshold,
    untouched,
)
from gelform.errors import DataError
from gelform.foundations.checks import check_is, check_path
from gelform.foundations.progress import Progress, no_progress
from gelform.image.background.average import trimmed_mean
from gelform.image.frame import Frame
from gelform.image.view import View, image_from_frame
from gelform.sensors.files import read_background
from gelform.sensors.video_files import Video

BACKGROUND_FRAMES = 60  # frames that are averaged at most
MAX_KEPT_BYTES = 1 << 30  # bytes of images kept from an iterator
DRIFT_WARN = 0.03  # relative change of the brightness of the gel at rest

Reader = Callable[[Container[int] | None], Iterable[Frame]]


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
    return _presses(lambda only: _selected(frames, only), view, background, name, progress)


def presses_from_video(path: Path, options: ReadOptions, progress: Progress = no_progress) -> Presses:
    """`presses_from_frames` for a video file, read twice; a `sensor.toml` next to it can hold settings."""
    options.ball(str(path))
    background = None if options.background is None else read_background(options.background, bgr=options.bgr)
    video = Video(path)
    return _presses(video.frames, _ViewOfFrames(options, path), background, str(path), progress)


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


def _selected(frames: Iterable[Frame], only: Container[int] | None) -> Iterator[Frame]:
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
    read: Reader, view: _ViewOfFrames, background: NDArray[Any] | None, name: str, progress: Progress
) -> Presses:
    thumbs, shape = Thumbnails(), (0, 0)
    for count, frame in enumerate(read(None)):
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
    for frame in read(wanted):
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
