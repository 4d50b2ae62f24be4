"""frame -> image and back: a camera's picture, the view of it, its lens, and resampling in one pass.

Lens, crop, flip and resize are one remap, then comes a quarter turn. Pixel centers are at integers, so a pixel covers half a
pixel on each side of its number, and resizing maps *areas*: `x_frame = (x_image + 1/2) scale - 1/2 + left`. If an image is
reduced strongly, whole pixels are averaged first, which avoids aliasing.

With a lens the crop is part of the *rectified* frame, which has the frame's size and square pixels on the gel; each of
its pixels is looked up in the frame through the perspective and the distortion.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.arrays import Array, Map, Numbers
from gelform.foundations.checks import as_array, check_choice, check_image, check_is, check_number

# Gray levels, of means of pixels: a channel below or above says nothing of slopes, at either end of a camera's range.
DARK, BRIGHT = 8, 250


@dataclass(frozen=True)
class Frame:
    """One picture of a camera, unchanged.

    Attributes
    ----------
    image : (H, W, 3) uint8, RGB, before any view
    time_s : float
        Time of capture on the monotonic clock, for ages and rates.
    wall_time_ns : int
        Time of capture in UTC, for records.
    index : int
        Number of the frame in its source, from 0; a gap is a dropped frame.
    encoded : the camera's own JPEG, for recorders; None if frames arrive uncompressed
    """

    image: Array
    time_s: float
    wall_time_ns: int
    index: int
    encoded: bytes | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        for name in ("time_s", "wall_time_ns", "index"):
            if not math.isfinite(check_number(getattr(self, name), name)):
                raise ValueError(f"Expected a finite {name} of the frame, got {getattr(self, name)}.")


def pixels_digest(pixels: Array) -> str:
    """SHA-256 (hex) of an image's shape and bytes, which identifies presses and backgrounds.

    The same picture in another dtype has another digest.
    """
    return hashlib.sha256(repr(pixels.shape).encode() + np.ascontiguousarray(pixels).tobytes()).hexdigest()


def as_levels(image: Array) -> NDArray[np.uint8]:
    """An image (H, W, 3), uint8 or float 0-255, in whole gray levels and C order, as a camera would give it."""
    return np.ascontiguousarray(image if image.dtype == np.uint8 else np.rint(image).astype(np.uint8))


def whole_levels(image: Array) -> Array:
    """The image (H, W, 3) as uint8 if its floats 0-255 are all whole, so that the same picture has the same bytes."""
    levels = as_levels(image)
    return levels if levels is image or np.array_equal(levels, image) else image


def rgb_from_bgr(image: Array) -> Array:
    """An image (H, W, 3) whose channels are blue, green, red, in RGB."""
    return np.ascontiguousarray(image[..., ::-1])


def in_rgb(frame: Frame) -> Frame:
    """A frame that came as blue, green, red; the camera's JPEG is left out, because its colors are the wrong ones."""
    return replace(frame, image=rgb_from_bgr(frame.image), encoded=None)


def box_centers(
    start: float, length: float, available: int, count: int, flipped: bool
) -> tuple[Array, slice, int]:
    """Positions of image pixels along one axis of a frame, in boxes of whole frame pixels.

    The axis has `count` image pixels, which show a part of a frame of `available` px. If it is flipped, the first of them is
    at the end of the part. Returns their centers in boxes, the part of the frame to cut out, and the number of frame pixels
    in a box, which is the integer part of the reduction.
    """
    scale = length / count
    box = _box_px(scale)
    first = min(int(start), available - 1)
    last = min(available, int(np.ceil(start + length)))
    centers = (np.arange(count) + 0.5) * scale + start
    if flipped:
        centers = centers[::-1]
    return (centers - first) / box - 0.5, slice(first, last), box


def _box_px(reduction: float) -> int:
    """Whole pixels that are averaged along an axis which is reduced by a factor."""
    return max(1, int(reduction + 0.5))


