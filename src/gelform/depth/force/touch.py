"""Touch: the few numbers of a result from which a force is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.foundations.checks import check_mm_per_px, check_values
from gelform.image.markers import MarkerFlow

BORDER_FRACTION = 1 / 30  # of the image's height: the width of the band along its border, 8 px of 240


class Pressed(Protocol):
    """The parts of a `Reconstruction` that a touch needs."""

    @property
    def depth(self) -> NDArray[np.float32]: ...
    @property
    def contact(self) -> NDArray[np.bool_]: ...
    @property
    def confidence(self) -> NDArray[np.float32]: ...
    @property
    def mm_per_px(self) -> float | tuple[float, float] | None: ...
    @property
    def markers(self) -> MarkerFlow | None: ...
    @property
    def outside_change(self) -> float | None: ...
    @property
    def calibration_digest(self) -> str: ...


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
    volume_mm3 : volume of the depth in the contact; 0 without a contact, None without a scale
    confidence : mean in the contact
    outside_change : median color change outside the contact, over its mean inside; None without a contact
    border_share : the part of the volume that lies in the band along the border
    dots : their motion; None if the gel has none, or fewer than half are seen
    rest_mm : (N, 2), positions of all dots at rest; None without dots
    calibration_digest : of the calibration behind the result
    """

    volume_mm3: float | None = None
    confidence: float = 0.0
    outside_change: float | None = None
    border_share: float = 0.0
    dots: DotMotion | None = None
    rest_mm: NDArray[np.float64] | None = None
    calibration_digest: str = ""


def touch_from_result(result: Pressed) -> Touch:
    """The touch of a result, which is a `Reconstruction`."""
    contact, pitch = result.contact, result.mm_per_px
    motion, rest = _dots_of(result)
    known = {"dots": motion, "rest_mm": rest, "calibration_digest": result.calibration_digest}
    if pitch is None or not contact.any():
        return Touch(volume_mm3=None if pitch is None else 0.0, **known)  # type: ignore[arg-type]
    band = max(1, round(BORDER_FRACTION * len(contact)))
    inside = slice(band, -band), slice(band, -band)
    whole, inner = _sum(result.depth, contact), _sum(result.depth[inside], contact[inside])
    return Touch(
        volume_mm3=whole * float(np.prod(check_mm_per_px(pitch))),
        confidence=_sum(result.confidence, contact) / int(np.count_nonzero(contact)),
        outside_change=result.outside_change,
        border_share=min(max(1 - inner / whole, 0.0), 1.0) if whole > 0 else 0.0,
        **known,  # type: ignore[arg-type]
    )


def _sum(values: NDArray[np.float32], where: NDArray[np.bool_]) -> float:
    """The sum of a map (H, W) in a mask; three times faster than numpy's `sum(where=)`."""
    return float(np.vdot(values, where))


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
    shapes = [one.shape for one in (rest, moved)]
    if any(len(shape) != 2 or shape[1] not in (2, 3) for shape in shapes) or shapes[0][0] != shapes[1][0]:
        raise ValueError(f"Expected rest_mm and displacement_mm of shape (N, 2) or (N, 3), got {shapes}.")
    motion = motion_of_dots(rest, moved)
    if motion is None:
        raise ValueError("Expected three dots or more that are not in a line.")
    return Touch(dots=motion, rest_mm=rest[:, :2])


def motion_of_dots(rest: NDArray[np.float64], moved: NDArray[np.float64]) -> DotMotion | None:
    """The motion of dots (N, 2 or 3) from rest (N, 2 or more), mm; None for fewer than three, or a line."""
    if len(rest) < 3:
        return None
    places = np.column_stack([rest[:, :2] - rest[:, :2].mean(axis=0), np.ones(len(rest))])
    along, _, rank, _ = np.linalg.lstsq(places, moved, rcond=None)
    if rank < 3:
        return None
    tilt = along[:2, 2] if moved.shape[1] == 3 else np.zeros(2)
    turn = (along[0, 1] - along[1, 0]) / 2
    return DotMotion(*map(float, (*moved[:, :2].mean(axis=0), turn, *tilt)))


def same_dots(rest_mm: NDArray[np.float64], known_mm: NDArray[np.float64], tolerance: float) -> bool:
    """Whether dots (N, 2) stand where known ones (M, 2) do: half of them within a part of the known spacing."""
    if len(rest_mm) == len(known_mm):
        apart = np.linalg.norm(rest_mm - known_mm, axis=1)
    else:
        apart = _nearest(rest_mm, known_mm)
    return bool(np.median(apart) <= tolerance * spacing_mm(known_mm)) and _alike(len(rest_mm), len(known_mm))


def spacing_mm(dots: NDArray[np.float64]) -> float:
    """The median distance of dots (N, 2) to their nearest neighbors."""
    return float(np.median(_nearest(dots, dots, itself=True)))


def _alike(count: int, known: int) -> bool:
    return 2 * min(count, known) > max(count, known)


def _nearest(
    dots: NDArray[np.float64], others: NDArray[np.float64], *, itself: bool = False
) -> NDArray[np.float64]:
    apart = np.linalg.norm(dots[:, None] - others[None], axis=2)
    if itself:
        np.fill_diagonal(apart, np.inf)
    return np.asarray(apart.min(axis=1))


def _dots_of(result: Pressed) -> tuple[DotMotion | None, NDArray[np.float64] | None]:
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
    return motion_of_dots(rest[flow.seen], moved[flow.seen]), rest


def as_touches(presses: Sequence[Touch | Pressed]) -> list[Touch]:
    """Touches as they are, and results as touches."""
    return [one if isinstance(one, Touch) else touch_from_result(one) for one in presses]
