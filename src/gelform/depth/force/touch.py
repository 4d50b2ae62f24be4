"""Touch: the few numbers of a result from which a force is read."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_mm_per_px, check_values

IN_LINE = 1e-6  # width over length; dots within it lie in a line, however their places were rounded
BORDER_FRACTION = 1 / 30  # of the image's height: the width of the band along its border, 8 px of 240
HELD = 0.9  # of the largest volume of a contact; with less, its force falls


class DotMotion(NamedTuple):
    """The motion of all dots together: mean displacement, mm, turn about the view, rad, and tilt, mm/mm."""

    x_mm: float
    y_mm: float
    turn_rad: float
    tilt_x: float
    tilt_y: float


@dataclass(frozen=True, eq=False)
class Touch:
    """The numbers of one result from which a force is read.

    Attributes
    ----------
    volume_mm3 : volume of the depth in the contact; 0 without a contact; None without a scale, or from a zero that was set
    confidence : mean in the contact
    outside_change : median color change outside the contact, over its mean inside; None without a contact
    border_share : the part of the volume that lies in the band along the border
    dots : their motion; None if the gel has none, or fewer than half are seen
    rest_mm : (N, 2), positions of all dots at rest; None without dots
    calibration_digest : of the calibration behind the result
    volume_sigma_mm3 : standard deviation of the volume
    falling : whether the contact had more volume before, as `touches_in_order` tells; a lone result does not
    """

    volume_mm3: float | None = None
    confidence: float = 0.0
    outside_change: float | None = None
    border_share: float = 0.0
    dots: DotMotion | None = None
    rest_mm: NDArray[np.float64] | None = None
    calibration_digest: str = ""
    volume_sigma_mm3: float = 0.0
    falling: bool = False


def touch_from_result(result: Any) -> Touch:
    """The touch of a result, which is a `Reconstruction`; TypeError: it is none."""
    if not all(hasattr(result, name) for name in ("contact", "mm_per_px", "zero", "confidence", "depth")):
        raise TypeError(f"Expected a Reconstruction, got {type(result).__name__}.")
    contact, pitch = result.contact, result.mm_per_px
    motion, rest = _dots_of(result)
    known: dict[str, Any] = {"dots": motion, "rest_mm": rest, "calibration_digest": result.calibration_digest}
    if pitch is None or result.zero == "set":
        return Touch(**known)
    if not contact.any():
        return Touch(volume_mm3=0.0, **known)
    x, y, width, height = cv2.boundingRect(contact.view(np.uint8))
    box = slice(y, y + height), slice(x, x + width)
    touched, pressed = contact[box], result.depth[box] * contact[box]
    band, (rows, columns) = max(1, round(BORDER_FRACTION * len(contact))), contact.shape
    inside = pressed[
        max(band - y, 0) : max(rows - band - y, 0), max(band - x, 0) : max(columns - band - x, 0)
    ]
    # Neighbors err alike, so the volume is as uncertain as the depth.
    deviation = result.depth_sigma_mm
    sigma = 0.0 if deviation is None else float(deviation[box][touched].sum(dtype=np.float64))
    area = float(np.prod(check_mm_per_px(pitch)))
    whole, inner = float(pressed.sum(dtype=np.float64)), float(inside.sum(dtype=np.float64))
    return Touch(
        volume_mm3=whole * area,
        volume_sigma_mm3=sigma * area,
        confidence=float(result.confidence[box][touched].mean()),
        outside_change=result.outside_change,
        border_share=min(max(1 - inner / whole, 0.0), 1.0) if whole > 0 else 0.0,
        **known,
    )


def touches_in_order(results: Iterable[Any]) -> Iterator[Touch]:
    """The touches of results, or of touches, in the order of their frames: they know whether the force falls.

    A gel that is released keeps its force longer than its contact, so a volume says less about a falling force.
    """
    largest = 0.0
    for one in results:
        touch = one if isinstance(one, Touch) else touch_from_result(one)
        volume = touch.volume_mm3 or 0.0
        largest = max(largest, volume) if volume > 0 else 0.0
        yield replace(touch, falling=volume < HELD * largest)


def touch_from_dots(rest_mm: ArrayLike, displacement_mm: ArrayLike) -> Touch:
    """The touch that dots alone show.

    Parameters
    ----------
    rest_mm : (N, 2) or (N, 3), positions of the dots at rest
    displacement_mm : (N, 3), x, y, and z toward the camera; or (N, 2), which shows no tilt

    Raises
    ------
    ValueError, TypeError
        Wrong shapes, NaN, or fewer than three dots, or all in a line.
    """
    rest = np.asarray(check_values(rest_mm, "rest_mm", (), np.float64))
    moved = np.asarray(check_values(displacement_mm, "displacement_mm", (), np.float64))
    if rest.shape[-1:] not in ((2,), (3,)) or moved.shape not in ((len(rest), 2), (len(rest), 3)):
        raise ValueError(f"Expected dots of shape (N, 2) or (N, 3), got {rest.shape} and {moved.shape}.")
    if (motion := _motion(rest, moved)) is None:
        raise ValueError("Expected three dots or more that are not in a line.")
    return Touch(dots=motion, rest_mm=rest[:, :2])


def _motion(rest: NDArray[np.float64], moved: NDArray[np.float64]) -> DotMotion | None:
    """The motion of dots (N, 2 or 3) from rest (N, 2 or more), mm; None for fewer than three, or a line."""
    if len(rest) < 3:
        return None
    places = np.column_stack([rest[:, :2] - rest[:, :2].mean(axis=0), np.ones(len(rest))])
    along, _, rank, _ = np.linalg.lstsq(places, moved, rcond=IN_LINE)
    if rank < 3:
        return None
    tilt = along[:2, 2] if moved.shape[1] == 3 else np.zeros(2)
    return DotMotion(*map(float, (*along[2, :2], (along[0, 1] - along[1, 0]) / 2, *tilt)))


def _dots_of(result: Any) -> tuple[DotMotion | None, NDArray[np.float64] | None]:
    """Motion and rest of a result's dots; the depth at a dot is its displacement toward the camera."""
    flow, scale = result.markers, result.mm_per_px
    if flow is None or scale is None:
        return None, None
    pitch = np.array(check_mm_per_px(scale))
    rest = flow.rest_px * pitch
    if 2 * np.count_nonzero(flow.seen) < len(flow):
        return None, rest
    height, width = result.depth.shape
    x, y = np.clip(np.rint(flow.now_px).astype(int), 0, (width - 1, height - 1)).T
    moved = np.column_stack([flow.displacement_px * pitch, result.depth[y, x]])
    return _motion(rest[flow.seen], moved[flow.seen]), rest