def averaged(pixels: Array, box: tuple[int, int]) -> Array:
    """Mean of pixels (H, W, 3) over boxes (height, width); the last box repeats the border beyond the frame."""
    if box == (1, 1):
        return pixels
    down, across = (-size % side for size, side in zip(pixels.shape, box))
    if down or across:
        pixels = cv2.copyMakeBorder(pixels, 0, down, 0, across, cv2.BORDER_REPLICATE)
    size = pixels.shape[1] // box[1], pixels.shape[0] // box[0]
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA))


def pixel_positions(shape: tuple[int, int]) -> NDArray[np.int64]:
    """Positions (H*W, 2), x and y, of the pixels of an image (H, W), row by row."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.stack([x.ravel(), y.ravel()], axis=1)


IDENTITY = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)  # homography, row by row
KEYS = ("camera", "distortion", "perspective")


@dataclass(frozen=True)
class Lens:
    """A pinhole camera with Brown's distortion that views a plane from any side.

    ValueError: another count of numbers, a number that is not finite, a focal length <= 0, or a singular perspective.
    """

    camera: tuple[float, ...]  # (fx, fy, cx, cy), px
    # (k1, k2, p1, p2, k3), in the order of OpenCV; missing ones at the end are 0 (D. C. Brown,
    # Photogrammetric Engineering 32(3), 1966)
    distortion: tuple[float, ...] = ()
    # 9 numbers, row by row: homography from rectified pixels to the pixels of the undistorted frame; identity by
    # default
    perspective: tuple[float, ...] = IDENTITY

    def __post_init__(self) -> None:
        for name, counts, words in (
            ("camera", (4,), "4"),
            ("distortion", range(6), "up to 5"),
            ("perspective", (len(IDENTITY),), "9"),
        ):
            wanted = f"the lens's {name} as {words} finite numbers"
            object.__setattr__(self, name, _numbers(getattr(self, name), counts, wanted))
        if min(self.camera[:2]) <= 0:
            raise ValueError(f"Expected focal lengths > 0 px, got {self.camera[:2]}.")
        # Of rows of any length: a homography in px has rows of 1, 1000 and 1e-6.
        lengths = np.prod(np.linalg.norm(self._homography, axis=1))
        if not abs(np.linalg.det(self._homography)) > 1e-12 * lengths:
            raise ValueError(
                f"Expected a perspective that can be undone, got a singular one: {self.perspective}."
            )

    @property
    def _homography(self) -> Numbers:
        return np.asarray(self.perspective, dtype=np.float64).reshape(3, 3)

    def frame_px_from_rectified_px(self, points_px: Array) -> Numbers:
        """Positions (N, 2), x and y, in the frame of points of the rectified plane."""
        flat = cv2.perspectiveTransform(np.asarray(points_px, dtype=np.float64)[None], self._homography)[0]
        return self._distorted(flat)

    def _distorted(self, flat: Numbers) -> Numbers:
        """Positions in the frame of points of the undistorted frame."""
        fx, fy, cx, cy = self.camera
        k1, k2, p1, p2, k3 = (*self.distortion, *[0.0] * (5 - len(self.distortion)))
        x, y = (flat[:, 0] - cx) / fx, (flat[:, 1] - cy) / fy
        square = x * x + y * y
        radial = 1 + square * (k1 + square * (k2 + square * k3))
        return np.stack(
            [
                fx * (x * radial + 2 * p1 * x * y + p2 * (square + 2 * x * x)) + cx,
                fy * (y * radial + p1 * (square + 2 * y * y) + 2 * p2 * x * y) + cy,
            ],
            axis=1,
        )

    def rectified_px_from_frame_px(self, points_px: Array) -> Numbers:
        """Positions (N, 2) in the rectified plane of points of the frame: the inverse of `frame_px_from_rectified_px`.

        By Newton's method: from the given point it approaches the answer from one side.
        """
        distorted = np.asarray(points_px, dtype=np.float64)
        flat = distorted.copy()
        step_px = 1e-3  # of central differences: far above rounding, far below a lens's curvature
        along_x, along_y = np.array([step_px, 0.0]), np.array([0.0, step_px])
        for _ in range(40):
            by_x = (self._distorted(flat + along_x) - self._distorted(flat - along_x)) / (2 * step_px)
            by_y = (self._distorted(flat + along_y) - self._distorted(flat - along_y)) / (2 * step_px)
            (xx, yx), (xy, yy) = by_x.T, by_y.T
            excess_x, excess_y = (self._distorted(flat) - distorted).T
            # The map is folded where it changes area by less than 1e-3, and has no inverse there.
            area = np.maximum(xx * yy - xy * yx, 1e-3)[:, None]
            step = np.stack([yy * excess_x - xy * excess_y, xx * excess_y - yx * excess_x], axis=1) / area
            flat -= np.clip(step, -min(self.camera[:2]), min(self.camera[:2]))
            if np.abs(step).max(initial=0) < 1e-9:
                break
        back = cv2.perspectiveTransform(flat[None], np.linalg.inv(self._homography))
        return np.asarray(back[0], dtype=np.float64)

    def to_dict(self) -> dict[str, list[float]]:
        """The settings, as values that JSON and TOML can hold."""
        return {name: list(getattr(self, name)) for name in KEYS}

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> Lens:
        """A lens from `to_dict` or the `[view.lens]` table of a `sensor.toml`; an unknown key is a ValueError."""
        if not isinstance(settings, Mapping):
            raise ValueError(f"Expected a lens as a table of {', '.join(KEYS)}, got {settings!r}.")
        unknown = [name for name in settings if name not in KEYS]
        if unknown or "camera" not in settings:
            raise ValueError(
                f"Expected settings of a lens among {', '.join(KEYS)} (camera is needed), got {', '.join(settings)}."
            )
        return cls(**settings)


def _lens_of_matrix(matrix: Any) -> Lens:
    """The lens of a frame without distortion, from a homography (9 numbers or 3x3) of its pixels to rectified ones."""
    try:
        numbers = tuple(np.asarray(matrix, dtype=np.float64).ravel().tolist())
    except (TypeError, ValueError):
        numbers = ()
    given = Lens((1, 1, 0, 0), (), numbers)  # without distortion, any camera
    back = np.linalg.inv(given._homography)
    return replace(given, perspective=tuple((back / back[2, 2] if back[2, 2] else back).ravel().tolist()))


def _matrix_of_corners(corners: Any) -> tuple[Any, tuple[float, ...]] | None:
    """OpenCV's matrix that makes four corners (4, 2), px, a rectangle, and its crop; None for a matrix."""
    try:
        points = np.asarray(corners, dtype=np.float32)
    except (TypeError, ValueError):
        return None
    if points.shape != (4, 2):
        return None
    sides = np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1)
    width, height = (float(sides[k] + sides[k + 2]) / 2 for k in (0, 1))
    if not (cv2.isContourConvex(points) and cv2.contourArea(points, oriented=True) > 0):
        raise ValueError(
            "Expected rectify as the corners [x, y] of the gel: upper left, upper right, lower right, lower left, got "
            f"{points.tolist()}, which do not go around it so."
        )
    rectangle = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float32)
    return cv2.getPerspectiveTransform(points, rectangle), (0.0, 0.0, width + 1, height + 1)


