"""mm per pixel from a pressed object of known size: a flat punch or a thread."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.optimize import least_squares, minimize
from scipy.special import erfc, erfcx

from gelform.background.change import ChangeSettings, PreparedBackground
from gelform.calibration.geometry.scale import Scale, scale_from_lengths
from gelform.errors import DataError
from gelform.foundations.checks import check_image, check_positive

RAYS = 360  # from the punch's middle
SECTORS = 24  # sectors of its outline, each fitted by itself
RAY_STEP_PX = 0.2  # along a ray
EDGE_BLUR_PX = 1.0  # px, blur of the change of color against noise
EDGE_SIGMA_PX = 0.3  # px, uncertainty of the edge from the shape of the flank
MIN_CONTRAST = 0.03  # smallest change of color by a press
MAX_RESIDUAL = 0.04  # of the punch's radius
MIN_PERIODS = 4.0  # of a thread in the image
MAX_FREQUENCY = 0.25  # cycles per px: crests 4 px apart
MIN_ELONGATION = 1.5  # smallest length over width of an object with an axis
MAX_LEAN_RAD = np.deg2rad(15)
MIN_PROMINENCE = 4.0  # of the wave over the spectrum's median
FUNDAMENTAL = 0.35  # of the peak; a wave below it of at least this strength is its fundamental
THREAD_SIGMA = 0.003  # relative uncertainty from the shape of the crests
STEP_SIGMA_PX = 0.1  # px, uncertainty of the shift from the similarity of the images
MIN_LIKENESS = 0.5  # correlation, 0-1


def scale_from_punch(
    image: NDArray[Any], background: NDArray[Any], diameter_mm: float, *, sigma_mm: float = 0.01
) -> Scale:
    """The scale from the outline of a flat, round punch with a sharp edge.

    Inside the edge the gel lies flat, so its color is that of rest. Outside, it slopes most steeply next to the edge, and
    less further out. That profile is a step and an exponential fall after a blur (an exponentially modified Gaussian).
    It is fitted to the change of color in each of 24 sectors; its step is the edge.

    Parameters
    ----------
    image, background : (H, W, 3), RGB, 0-255, after the view
    diameter_mm : of the punch's face
    sigma_mm : standard deviation of the diameter, mm

    Raises
    ------
    DataError
        No ring of changed color, or one that is no circle; the message has the figure.
    """
    size = np.linalg.norm(change_of(image, background, EDGE_BLUR_PX), axis=-1)
    if np.quantile(size, 0.995) < MIN_CONTRAST:
        raise DataError(
            f"Expected the press of a flat punch, got an image whose color hardly changes "
            f"({np.quantile(size, 0.995):.3f}, expected {MIN_CONTRAST:g} or more). Press it in firmly."
        )
    x, y, rough, residual, count = _circle_through(_edges(size, _middle(size)))
    if residual > MAX_RESIDUAL * rough or count < RAYS / 3:
        raise DataError(
            f"Expected the round outline of a flat punch, got one that is {residual:.1f} px off a circle of radius "
            f"{rough:.1f} px on {count} of {RAYS} rays. Press it in flat and alone."
        )
    radii = _radii_of_flank(size, (x, y), rough)
    radius = float(np.median(radii))
    scatter = 1.4826 * float(np.median(np.abs(radii - radius))) / np.sqrt(len(radii))
    source = f"a punch of {diameter_mm:g} mm, {2 * radius:.2f} px at ({x:.1f}, {y:.1f})"
    sigma_px = 2 * float(np.hypot(scatter, EDGE_SIGMA_PX))
    return scale_from_lengths(diameter_mm, 2 * radius, sigma_mm, sigma_px, source)


def scale_from_thread(
    image: NDArray[Any], background: NDArray[Any], pitch_mm: float, *, sigma_mm: float = 0.002
) -> Scale:
    """The scale from the pitch of a screw thread (or of a ruled bar) that lies in the gel.

    The strongest wave in the change of color is found in its spectrum and refined to a fraction of a bin. Only
    its part along the screw counts: the crests lean by the helix, which brings them 0.1-0.8 % closer.

    Parameters
    ----------
    image, background : (H, W, 3), RGB, 0-255, after the view
    pitch_mm : from crest to crest along the screw's axis
    sigma_mm : standard deviation of the pitch, mm

    Raises
    ------
    DataError
        No wave of four periods or more stands out.
    """
    frequency, sigma = _frequency(change_of(image, background, 0.0))
    period = 1 / frequency
    source = f"a thread of pitch {pitch_mm:g} mm, {period:.3f} px"
    sigma_px = period * float(np.hypot(sigma, THREAD_SIGMA))
    return scale_from_lengths(check_positive(pitch_mm, "pitch_mm"), period, sigma_mm, sigma_px, source)


def change_of(image: NDArray[Any], background: NDArray[Any], blur_px: float) -> NDArray[np.float32]:
    """Change of color (H, W, 3), with the exposure compensated."""
    bare = PreparedBackground(background, ChangeSettings(blur_px=blur_px))
    checked = check_image(image, shape=bare.background.shape[:2])
    return bare.change(checked, bare.compare(checked)[0])


def _middle(size: NDArray[np.float32]) -> tuple[float, float]:
    """Middle of the clearly changed pixels."""
    rows, columns = np.nonzero(size > 0.5 * np.quantile(size, 0.995))
    return float((columns.min() + columns.max()) / 2), float((rows.min() + rows.max()) / 2)


def _edges(size: NDArray[np.float32], middle: tuple[float, float]) -> NDArray[np.float64]:
    """(N, 2) points x, y where the change first reaches half its peak, one on each ray that stays inside."""
    height, width = size.shape
    clear = 0.5 * float(np.quantile(size, 0.995))
    points = []
    for angle in np.arange(RAYS) * 2 * np.pi / RAYS:
        direction = np.array([np.cos(angle), np.sin(angle)])
        ends = [
            (limit - 1 - m if d > 0 else m) / abs(d)
            for limit, m, d in zip((width, height), middle, direction)
            if d
        ]
        r = np.arange(0, min(ends), RAY_STEP_PX)
        if len(r) < 20:
            continue
        profile = map_coordinates(
            size, [middle[1] + r * direction[1], middle[0] + r * direction[0]], order=1, mode="nearest"
        )
        peak = int(np.argmax(profile))
        if profile[peak] < clear or peak in (0, len(r) - 1):
            continue
        floor = float(np.median(profile[: max(2, peak // 2)]))
        below = np.nonzero(profile[:peak] < (floor + profile[peak]) / 2)[0]
        if len(below):
            points.append(np.array(middle) + r[below[-1]] * direction)
    return np.array(points).reshape(-1, 2)


def _circle_through(points: NDArray[np.float64]) -> tuple[float, float, float, float, int]:
    """x, y, radius of the robustly fitted circle, its residual (robust standard deviation), number of points near it."""
    if len(points) < 8:
        return 0.0, 0.0, 1.0, np.inf, len(points)
    design = np.column_stack([2 * points, np.ones(len(points))])
    x, y, c = np.linalg.lstsq(design, np.sum(points**2, axis=1), rcond=None)[0]
    start = (x, y, np.sqrt(max(c + x * x + y * y, 1.0)))

    def distance(circle: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.hypot(points[:, 0] - circle[0], points[:, 1] - circle[1]) - circle[2])

    fitted = least_squares(distance, start, loss="soft_l1", f_scale=0.5).x
    off = np.abs(distance(fitted))
    residual = 1.4826 * float(np.median(off))
    near = int(np.count_nonzero(off < 4 * residual + 0.5))
    return float(fitted[0]), float(fitted[1]), float(fitted[2]), residual, near


def _radii_of_flank(
    size: NDArray[np.float32], center: tuple[float, float], rough: float
) -> NDArray[np.float64]:
    """Radius of the edge, px, in each sector whose profile fits the flank's model."""
    r = np.arange(0.6 * rough, 1.5 * rough, 0.5)
    angles = (
        (np.arange(SECTORS)[:, None] + np.arange(RAYS // SECTORS) / (RAYS // SECTORS)) * 2 * np.pi / SECTORS
    )
    radii = [
        radius
        for sector in angles
        if (radius := _radius_in_sector(size, center, rough, r, sector)) is not None
    ]
    if len(radii) < SECTORS // 3:
        raise DataError(
            f"Expected the outline of a punch within the image, got {len(radii)} of {SECTORS} sectors with room "
            "around the edge. Press it nearer to the middle."
        )
    return np.array(radii)


def _radius_in_sector(
    size: NDArray[np.float32],
    center: tuple[float, float],
    rough: float,
    r: NDArray[np.float64],
    angles: NDArray[np.float64],
) -> float | None:
    """Radius of the flank's step in one sector; None if it is not in the image with room around it."""
    x, y = center[0] + r[:, None] * np.cos(angles), center[1] + r[:, None] * np.sin(angles)
    inside = ((x >= 0) & (x <= size.shape[1] - 1) & (y >= 0) & (y <= size.shape[0] - 1)).all(axis=1)
    if np.count_nonzero(inside) < 20 or r[inside][-1] < 1.2 * rough:
        return None
    at, profile = r[inside], map_coordinates(size, [y, x], order=1, mode="nearest").mean(axis=1)[inside]
    start = (rough + 1, 0.15 * rough, 1.5, float(profile.max()), float(profile[:5].mean()))
    low, high = (0.7 * rough, 1.0, 0.3, 0.0, 0.0), (1.4 * rough, 10 * rough, 8.0, np.inf, np.inf)

    def off(guess: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(_flank(at, *(float(value) for value in guess)) - profile)

    fitted = least_squares(off, start, bounds=(low, high), x_scale=(1, 3, 1, 0.1, 0.1))
    return float(fitted.x[0])


def _flank(
    r: NDArray[np.float64], edge: float, fall: float, blur: float, height: float, floor: float
) -> NDArray[np.float64]:
    """A step at `edge` that falls off as exp(-(r - edge)/fall), after a Gaussian blur, over a floor."""
    t = (r - edge) / blur
    # erfcx keeps exp() erfc() from overflowing far from the flank
    arg = (blur / fall - t) / np.sqrt(2)
    tail = np.where(arg > 0, np.exp(-(t**2) / 2) * erfcx(np.maximum(arg, 0)), 0.0)
    near = np.exp(np.minimum(blur**2 / (2 * fall**2) - (r - edge) / fall, 50)) * erfc(np.minimum(arg, 0))
    return floor + height / 2 * np.where(arg > 0, tail, near)


def _axis_of(change: NDArray[np.float32]) -> NDArray[np.float64] | None:
    """Unit vector (x, y) along the long side of the changed region; None if it is as long as wide."""
    weight = np.sum(change.astype(np.float64) ** 2, axis=-1)
    weight[weight < 0.05 * weight.max()] = 0
    y, x = np.mgrid[: weight.shape[0], : weight.shape[1]]
    total = weight.sum()
    dx, dy = x - (weight * x).sum() / total, y - (weight * y).sum() / total
    xx, xy, yy = (float((weight * one).sum() / total) for one in (dx * dx, dx * dy, dy * dy))
    spread, axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]))
    return np.asarray(axes[:, 1]) if spread[1] > MIN_ELONGATION**2 * spread[0] else None


