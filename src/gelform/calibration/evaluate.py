"""Errors of a calibration on presses of a ball, through the same path as any frame."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from os import PathLike
from typing import Any

import cv2
import numpy as np

from gelform.arrays import Map
from gelform.calibration.circles.find import ColorChanges, find_contact, why_no_contact
from gelform.calibration.held_out import errors_of
from gelform.calibration.presses.folder import Presses, as_presses, with_view
from gelform.calibration.report.content import errors_where
from gelform.calibration.report.record import summary
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import DataError
from gelform.foundations.findings import Progress, no_progress
from gelform.reconstruct import Reconstructor


@dataclass(frozen=True)
class Evaluation:
    """Errors on presses."""

    # One per press: its name, whether the calibration was made from it, its circle and errors, or the reason for none.
    rows: tuple[dict[str, Any], ...]
    summary: dict[str, float]  # over the presses that have errors
    # Their normal errors by the ball's slope and by place, as `errors_where` gives them.
    where: dict[str, Any]
    seen: int  # number of presses that the calibration was made from; their errors say little
    own_background: bool = True  # whether the presses' background is the calibration's own, pixel for pixel
    findings: tuple[str, ...] = ()  # about a background that is not
    # One per press of a flat punch: its name, its known and its measured height, mm; None if its face is not completely in
    # the image.
    flats: tuple[dict[str, Any], ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The evaluation, as values that JSON can hold."""
        return asdict(self)


def evaluate(
    calibration: Calibration | str | PathLike[str],
    presses: Presses | str | PathLike[str],
    *,
    progress: Progress = no_progress,
) -> Evaluation:
    """Measure errors on presses of known balls and flat punches; labels are used if the folder has them.

    Parameters
    ----------
    calibration : or its file
    presses : from `read_presses`, or a path that it reads without options
        Frames without a view of their own pass through the calibration's view.
    progress : called with (done, total, what)

    Raises
    ------
    DataError
        No press could be evaluated; the message has the reasons.
    CalibrationError, ValueError, TypeError
        The presses are not of the calibrated sensor, or of another image size, or none.
    """
    calibration = as_calibration(calibration)
    presses, view = as_presses(presses, progress=progress), calibration.view
    if presses.view != view and presses.view.is_identity and presses.image_shape == view.frame_shape:
        presses = with_view(presses, view, presses.geometry.lens)
    mm_per_px = calibration.known_mm_per_px
    reconstruct = Reconstructor(calibration, presses.background)
    changes = ColorChanges(reconstruct.background, calibration.change)
    ratio = calibration.settings.contact_radius_ratio or 1.0
    rows, errors, pixels = [], [], []
    for done, press in enumerate(presses.presses):
        if press.label is None:
            contact = find_contact(changes(press.image)[0])
            circle, reason = contact.circle_px, why_no_contact(contact)
        else:
            circle, reason = press.label, None
        row: dict[str, Any] = {
            "name": press.name,
            "ball_diameter_mm": press.ball_diameter_mm,
            "seen": press.digest in calibration.training_digests,
            "circle_px": circle,
            "reason": reason,
        }
        if reason is None:
            result = reconstruct.from_image(press.image)
            found, solved, _ = errors_of(done, press, circle, result, mm_per_px, ratio)
            errors.append(found)
            pixels.append(solved)
            row["errors"] = asdict(found)
        rows.append(row)
        progress(done + 1, len(presses.presses), "reconstructing presses")
    if not errors:
        reason = rows[0]["reason"] if rows else "there is none"
        raise DataError(f"No press of {presses.folder} could be evaluated; the first: {reason}.")
    seen = sum(row["seen"] for row in rows if row["reason"] is None)
    findings = tuple(finding.message for finding in reconstruct.findings)
    where = errors_where(np.concatenate(pixels), calibration.image_shape, ratio)
    flats = []
    for flat in presses.flats:
        read_mm = face_height_mm(reconstruct.from_image(flat.image).depth_mm)
        known = {"name": flat.name, "height_mm": flat.height_mm}
        flats.append({**known, "read_mm": read_mm if np.isfinite(read_mm) else None})
    own = reconstruct.own_background
    return Evaluation(tuple(rows), summary(errors), where, seen, own, findings, tuple(flats))


def face_height_mm(depth_mm: Map) -> float:
    """Mean depth in the middle of the largest flat face of a depth map (H, W); NaN if the border cuts it.

    A small tilt does not change the mean about the middle. A punch has to be about as wide as it is long.
    """
    top = float(cv2.blur(depth_mm, (5, 5)).max())
    standing = (depth_mm > 0.5 * top).astype(np.uint8)  # the punch and a narrow strip around it
    count, _, stats, centers = cv2.connectedComponentsWithStats(standing)
    if top <= 0 or count < 2:
        return float("nan")
    largest = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    left, up, width, height, area = stats[largest]
    if left == 0 or up == 0 or left + width == depth_mm.shape[1] or up + height == depth_mm.shape[0]:
        return float("nan")
    rows, columns = np.ogrid[: depth_mm.shape[0], : depth_mm.shape[1]]
    square = (columns - centers[largest][0]) ** 2 + (rows - centers[largest][1]) ** 2
    # Within 0.6 radii of a disc as large as the standing area is the face without its edge.
    return float(depth_mm[square <= max(0.6**2 * area / np.pi, 1.0)].mean())
