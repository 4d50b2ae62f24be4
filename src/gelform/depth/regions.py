"""The regions of a contact mask: the measures of each, and the color change around them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform._native import Kernel
from gelform.arrays import Map, Mask, Numbers
from gelform.foundations.checks import as_array, check_map, check_mm_per_px
from gelform.foundations.findings import Finding
from gelform.image.agreement import TOUCHED_SHARE
from gelform.image.background import CHANGE_OFFSET

_label_regions = Kernel("label_regions", "bool[h,w] mask, out u16[h,w] labels, out i32[n] work")
_region_moments = Kernel("region_moments", "u16[h,w] labels, f32[h,w] depth, out f64[n,14] moments")


@dataclass(frozen=True)
class Contact:
    """One connected region of the contact mask.

    Measures in mm are None if the scale is unknown. Positions are (x, y) in pixels of the image: x to the right, y
    down, pixel centers at whole numbers.

    Attributes
    ----------
    label : value in the label map, from 1
    area_px : number of pixels
    centroid_px : (x, y), mean position of its pixels
    deepest_px : (x, y) of its deepest pixel
    angle_deg : direction of the major axis, from x (right) toward y (down), -90 to 90
    cut_by_border : whether it reaches the image's border; if so, its measures are those of the visible part
    area_mm2 : area, mm^2
    volume_mm3 : integral of the depth, mm^3
    deepest_mm : depth of its deepest pixel, mm
    axes_mm : full lengths of the major and minor axis of the ellipse with its second moments, mm
    """

    label: int
    area_px: int
    centroid_px: tuple[float, float]
    deepest_px: tuple[int, int]
    angle_deg: float
    cut_by_border: bool
    area_mm2: float | None = None
    volume_mm3: float | None = None
    deepest_mm: float | None = None
    axes_mm: tuple[float, float] | None = None

    def __repr__(self) -> str:
        area = f"{self.area_px} px" if self.area_mm2 is None else f"{self.area_mm2:.3g} mm^2"
        deepest = "" if self.deepest_mm is None else f", {self.deepest_mm:.3f} mm deep"
        x, y = self.centroid_px
        cut = ", cut by the border" if self.cut_by_border else ""
        return f"Contact({self.label}: {area}{deepest}, around ({x:.0f}, {y:.0f}) px{cut})"


def contacts_from_mask(
    contact: ArrayLike, depth: ArrayLike, *, mm_per_px: float | Sequence[float] | None
) -> tuple[tuple[Contact, ...], NDArray[np.uint16]]:
    """The connected regions of a contact mask, the largest first, and the map of their labels.

    Pixels that touch at a corner are connected. Holes stay holes: a ring is one contact whose area and volume leave
    out the region that it encloses.

    Parameters
    ----------
    contact : (H, W) bool
    depth : (H, W), positive where pressed; mm if `mm_per_px` is not None
    mm_per_px : float or (x, y), mm; None where the scale is unknown

    Returns
    -------
    contacts : sorted by area, the largest first
    labels : (H, W) uint16, 0 where nothing touches

    Raises
    ------
    ValueError, TypeError
        Wrong shapes, NaN, or a pitch that is not positive.
    """
    height = check_map(depth, "depth")
    mask = as_array(contact, "contact")
    if height.ndim != 2 or mask.shape != height.shape:
        raise ValueError(
            f"Expected contact and depth of one frame, (H, W), got {mask.shape} and {height.shape}."
        )
    if mask.dtype != np.bool_:
        raise TypeError(f"Expected contact as bool, got {mask.dtype}. Convert it: contact > 0.")
    pitch = None if mm_per_px is None else check_mm_per_px(mm_per_px)
    count, labels = labeled(mask)
    moments = np.empty((count, 14))
    _region_moments(labels, height, moments)
    found = [_contact(k, row, pitch, mask.shape) for k, row in enumerate(moments, start=1)]
    return tuple(sorted(found, key=lambda one: (-one.area_px, one.label))), labels


def unknown_contact(
    contact: Mask, at_rest: Mask, known: Mask, touched_share: Callable[[], float]
) -> tuple[Finding, ...]:
    """One finding if no contact (H, W) was found, but many known pixels do not have the color of rest.

    `touched_share` gives the share of the largest region that no light explains: compressed video changes many colors a
    little, a touch those of a region a lot.
    """
    if contact.any():
        return ()
    touched = float(np.count_nonzero(known & ~at_rest)) / max(float(np.count_nonzero(known)), 1.0)
    if touched < 0.05 or touched_share() < TOUCHED_SHARE:  # noise leaves the color of rest at 0.1 %
        return ()
    message = (
        f"Something touches the gel: {100 * touched:.0f} % of it changed. Where it presses and how deep is not known, "
        "because the slopes there are not."
    )
    return (Finding("contact_unknown", message, touched),)


def labeled(mask: Mask) -> tuple[int, NDArray[np.uint16]]:
    """The number of connected regions of a mask (H, W), and the map of their labels in the order of their first pixels."""
    labels = np.empty(mask.shape, dtype=np.uint16)
    found = _label_regions(
        np.ascontiguousarray(mask), labels, np.empty(runs_work(labels.shape), dtype=np.int32)
    )
    if found > np.iinfo(np.uint16).max:
        raise ValueError(f"Expected at most 65535 separate contacts, got {found}: is this noise?")
    return found, labels


def runs_work(shape: tuple[int, ...]) -> int:
    """Words of memory for the largest number of runs of pixels that a map (H, W) can have: five a run, as in runs.h."""
    return 5 * shape[0] * ((shape[1] + 1) // 2)


def _contact(label: int, row: Numbers, pitch: tuple[float, float] | None, shape: tuple[int, ...]) -> Contact:
    """A region of the moments that `region_moments` sums; without measures in mm if there is no pitch."""
    count, x, y, xx, xy, yy, volume, deepest, deepest_x, deepest_y, left, right, top, bottom = row.tolist()
    center, (x_mm, y_mm) = (x / count, y / count), pitch or (1.0, 1.0)
    # A pixel is a square, not a point: its own second moment is 1/12.
    a = (xx / count - center[0] ** 2 + 1 / 12) * (x_mm * x_mm)
    b = (xy / count - center[0] * center[1]) * (x_mm * y_mm)
    d = (yy / count - center[1] ** 2 + 1 / 12) * (y_mm * y_mm)
    mean, apart = (a + d) / 2, float(np.hypot((a - d) / 2, b))
    in_mm: dict[str, Any] = {
        "area_mm2": count * x_mm * y_mm,
        "volume_mm3": volume * x_mm * y_mm,
        "deepest_mm": deepest,
        "axes_mm": tuple(4 * float(np.sqrt(max(square, 0.0))) for square in (mean + apart, mean - apart)),
    }
    return Contact(
        label=label,
        area_px=int(count),
        centroid_px=center,
        deepest_px=(int(deepest_x), int(deepest_y)),
        angle_deg=float(np.rad2deg(np.arctan2(2 * b, a - d)) / 2),
        cut_by_border=left == 0 or top == 0 or right == shape[1] - 1 or bottom == shape[0] - 1,
        **(in_mm if pitch else {}),
    )


class Surround:
    """Compares the color around a contact with that inside it, for the images of one background (H, W, 3), 0-255.

    The images are as they came: correcting the exposure would hide the change of light around a large soft contact.
    """

    def __init__(self, background: Map) -> None:
        height, width = background.shape[:2]
        step = max(1, height // 40)  # to 40 rows: the measure is one of large areas
        self._size = width // step, height // step
        rest = self._coarse(np.asarray(background, dtype=np.float32))
        self._gain = 1 / (rest + np.float32(CHANGE_OFFSET))
        self._at_rest = rest * self._gain

    def __call__(self, image: NDArray[np.number], contact: Mask) -> float | None:
        """Median change outside a contact (H, W), over its mean inside; None if there is no inside or no outside."""
        inside = cv2.resize(contact.view(np.uint8), self._size, interpolation=cv2.INTER_NEAREST)
        outside = cv2.dilate(inside, np.ones((3, 3), dtype=np.uint8)) == 0  # but for a coarse pixel around it
        if not inside.any() or not outside.any():
            return None
        change = self._coarse(image)
        change *= self._gain
        change -= self._at_rest
        change *= change
        square = change @ np.ones(change.shape[-1], dtype=np.float32)
        within = float(np.sqrt(square[inside > 0]).mean())
        around = square[outside]
        middle = len(around) // 2
        return float(np.sqrt(np.partition(around, middle)[middle])) / within if within > 0 else None

    def _coarse(self, image: NDArray[np.number]) -> Map:
        # Means of four pixels: a mean of all would take thirty times as long, and the measures are of large areas.
        return np.asarray(cv2.resize(image, self._size), dtype=np.float32)