THUMBNAIL_PX = 240  # a picture's width in a notebook
PIXEL_VARIANCE = 1 / 12  # px^2, of a place that is anywhere in a pixel


def scale_of(shape: tuple[int, ...]) -> float:
    """Factor for lengths in pixels: 1 for a frame whose shorter side is 240 px."""
    return min(shape[:2]) / 240


MAX_PIXELS = 200e6  # pixels of a frame or an image, at most
FLIPS = ("none", "x", "y", "xy")
TURNS = {"none": 0, "left": 1, "right": -1}  # quarter turns counterclockwise


@dataclass(frozen=True)
class View:
    """The part of a camera's frame that is the image, its orientation and its size in pixels; identity by default.

    Attributes
    ----------
    frame_shape : (H, W) of the camera's frames, or None for frames of any size
        Needed if frames are cropped, resized or have a lens.
    crop : (left, top, width, height) in frame pixels, or None for the whole frame
        Fractions of a pixel are allowed, in a size of 1 or more. Counted in the frame as the camera gives it, before flips.
    flip : "none", "x" (left and right exchanged), "y" (top and bottom), or "xy" (turned by 180 degrees)
    image_shape : (H, W) of the image, or None for the size of the crop, rounded
    lens : Lens or None
        Distortion and perspective to remove; the crop is then in pixels of the rectified frame.
    turn : "none", "left" (a quarter turn counterclockwise) or "right", after the flip; `image_shape` is that of the
        turned image

    Raises
    ------
    ValueError
        A crop outside the frame, sizes that are not positive, an unknown flip, or a missing
        frame_shape.
    """

    frame_shape: tuple[int, int] | None = None
    crop: tuple[float, float, float, float] | None = None
    flip: str = "none"
    image_shape: tuple[int, int] | None = None
    lens: Lens | None = None
    turn: str = "none"

    def __post_init__(self) -> None:
        if self.lens is not None and not isinstance(self.lens, Lens):
            object.__setattr__(self, "lens", Lens.from_dict(self.lens))
        for name in ("frame_shape", "image_shape"):
            if (value := getattr(self, name)) is not None:
                height, width = _numbers(value, (2,), f"{name} as (height, width) in pixels")
                whole = height == int(height) and width == int(width)
                if min(height, width) < 1 or height * width > MAX_PIXELS or not whole:
                    raise ValueError(f"Expected {name} as two whole numbers of pixels, got {value}.")
                object.__setattr__(self, name, (int(height), int(width)))
        if self.crop is not None:
            object.__setattr__(self, "crop", _checked_crop(self.crop, self.frame_shape))
        check_choice(self.flip, FLIPS, "the view's flip")
        check_choice(self.turn, TURNS, "the view's turn")
        if self.frame_shape is None and (self.crop or self.image_shape or self.lens):
            raise ValueError(
                "Expected frame_shape, (height, width) of the frames, in a view that crops, resizes or undoes a lens."
            )

    @property
    def shape(self) -> tuple[int, int] | None:
        """(H, W) of the images of this view; None if any size passes."""
        if self.image_shape is not None or self.frame_shape is None:
            return self.image_shape
        _, _, width, height = self._box
        shape = max(1, round(height)), max(1, round(width))
        return shape if self.turn == "none" else shape[::-1]

    @property
    def is_identity(self) -> bool:
        """Whether images are unchanged frames."""
        if self.flip != "none" or self.turn != "none" or self.lens is not None:
            return False
        if self.frame_shape is None:
            return True
        height, width = self.frame_shape
        return self._box == (0, 0, width, height) and self.shape == self.frame_shape

    @property
    def unturned(self) -> View:
        """The same view without its turn."""
        if self.turn == "none":
            return self
        return replace(self, turn="none", image_shape=self.image_shape and self.image_shape[::-1])

    def of_frames(self, frame_shape: tuple[int, int]) -> View:
        """This view for frames (H, W), if it does not have their size itself."""
        return self if self.frame_shape is not None else replace(self, frame_shape=frame_shape)

    def squared(self, mm_per_px: tuple[float, float]) -> View:
        """This view with square pixels, as wide as the wider side (x, y) of those that it has now.

        The crop loses less than one of the new pixels, so that their sides are exactly equal.
        """
        if self.turn != "none":  # the crop counts in the frame, before the turn
            upright = self.unturned.squared((mm_per_px[1], mm_per_px[0]))
            return replace(upright, turn=self.turn, image_shape=upright._sizes[1][::-1])
        (left, top, width, height), (rows, columns) = self._box, self._sizes[1]
        wider = mm_per_px[0] / max(mm_per_px), mm_per_px[1] / max(mm_per_px)
        shape = max(1, int(rows * wider[1] + 1e-6)), max(1, int(columns * wider[0] + 1e-6))
        kept = (
            width * min(1.0, shape[1] / (columns * wider[0])),
            height * min(1.0, shape[0] / (rows * wider[1])),
        )
        crop = left + (width - kept[0]) / 2, top + (height - kept[1]) / 2, *kept
        return replace(self, crop=crop, image_shape=shape)

    @property
    def _sizes(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """(H, W) of frames and of images, for a view that needs both."""
        if self.frame_shape is None or self.shape is None:
            raise ValueError(
                "Expected a view that knows the size of its frames where points are mapped through it: "
                "view.of_frames((height, width))."
            )
        return self.frame_shape, self.shape

    @property
    def _box(self) -> tuple[float, float, float, float]:
        """(left, top, width, height) of the crop, or of the whole frame."""
        height, width = self.frame_shape or (0, 0)
        return self.crop or (0.0, 0.0, float(width), float(height))

    def to_dict(self) -> dict[str, Any]:
        """The settings that differ from the default, as values that JSON and TOML can hold."""
        plain = {field.name: getattr(self, field.name) for field in fields(self) if field.name != "lens"}
        settings = {
            name: list(v) if isinstance(v, tuple) else v
            for name, v in plain.items()
            if v not in (None, "none")
        }
        return settings if self.lens is None else {**settings, "lens": self.lens.to_dict()}

    @classmethod
    def from_dict(cls, settings: Mapping[str, Any]) -> View:
        """A view from `to_dict` or the `[view]` table of a `sensor.toml`; an unknown key is a ValueError.

        `rectify`, in the place of `lens`, is the matrix that OpenCV's `warpPerspective` takes: frame to rectified pixels. Or
        it is the gel's four corners [x, y] in the frame, px, from the upper left clockwise: the image is the gel alone.
        """
        if "rectify" in settings and "lens" not in settings:
            settings = dict(settings)
            given = settings.pop("rectify")
            if found := _matrix_of_corners(given):
                given, crop = found
                settings.setdefault("crop", crop)
            settings["lens"] = _lens_of_matrix(given)
        known = [field.name for field in fields(cls)]
        unknown = [name for name in settings if name not in known]
        if unknown:
            raise ValueError(
                f"Expected settings of a view among {', '.join(known)}, got {', '.join(unknown)}."
            )
        return cls(**settings)


def image_from_frame(frame: ArrayLike, view: View) -> Array:
    """Make the image, which the path works on, from a camera's frame.

    Parameters
    ----------
    frame : (H, W, 3) RGB, uint8 or float (0-255)
        Of `view.frame_shape`, or of any size if the view has none. If frames and images differ in size, an image passes
        unchanged.
    view : View

    Returns
    -------
    image : view.shape + (3,), dtype of the frame

    Raises
    ------
    ValueError, TypeError
        Another size, or no RGB image (see `checks.check_image`).
    """
    check_is(view, View, "view")
    pixels = check_image(frame, name="frame")
    shape = (pixels.shape[0], pixels.shape[1])
    if view.frame_shape not in (None, shape):
        if shape == view.shape:
            return pixels
        raise ValueError(
            f"Expected a frame of {_text(view.frame_shape)} px (height x width), or an image of {_text(view.shape)} px made "
            f"of it, got {_text(shape)}. Set the camera to that size, or calibrate with frames of this one."
        )
    if view.is_identity:
        return pixels
    if view.turn != "none":
        return np.ascontiguousarray(np.rot90(image_from_frame(pixels, view.unturned), TURNS[view.turn]))
    cut, box, map_x, map_y = _maps_to_image(view.of_frames(shape))
    source = averaged(pixels[cut], box)
    return np.asarray(cv2.remap(source, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))


@lru_cache(maxsize=8)
def _maps_to_image(view: View) -> tuple[tuple[slice, slice], tuple[int, int], Map, Map]:
    """The part of the frame to cut out, the box to average, and maps (h, w) of each image pixel's place in the result.

    The maps are read-only, because threads share them.
    """
    (frame, image), (left, top, width, height) = view._sizes, view._box
    if view.lens is None:
        x, columns, box_x = box_centers(left, width, frame[1], image[1], "x" in view.flip)
        y, rows, box_y = box_centers(top, height, frame[0], image[0], "y" in view.flip)
        cut, box = (rows, columns), (box_y, box_x)
        x, y = np.meshgrid(x, y)
    else:
        cut, box = (slice(None), slice(None)), (_box_px(height / image[0]), _box_px(width / image[1]))
        points = frame_px_from_image_px(pixel_positions(image), view)
        x, y = ((points + 0.5) / box[::-1] - 0.5).T.reshape(2, *image)
    map_x, map_y = x.astype(np.float32), y.astype(np.float32)
    map_x.setflags(write=False)
    map_y.setflags(write=False)
    return cut, box, map_x, map_y


def frame_px_from_image_px(points_px: ArrayLike, view: View) -> Numbers:
    """Positions (N, 2) in the frame, px, of points of the image, x and y."""
    points = np.asarray(as_array(points_px, "points_px"), dtype=np.float64).reshape(-1, 2)
    if view.is_identity:
        return points
    if view.turn != "none":
        (rows, columns), (x, y) = view._sizes[1], points.T
        inner = (rows - 1 - y, x) if view.turn == "left" else (y, columns - 1 - x)
        return frame_px_from_image_px(np.stack(inner, axis=1), view.unturned)
    shape, (left, top, width, height) = view._sizes[1], view._box
    scale = np.divide((width, height), (shape[1], shape[0]))
    rectified = (_flipped(points, view) + 0.5) * scale - 0.5 + (left, top)
    return rectified if view.lens is None else view.lens.frame_px_from_rectified_px(rectified)


def image_px_from_frame_px(points_px: ArrayLike, view: View) -> Numbers:
    """Positions (N, 2) in the image, px, of points of the frame: the inverse of `frame_px_from_image_px`."""
    points = np.asarray(as_array(points_px, "points_px"), dtype=np.float64).reshape(-1, 2)
    if view.is_identity:
        return points
    if view.turn != "none":
        (rows, columns), (x, y) = view._sizes[1], image_px_from_frame_px(points, view.unturned).T
        return np.stack((y, rows - 1 - x) if view.turn == "left" else (columns - 1 - y, x), axis=1)
    shape, (left, top, width, height) = view._sizes[1], view._box
    if view.lens is not None:
        points = view.lens.rectified_px_from_frame_px(points)
    scale = np.divide((shape[1], shape[0]), (width, height))
    return _flipped((points + 0.5 - (left, top)) * scale - 0.5, view)


def _flipped(points: Numbers, view: View) -> Numbers:
    """Points of the image after its flip; a second flip restores them."""
    height, width = view._sizes[1]
    x, y = points.T
    return np.stack(
        [width - 1 - x if "x" in view.flip else x, height - 1 - y if "y" in view.flip else y], axis=1
    )


def _checked_crop(value: Any, frame_shape: tuple[int, int] | None) -> tuple[float, float, float, float]:
    left, top, width, height = _numbers(value, (4,), "crop as (left, top, width, height) in pixels")
    if left < 0 or top < 0 or width < 1 or height < 1:
        raise ValueError(
            f"Expected crop (left, top, width, height), left, top >= 0, a size >= 1 px, got {value}."
        )
    height_available, width_available = (np.inf, np.inf) if frame_shape is None else frame_shape
    if left + width > width_available + 1e-6 or top + height > height_available + 1e-6:
        raise ValueError(
            f"Expected a crop within the frame of {_text(frame_shape)} px (height x width), got one ending "
            f"at column {left + width:g} and row {top + height:g}. A crop is (left, top, width, height)."
        )
    return left, top, width, height


def _numbers(values: Any, counts: Collection[int], wanted: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(value) for value in values)
    except (TypeError, ValueError):
        numbers = (np.nan,)
    if len(numbers) not in counts or not all(np.isfinite(numbers)):
        raise ValueError(f"Expected {wanted}, got {values!r}.")
    return numbers


def _text(shape: tuple[int, ...] | None) -> str:
    return "any" if shape is None else f"{shape[0]}x{shape[1]}"
