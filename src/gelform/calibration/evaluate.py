"""Errors of a calibration on presses of a ball, through the same path as any frame."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from gelform.background.change import PreparedBackground
from gelform.calibration.circles.find import find_contact, why_no_contact
from gelform.calibration.circles.markers import change_without_markers
from gelform.calibration.presses.folder import Press, Presses
from gelform.calibration.report.record import summary
from gelform.calibration_file import Calibration
from gelform.errors import DataError
from gelform.markers import MarkerFinder
from gelform.metrics import PressErrors, press_errors
from gelform.progress import Progress, no_progress
from gelform.reconstruct import Reconstructor


@dataclass(frozen=True)
class Evaluation:
    """Errors on presses.

    Attributes
    ----------
    rows : one per press: its name, whether the calibration has seen it, its circle and errors, or why it has none
    summary : over the presses that have errors
    seen : how many of them the calibration was made from; their errors say little
    own_background : whether the presses' background is the calibration's own, pixel for pixel
    findings : what should be known of a background that is not
    """

    rows: tuple[dict[str, Any], ...]
    summary: dict[str, float]
    seen: int
    own_background: bool = True
    findings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """The evaluation as JSON can hold it."""
        return asdict(self)


def evaluate(calibration: Calibration, presses: Presses, *, progress: Progress = no_progress) -> Evaluation:
    """Reconstruct presses of known balls and compare; labels are used where the folder has them.

    Raises
    ------
    DataError
        No press could be evaluated; the reasons are in the message.
    CalibrationError, ValueError
        The presses are not of the calibrated sensor, or of another image size.
    """
    reconstruct = Reconstructor(calibration, presses.background)
    rows, errors = [], []
    for done, press in enumerate(presses.presses):
        circle, reason = _circle(press, reconstruct)
        row: dict[str, Any] = {
            "name": press.name,
            "ball_diameter_mm": press.ball_diameter_mm,
            "seen": press.digest in calibration.training_digests,
            "circle_px": circle,
            "reason": reason,
        }
        if reason is None:
            found = errors_of(press, circle, reconstruct)
            errors.append(found)
            row["errors"] = asdict(found)
        rows.append(row)
        progress(done + 1, len(presses.presses), "reconstructing presses")
    if not errors:
        raise DataError(f"No press of {presses.folder} could be evaluated; the first: {rows[0]['reason']}.")
    seen = sum(row["seen"] for row in rows if row["reason"] is None)
    said = tuple(finding.message for finding in reconstruct.findings)
    return Evaluation(tuple(rows), summary(errors), seen, reconstruct.own_background, said)


def errors_of(press: Press, circle_px: tuple[float, float, float], reconstruct: Reconstructor) -> PressErrors:
    """Errors of one press whose circle is known."""
    result = reconstruct.from_image(press.image)
    return press_errors(
        result.depth_mm,
        result.gradients,
        circle_px=circle_px,
        ball_radius_mm=press.ball_diameter_mm / 2,
        mm_per_px=reconstruct.calibration.known_mm_per_px,
    )


def _circle(press: Press, reconstruct: Reconstructor) -> tuple[tuple[float, float, float], str | None]:
    if press.label is not None:
        return press.label, None
    calibration = reconstruct.calibration
    rest = PreparedBackground(reconstruct.background, calibration.change)
    exposure, _ = rest.compare(press.image)
    change, _ = change_without_markers(press.image, rest, exposure, MarkerFinder(reconstruct.background))
    contact = find_contact(change)
    return contact.circle_px, why_no_contact(contact)