def _frequency(change: NDArray[np.float32]) -> tuple[float, float]:
    """Cycles per pixel of the strongest wave, and its relative standard deviation from halves of the image."""
    axis = _axis_of(change)
    start = _strongest(change, axis)
    whole = _refined(change, start)
    along = whole / np.hypot(*whole) if axis is None else axis * np.sign(axis @ whole)
    split = 0 if abs(whole[1]) > abs(whole[0]) else 1
    halves = [float(_refined(part, whole) @ along) for part in np.array_split(change, 2, axis=split)]
    length = float(whole @ along)
    if not np.all(np.abs(np.array(halves) / length - 1) < 0.1):
        raise DataError(
            f"Expected a thread that lies across the image, got a wave of {1 / length:.2f} px that its halves give as "
            f"{1 / halves[0]:.2f} and {1 / halves[1]:.2f} px. Press the thread in along its whole length."
        )
    return length, float(np.std(halves) / np.sqrt(2) / length)


def _strongest(change: NDArray[np.float32], axis: NDArray[np.float64] | None) -> NDArray[np.float64]:
    """(fx, fy) of the spectrum's peak, in cycles per pixel, along a long object; not a harmonic."""
    height, width = change.shape[:2]
    size = 2 * max(height, width)
    window = np.outer(np.hanning(height), np.hanning(width))[..., None]
    spectrum = np.sqrt(
        np.sum(np.abs(np.fft.fft2(change * window, s=(size, size), axes=(0, 1))) ** 2, axis=-1)
    )
    fy, fx = np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None, :]
    frequency = np.hypot(fx, fy)
    spectrum *= frequency  # flattens the spectrum of the object's outline, which falls off as 1/f
    meant = (frequency > MIN_PERIODS / max(height, width)) & (frequency < MAX_FREQUENCY) & (fx >= 0)
    if axis is not None:
        meant &= np.abs(fx * axis[0] + fy * axis[1]) > np.cos(MAX_LEAN_RAD) * frequency
    spectrum[~meant] = 0
    peak = np.unravel_index(np.argmax(spectrum), spectrum.shape)
    best = np.array([fx[0, peak[1]], fy[peak[0], 0]])
    if not spectrum[peak] > MIN_PROMINENCE * np.median(spectrum[meant & (frequency < 2 * np.hypot(*best))]):
        raise DataError(
            "Expected a thread, got an image in which no wave stands out. Lay the screw flat and press firmly, with "
            f"{MIN_PERIODS:g} crests or more in the image."
        )
    for part in (3, 2):  # a sharp crest has strong harmonics, so the fundamental may be below
        row, column = (round(f / part * size) for f in best[::-1])
        around = spectrum.take(range(row - 2, row + 3), 0, mode="wrap").take(
            range(column - 2, column + 3), 1, mode="wrap"
        )
        if around.max() > FUNDAMENTAL * spectrum[peak]:
            return best / part
    return best


