"""The view that removes distortion and perspective, and the scale, from images of a grid that lies on the gel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import least_squares

from gelform.calibration.geometry.scale import Scale
from gelform.errors import DataError
from gelform.foundations.checks import check_image, check_list, check_numbers, check_within
from gelform.image.view import Lens, View

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
) -> GridView:
    """Measure the lens and the scale from images of a regular grid.

    The first image shows the grid on the gel; it gives the plane and the scale. Further images, of the grid at other
    places or tilts, improve only the distortion. Least squares fit a homography for each image together with
    Brown's radial distortion (k1, k2) about one common center. A single plane does not determine the focal length, but
    rectifying it does not need that; it is set to the frame's longer side.

    Parameters
    ----------
    images : (H, W, 3) each, RGB, 0-255: whole camera frames, no view applied
    pattern : (columns, rows) of the inner corners of a checkerboard, or of the dots
    pitch_mm : from corner to corner, or dot to dot; 0.001 to 1000
    kind : "checkerboard" or "dots" (a square grid of dark dots)
    pitch_sigma_mm : standard deviation of the pitch, mm; 0.2 % of it by default

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
    points = [_points_of_grid(frame, (columns, rows), kind, k) for k, frame in enumerate(frames)]
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


def _points_of_grid(
    frame: NDArray[Any], pattern: tuple[int, int], kind: str, number: int
) -> NDArray[np.float64]:
    """(N, 2) points, x and y, row by row of the pattern."""
    gray = cv2.cvtColor(frame.astype(np.uint8), cv2.COLOR_RGB2GRAY)
    if kind == "checkerboard":
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        found, points = cv2.findChessboardCornersSB(gray, pattern, flags=flags)
        if found:
            points = _refined_corners(gray, np.asarray(points, dtype=np.float32).reshape(-1, 1, 2), pattern)
    else:
        blobs: Any = cv2  # OpenCV's stubs lack its blob detector
        settings = blobs.SimpleBlobDetector_Params()
        settings.minArea, settings.maxArea = 8.0, max(gray.size / 40, 9.0)
        settings.minDistBetweenBlobs = 3.0
        settings.thresholdStep = 5.0
        detector = blobs.SimpleBlobDetector_create(settings)
        found, points = cv2.findCirclesGrid(
            gray, pattern, flags=cv2.CALIB_CB_SYMMETRIC_GRID, blobDetector=detector
        )
    if not found:
        raise DataError(
            f"Expected a {kind} of {pattern[0]}x{pattern[1]} points in grid image {number + 1}, found none. Is the "
            "whole grid in the image, evenly lit, and the count that of inner corners (one less than squares)?"
        )
    return np.asarray(points, dtype=np.float64).reshape(-1, 2)


def _refined_corners(
    gray: NDArray[Any], points: NDArray[np.float32], pattern: tuple[int, int]
) -> NDArray[np.float32]:
    """Corners at the gray levels' gradients, within a quarter of a square: ten times more exact than the found ones."""
    rows = points.reshape(pattern[1], pattern[0], 2)
    square = min(float(np.linalg.norm(np.diff(rows, axis=axis), axis=-1).min()) for axis in (0, 1))
    half = max(2, int(square / 4))
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-4)
    refined: NDArray[np.float32] = cv2.cornerSubPix(gray, points, (half, half), (-1, -1), stop)
    return refined


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

    fitted = least_squares(off, start, x_scale="jac", method="lm", max_nfev=4000)
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
    for fraction in np.arange(1.0, 0.5, -0.005):
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
