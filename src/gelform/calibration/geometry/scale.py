"""mm per pixel with its uncertainty and origin, and the view that removes distortion, from images of a grid on the gel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from gelform.errors import DataError
from gelform.foundations.checks import (
    LARGEST,
    check_image,
    check_list,
    check_numbers,
    check_positive,
    check_within,
)
from gelform.image.background import CHANGE_OFFSET, ChangeSettings, PreparedBackground
from gelform.image.view import Lens, View
from gelform.sensors.profiles import profile_named

MAX_DISAGREEMENT = 4.0  # standard deviations between two scales


@dataclass(frozen=True)
class Scale:
    """Pixel pitch on the gel.

    Attributes
    ----------
    mm_per_px : mm per image pixel (square pixels)
    sigma : its standard deviation, mm
    source : target that it was measured on, with the figures
    along_x : square of the cosine between the measured length and the image's x axis; None if both axes were measured
    """

    mm_per_px: float
    sigma: float
    source: str
    along_x: float | None = None

    def __post_init__(self) -> None:
        check_positive(self.mm_per_px, "mm_per_px")
        check_positive(self.sigma, "sigma")
        if self.along_x is not None:
            check_within(self.along_x, "along_x", 0, 1)


def scale_from_profile(name: str) -> Scale:
    """The scale of a sensor profile; its sigma includes the differences between units."""
    profile = profile_named(name)
    return Scale(profile.mm_per_px, profile.mm_per_px_sigma, f"profile {name}: {profile.source}")


def scale_from_points(
    a_px: tuple[float, float],
    b_px: tuple[float, float],
    distance_mm: float,
    *,
    sigma_px: float = 0.5,
    sigma_mm: float = 0.0,
) -> Scale:
    """The scale from two marked points with a known distance.

    Parameters
    ----------
    a_px, b_px : (x, y) in pixels of the image, after the view
    distance_mm : between them, on the gel
    sigma_px : standard deviation of each coordinate that was marked by hand, px
    sigma_mm : standard deviation of the distance, mm

    Raises
    ------
    ValueError
        The points are nearer than 10 `sigma_px`, or a length is not positive.
    """
    a, b = check_numbers(a_px, "a_px", 2), check_numbers(b_px, "b_px", 2)
    check_positive(distance_mm, "distance_mm")
    check_positive(sigma_px, "sigma_px")
    distance_px = float(np.hypot(a[0] - b[0], a[1] - b[1]))
    if not (np.isfinite(distance_px) and distance_px > 10 * sigma_px):
        raise ValueError(
            f"Expected two points at least {10 * sigma_px:g} px apart, got {distance_px:.3g} px. "
            "Mark two that are far apart: the scale is as good as their distance is long."
        )
    source = f"two points {distance_px:.1f} px and {distance_mm:g} mm apart"
    scale = scale_from_lengths(distance_mm, distance_px, sigma_mm, np.sqrt(2) * sigma_px, source)
    return replace(scale, along_x=((a[0] - b[0]) / distance_px) ** 2)


def scale_from_lengths(mm: float, px: float, sigma_mm: float, sigma_px: float, source: str) -> Scale:
    """Scale, mm/px, from one length known in both units, with the uncertainty of both."""
    pitch = check_positive(mm, "length_mm") / check_positive(px, "length_px")
    sigma_mm = check_within(sigma_mm, "sigma_mm", 0, LARGEST)
    return Scale(pitch, float(pitch * np.hypot(sigma_mm / mm, sigma_px / px)), source)


def combined_scale(scales: Sequence[Scale]) -> Scale:
    """The mean of several scales, weighted by their inverse variances.

    Raises
    ------
    DataError
        Two of them are more than four standard deviations apart; one is wrong, and a mean would hide it. Or pixels are not
        square: if lengths along both axes show that, the message has the pair to write.
    """
    scales = check_list(scales, "scales", Scale)
    if not scales:
        raise ValueError(
            "Expected one scale or more, from two marked points, a step of a stage, or a grid, got none."
        )
    for i, a in enumerate(scales):
        for b in scales[i + 1 :]:
            apart = abs(a.mm_per_px - b.mm_per_px) / np.hypot(a.sigma, b.sigma)
            if apart > MAX_DISAGREEMENT:
                raise DataError(
                    f"Expected scales that agree, got {a.mm_per_px:.5g} +- {a.sigma:.2g} mm/px ({a.source}) and "
                    f"{b.mm_per_px:.5g} +- {b.sigma:.2g} mm/px ({b.source}): {apart:.1f} standard deviations apart. "
                    f"{_not_square(scales) or 'Leave the wrong one out.'}"
                )
    weight = np.array([1 / scale.sigma**2 for scale in scales])
    mean = float(weight @ [scale.mm_per_px for scale in scales] / weight.sum())
    return Scale(mean, float(weight.sum() ** -0.5), "; ".join(scale.source for scale in scales))


def _not_square(scales: Sequence[Scale]) -> str:
    """What to write if lengths in several directions agree on pixels that are not square; empty if they do not."""
    along = np.array([scale.along_x for scale in scales if scale.along_x is not None])
    if len(along) < len(scales) or np.ptp(along) < 0.5:  # of cos^2; it is 1 for lengths along both axes
        return ""
    pitch, sigma = (np.array([getattr(scale, name) for scale in scales]) for name in ("mm_per_px", "sigma"))
    design = np.stack([along, 1 - along], axis=1)  # pitch^2 = x^2 cos^2 + y^2 sin^2
    weight = 1 / (2 * pitch * sigma)
    squares = np.linalg.lstsq(design * weight[:, None], pitch**2 * weight, rcond=None)[0]
    residual = np.abs(design @ squares - pitch**2) * weight
    if squares.min() <= 0 or residual.max() > MAX_DISAGREEMENT:
        return ""
    x, y = np.sqrt(squares)
    return (
        f"The pixels are not square: mm_per_px = [{x:.5g}, {y:.5g}] fits all of them. Write that into sensor.toml. "
        "Or leave the wrong one out."
    )


def scale_from_stage(
    first: NDArray[Any],
    second: NDArray[Any],
    background: NDArray[Any],
    distance_mm: float,
    *,
    sigma_mm: float = 0.005,
) -> Scale:
    """The scale from one object pressed twice at the same depth, moved along the gel by a stage in between.

    The shift is the peak of the correlation of the two changes of color, then refined for each channel by
    aligning the images (G. D. Evangelidis and E. Z. Psarakis, IEEE Trans. PAMI 30(10), 2008); the channels' spread
    is its uncertainty, with 0.1 px of the images' similarity.

    Parameters
    ----------
    first, second, background : (H, W, 3), RGB, 0-255, after the view
    distance_mm : motion of the stage
    sigma_mm : standard deviation of the distance, mm

    Raises
    ------
    DataError
        The two images do not show the same object, because nothing aligns.
    """
    bare = PreparedBackground(background, ChangeSettings(blur_px=1.0))  # the blur is against noise
    images = [check_image(image, shape=bare.background.shape[:2]) for image in (first, second)]
    a, b = (bare.change(image, bare.compare(image)[0]) for image in images)  # with the exposure compensated
    start = _coarse_shift(a, b)
    shifts = [_aligned(a[..., c], b[..., c], start) for c in range(3)]
    found = np.array([shift for shift in shifts if shift is not None])
    if not len(found):
        raise DataError(
            "Expected one thing pressed at two places, got two images that no shift aligns. Press the same thing "
            "to the same depth, whole in both images."
        )
    dx, dy = np.median(found, axis=0)
    sigma_px = float(np.hypot(0.1, np.linalg.norm(found.std(axis=0))))
    length = float(np.hypot(dx, dy))
    if length < 10 * sigma_px:
        raise DataError(
            f"Expected a step that is long against its uncertainty, got {length:.2f} +- {sigma_px:.2f} px. "
            "Move the stage further: a third of the image is good."
        )
    source = f"a stage step of {distance_mm:g} mm, ({dx:.2f}, {dy:.2f}) px"
    scale = scale_from_lengths(distance_mm, length, sigma_mm, sigma_px, source)
    return replace(scale, along_x=float((dx / length) ** 2))


def _coarse_shift(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[int, int]:
    """Whole pixels (dx, dy) of the shift of b against a, from the correlation of all channels together."""
    shape = (2 * a.shape[0], 2 * a.shape[1])
    correlation = sum(
        np.fft.irfft2(np.fft.rfft2(b[..., c], shape) * np.conj(np.fft.rfft2(a[..., c], shape)), shape)
        for c in range(3)
    )
    row, column = np.unravel_index(np.argmax(correlation), shape)
    return (
        int(column) - (shape[1] if column >= a.shape[1] else 0),
        int(row) - (shape[0] if row >= a.shape[0] else 0),
    )


def _aligned(
    a: NDArray[np.float32], b: NDArray[np.float32], start: tuple[int, int]
) -> tuple[float, float] | None:
    """Sub-pixel shift (dx, dy) of b against a; None if the alignment does not converge near the start."""
    matrix = np.array([[1, 0, start[0]], [0, 1, start[1]]], dtype=np.float32)
    stop = (cv2.TERM_CRITERIA_EPS, 0, 1e-7)
    try:
        likeness, matrix = cv2.findTransformECC(
            np.ascontiguousarray(a), np.ascontiguousarray(b), matrix, cv2.MOTION_TRANSLATION, stop
        )
    except cv2.error:  # raised by OpenCV if the images have nothing in common
        return None
    if likeness < 0.5 or np.hypot(matrix[0, 2] - start[0], matrix[1, 2] - start[1]) > 3:
        return None
    return float(matrix[0, 2]), float(matrix[1, 2])


MAX_RESIDUAL_PX = 0.5  # px RMS of a grid's points


@dataclass(frozen=True)
class GridView:
    """The view and the scale, estimated from a grid."""

    # from frames to images with square pixels on the gel, one remap; cropped to the part that the camera saw
    view: View
    scale: Scale  # mm per pixel of those images, and its standard deviation
    residual_px: float  # root mean square distance of the grid's points from the model, in the frame
    residual_mm: float  # and on the gel
    points: int  # number of points and of images that were used

    def describe(self) -> str:
        """One line with the figures."""
        return f"{self.points} points of a grid, residual {self.residual_px:.3f} px ({1000 * self.residual_mm:.1f} um)"


def view_from_grid(
    images: Sequence[ArrayLike],
    *,
    pattern: tuple[int, int],
    pitch_mm: float,
    kind: Literal["checkerboard", "dots"] = "checkerboard",
    pitch_sigma_mm: float | None = None,
    background: ArrayLike | None = None,
) -> GridView:
    """Measure the lens and the scale from images of a regular grid, printed or of pins that are pressed into the gel.

    The first image shows the grid on the gel; it gives the plane and the scale. Further images, of the grid at other
    places or tilts, improve only the distortion. Least squares fit a homography for each image together with
    Brown's radial distortion (k1, k2) about one common center. A single plane does not determine the focal length, but
    rectifying it does not need that; it is set to the frame's longer side.

    Parameters
    ----------
    images : (H, W, 3) each, RGB, 0-255: whole camera frames, no view applied
    pattern : (columns, rows) of the inner corners of a checkerboard, or of the dots
    pitch_mm : from corner to corner, or dot to dot; 0.001 to 1000
    kind : "checkerboard" or "dots" (a square grid of dark or bright dots)
    pitch_sigma_mm : standard deviation of the pitch, mm; 0.2 % of it by default
    background : (H, W, 3), the gel at rest: the dots are then the imprints of pins, which change its color

    Raises
    ------
    DataError
        The grid is not found in an image, or its points are over 0.5 px off the model: it is bent, or another pattern.
    """
    columns, rows = (int(number) for number in check_numbers(pattern, "pattern", 2))
    if kind not in ("checkerboard", "dots") or not 3 <= min(columns, rows) <= max(columns, rows) <= 1000:
        raise ValueError(
            f"Expected kind 'checkerboard' or 'dots' and a pattern of 3x3 points or more, got {kind!r}, {pattern}."
        )
    pitch = check_within(pitch_mm, "pitch_mm", 1e-3, 1e3)  # beyond, no homography is found
    frames = [check_image(image, name="grid image") for image in check_list(images, "images")]
    if not frames or any(frame.shape != frames[0].shape for frame in frames):
        raise ValueError("Expected one grid image or more, all of one size.")
    rest = (
        None if background is None else check_image(background, shape=frames[0].shape[:2], name="background")
    )
    if rest is not None and kind != "dots":
        raise ValueError("Expected kind 'dots' with a background: imprints of pins are dots.")
    # An eighth of the dots' mean pitch, if they fill the image, joins the sides of an imprint.
    blur_px = float(np.sqrt(frames[0][..., 0].size / (columns * rows))) / 8
    points = [
        _points_of_grid(_gray(frame, rest, blur_px), (columns, rows), kind, k)
        for k, frame in enumerate(frames)
    ]
    y, x = np.mgrid[:rows, :columns] * pitch
    grid = np.stack([x.ravel() - x.mean(), y.ravel() - y.mean()], axis=1)
    shape = (frames[0].shape[0], frames[0].shape[1])
    bare, homography, residual = _fitted(grid, points, shape)
    if residual > MAX_RESIDUAL_PX:
        raise DataError(
            f"Expected the points of a flat, regular grid, got points {residual:.2f} px off one (limit "
            f"{MAX_RESIDUAL_PX:g}). Is it flat on the gel, and the pattern {columns}x{rows}?"
        )
    lens, mm_per_px = _rectifying(bare, homography, shape)
    spread = float(np.sqrt(np.mean(np.sum((grid / mm_per_px) ** 2, axis=1))))
    fitted = residual / spread / np.sqrt(len(grid))
    known = 0.002 if pitch_sigma_mm is None else pitch_sigma_mm / pitch
    source = f"a {kind} of {columns}x{rows} points, pitch {pitch:g} mm"
    scale = Scale(mm_per_px, float(mm_per_px * np.hypot(fitted, known)), source)
    view = _cropped(View(shape, lens=lens))
    return GridView(view, scale, residual, residual * mm_per_px, len(grid) * len(points))


def _gray(frame: NDArray[Any], rest: NDArray[Any] | None, blur_px: float) -> NDArray[np.uint8]:
    """The gray levels (H, W) of a frame; against the gel at rest, how much its color changed.

    An imprint has a bright and a dark side, and the same change all around its middle.
    """
    if rest is None:
        return np.asarray(cv2.cvtColor(frame.astype(np.uint8), cv2.COLOR_RGB2GRAY))
    change = (frame.astype(np.float32) - rest) / (rest.astype(np.float32) + CHANGE_OFFSET)
    change -= np.median(change, axis=(0, 1))
    size = cv2.GaussianBlur(np.linalg.norm(change, axis=-1), (0, 0), blur_px)
    return np.rint(255 * size / max(float(size.max()), 1e-6)).astype(np.uint8)


def _points_of_grid(
    gray: NDArray[np.uint8], pattern: tuple[int, int], kind: str, number: int
) -> NDArray[np.float64]:
    """(N, 2) points, x and y, row by row of the pattern."""
    seen = "none"
    if kind == "checkerboard":
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        found, points = cv2.findChessboardCornersSB(gray, pattern, flags=flags)
        if found:
            # Corners at the gray levels' gradients, within a quarter of a square, are ten times more exact.
            rows = np.asarray(points, dtype=np.float32).reshape(pattern[1], pattern[0], 2)
            square = min(float(np.linalg.norm(np.diff(rows, axis=axis), axis=-1).min()) for axis in (0, 1))
            half = max(2, int(square / 4))
            stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
            points = cv2.cornerSubPix(gray, rows.reshape(-1, 1, 2), (half, half), (-1, -1), stop)
    else:
        blobs: Any = cv2  # OpenCV's stubs lack its blob detector
        settings = blobs.SimpleBlobDetector_Params()
        settings.minArea = 8.0
        settings.maxArea = max(gray.size / (pattern[0] * pattern[1]), settings.minArea)
        settings.minDistBetweenBlobs = 3.0
        detector, counts = blobs.SimpleBlobDetector_create(settings), []
        for side in (gray, 255 - gray):  # dark dots, or bright ones
            found, points = cv2.findCirclesGrid(
                side, pattern, flags=cv2.CALIB_CB_SYMMETRIC_GRID, blobDetector=detector
            )
            if found:
                break
            counts.append(len(detector.detect(side)))
        seen = f"{max(counts, default=0)} of {pattern[0] * pattern[1]} dots"
    if not found:
        noun, count = ("dots", "of dots") if kind == "dots" else ("a checkerboard", "that of inner corners")
        pins = " Imprints of pins need the background, the gel at rest." if kind == "dots" else ""
        raise DataError(
            f"Expected {noun} of {pattern[0]}x{pattern[1]} points in grid image {number + 1}, found {seen}. Is the "
            f"whole grid in the image, evenly lit, and the count {count}?{pins}"
        )
    return np.asarray(points, dtype=np.float64).reshape(-1, 2)


def _projected(homography: NDArray[Any], points: NDArray[np.float64]) -> NDArray[np.float64]:
    moved = np.column_stack([points, np.ones(len(points))]) @ homography.T
    return np.asarray(moved[:, :2] / moved[:, 2:])


def _fitted(
    grid: NDArray[np.float64], points: Sequence[NDArray[np.float64]], shape: tuple[int, int]
) -> tuple[Lens, NDArray[np.float64], float]:
    """The lens of all images, the homography (3, 3) of the first, and the root mean square residual, px.

    The grid (mm) maps to undistorted px by a homography for each image, and then by radial distortion about the center.
    """
    focal, middle = float(max(shape)), ((shape[1] - 1) / 2, (shape[0] - 1) / 2)
    starts = [cv2.findHomography(grid, of_image)[0] for of_image in points]
    start = np.concatenate([[0.0, 0.0, *middle], *[(h / h[2, 2]).ravel()[:8] for h in starts]])

    def homography(numbers: NDArray[np.float64], k: int) -> NDArray[np.float64]:
        return np.append(numbers[4 + 8 * k : 12 + 8 * k], 1.0).reshape(3, 3)

    def off(numbers: NDArray[np.float64]) -> NDArray[np.float64]:
        (k1, k2), center = numbers[:2], numbers[2:4]
        residuals = []
        for k, of_image in enumerate(points):
            unit = (_projected(homography(numbers, k), grid) - center) / focal
            square = np.sum(unit**2, axis=1, keepdims=True)
            frame_px = unit * (1 + k1 * square + k2 * square**2) * focal + center
            residuals.append((frame_px - of_image).ravel())
        # without distortion its center is anywhere, and so is k2 over a small grid: weak priors of 0.1 px noise, with
        # standard deviations of 1 for k1 and k2, and of 5 % of the longer side for the center
        prior = 0.1 * (numbers[:4] - start[:4]) / [1, 1, *[0.05 * focal] * 2]
        return np.concatenate([*residuals, prior])

    fitted = least_squares(off, start, x_scale="jac", method="lm")
    residual = np.sqrt(np.mean(fitted.fun[:-4] ** 2) * 2)
    k1, k2, x, y = (float(value) for value in fitted.x[:4])
    return Lens((focal, focal, x, y), (k1, k2)), homography(fitted.x, 0), float(residual)


def _rectifying(bare: Lens, homography: NDArray[np.float64], shape: tuple[int, int]) -> tuple[Lens, float]:
    """The lens whose rectified frame keeps size and direction in the middle of the frame, and its mm per px."""
    middle = np.array([(shape[1] - 1) / 2, (shape[0] - 1) / 2])
    to_grid = np.linalg.inv(homography)  # of a whole grid of points, so never singular
    steps = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1.0]])
    at = _projected(to_grid, bare.rectified_px_from_frame_px(middle + steps))  # mm of the grid
    jacobian = np.column_stack([(at[1] - at[2]) / 2, (at[3] - at[4]) / 2])  # mm per px of the frame
    mm_per_px = float(np.sqrt(abs(np.linalg.det(jacobian))))
    u, _, v = np.linalg.svd(jacobian)
    turn = mm_per_px * (u @ v)  # the nearest turn, or mirror image, because the first corner is arbitrary
    placed = np.eye(3)
    placed[:2, :2], placed[:2, 2] = turn, at[0] - turn @ middle
    perspective = homography @ placed
    perspective /= perspective[2, 2]
    return Lens(bare.camera, bare.distortion, tuple(perspective.ravel())), mm_per_px


def _cropped(view: View) -> View:
    """The largest middle part of the rectified frame, in whole pixels, that the camera saw completely."""
    assert view.frame_shape is not None
    assert view.lens is not None
    height, width = view.frame_shape
    for fraction in np.arange(1.0, 0.5, -2 / max(height, width)):
        left, top = int(np.ceil(width * (1 - fraction) / 2)), int(np.ceil(height * (1 - fraction) / 2))
        x, y = np.arange(left, width - left, dtype=float), np.arange(top, height - top, dtype=float)
        rim = np.concatenate(
            [np.column_stack([x, np.full_like(x, row)]) for row in (y[0], y[-1])]
            + [np.column_stack([np.full_like(y, column), y]) for column in (x[0], x[-1])]
        )
        there = view.lens.frame_px_from_rectified_px(rim)
        if (there >= -0.5).all() and (there <= [width - 0.5, height - 0.5]).all():
            crop = (float(left), float(top), float(len(x)), float(len(y)))
            return View(view.frame_shape, None if fraction == 1 else crop, lens=view.lens)
    raise DataError(
        "Expected a grid seen from above, got one so slanted that less than half of the rectified frame is in the image. "
        "Lay the grid on the gel and take it with the camera that takes the presses."
    )