def _refined(change: NDArray[np.float32], start: NDArray[np.float64]) -> NDArray[np.float64]:
    """(fx, fy) at which the windowed transform of all channels is largest, near the start."""
    height, width = change.shape[:2]
    windowed = change * np.outer(np.hanning(height), np.hanning(width))[..., None]
    y, x = np.arange(height), np.arange(width)
    scale = np.array([1 / width, 1 / height])

    def negative(step: NDArray[np.float64]) -> float:
        fx, fy = start + step * scale
        down = np.tensordot(np.exp(-2j * np.pi * fy * y), windowed, axes=(0, 0))
        return -float(np.linalg.norm(np.exp(-2j * np.pi * fx * x) @ down))

    found = minimize(negative, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6})
    return np.asarray(start + found.x * scale)


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
    is its uncertainty.

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
    a, b = (change_of(image, background, 1.0) for image in (first, second))
    shifts = [_aligned(a[..., c], b[..., c], _coarse_shift(a, b)) for c in range(3)]
    found = np.array([shift for shift in shifts if shift is not None])
    if not len(found):
        raise DataError(
            "Expected one thing pressed at two places, got two images that no shift aligns. Press the same thing "
            "to the same depth, whole in both images."
        )
    dx, dy = np.median(found, axis=0)
    sigma_px = float(np.hypot(STEP_SIGMA_PX, np.linalg.norm(found.std(axis=0))))
    length = float(np.hypot(dx, dy))
    if length < 10 * sigma_px:
        raise DataError(
            f"Expected a step that is long against its uncertainty, got {length:.2f} +- {sigma_px:.2f} px. "
            "Move the stage further: a third of the image is good."
        )
    source = f"a stage step of {distance_mm:g} mm, ({dx:.2f}, {dy:.2f}) px"
    return scale_from_lengths(distance_mm, length, sigma_mm, sigma_px, source)


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
    stop = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 200, 1e-7)
    try:
        likeness, matrix = cv2.findTransformECC(
            np.ascontiguousarray(a), np.ascontiguousarray(b), matrix, cv2.MOTION_TRANSLATION, stop, None, 5
        )
    except cv2.error:  # raised by OpenCV if the images have nothing in common
        return None
    if likeness < MIN_LIKENESS or np.hypot(matrix[0, 2] - start[0], matrix[1, 2] - start[1]) > 3:
        return None
    return float(matrix[0, 2]), float(matrix[1, 2])
