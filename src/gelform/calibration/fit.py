"""calibrate: from presses of a ball to a Calibration, without a click; and evaluate: its errors on other presses."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from os import PathLike
from typing import Any

import cv2
import numpy as np

from gelform.arrays import Map, Numbers
from gelform.calibration.circles.find import ContactCircle, change_settings, prepare, why_no_contact
from gelform.calibration.circles.locate import locate
from gelform.calibration.coverage import SAMPLED
from gelform.calibration.held_out import errors_of, measure_held_out
from gelform.calibration.inputs import (
    MOST_SIGMAS,
    background_findings,
    ball_readings,
    check_inputs,
    check_places,
    first_notes,
    input_notes,
    light_press_notes,
    make_findings,
    mixed_balls,
    readings_of_errors,
)
from gelform.calibration.presses.folder import Presses, as_presses, with_view
from gelform.calibration.presses.press_set import Press
from gelform.calibration.report.content import errors_where
from gelform.calibration.report.record import report_of_run, summary
from gelform.calibration.selection import candidates_for, fit, image_noise, make_folds
from gelform.calibration.start import AUTO, start_from, starter_start
from gelform.calibration_file import Calibration, as_calibration
from gelform.errors import DataError, Progress, no_progress
from gelform.image.background import noise_from_image
from gelform.motion.between import motion_between, moved
from gelform.reconstruct import Reconstructor


def calibrate(
    presses: Presses | str | PathLike[str],
    *,
    color_model: str = "auto",
    start: Calibration | str | PathLike[str] | None = AUTO,
    compare: bool = False,
    progress: Progress = no_progress,
) -> Calibration:
    """Calibrate a sensor from presses of a ball.

    It finds each contact circle, and measures the contact edge, where the gel leaves the ball. It splits the presses into
    folds, and selects the stiffness of the color model and its forward response on held-out presses. Then it fits both on
    all presses.

    Parameters
    ----------
    presses : from `read_presses`, or a path that it reads without options
    color_model : "auto" or a name in `gelform.slopes.color_models.COLOR_MODELS`
    start : "auto", None, or the calibration of another unit of the same sensor, of any color model, or its file
        Its model is kept where these presses give no other information, so five presses suffice. "auto" takes the starter
        of a known make; None takes none. A fit from the start and one without it are averaged, by how well they read
        held-out presses. Under 12 presses, the contact edge and the gel's relaxation length are the start's.
    compare : whether every color model is tried on the same folds, for the report's table; the selection stays the same
    progress : called with (done, total, what)

    Returns
    -------
    Calibration
        With `.report`: every circle, the reasons for rejected presses, the candidates, the held-out errors.

    Raises
    ------
    CalibrationError
        Too few presses fit, and the message has the reason for each rejected one.
    ValueError, TypeError
        An unknown color model, a start that cannot be one, or no presses.
    """
    began = time.monotonic()
    read = as_presses(presses, progress=progress)
    candidates_for(color_model, len(read.presses))  # an unknown name fails before any work
    presses = read.reduced()
    check_inputs(presses)
    doubts = *make_findings(read), *background_findings(presses)
    untried: tuple[str, ...] = ()
    if start is None:
        known, _ = starter_start(read, color_model)
    elif start == AUTO:
        known, untried = starter_start(read, color_model)
    else:
        known = start_from(start, read, color_model)
    if known is not None and presses is not read:
        known = known.at_size(presses.image_shape, presses.reduced_by)
    first_unit = None if known is None or start is None or (start == AUTO and not known.offered) else known

    located = locate(presses, first_unit, progress=progress)
    balls = ball_readings(located, known)
    said = (
        *(one.message for one in doubts),
        *first_notes(read, balls),
        *untried,
    )
    located = replace(located, notes=(*said, *located.notes))
    check_places(located)
    folds = make_folds(located, progress=progress)
    fitted = fit(located, folds, color_model, compare=compare, progress=progress)
    judged = measure_held_out(fitted, progress=progress)
    mixed = mixed_balls(located, [errors.radius_percent for errors in judged.errors.values()])
    notes = (
        *(one.sentence() for one in mixed),
        *light_press_notes(located, (*balls, *mixed)),
        *input_notes(located),
    )
    made = replace(fitted.calibration, slope_sigma=judged.slope_sigma, forward=judged.forward)
    own = [presses.presses[i] for i in located.refined.accepted]
    circles = [located.refined.contacts[i] for i in located.refined.accepted]
    place_error = place_error_from_presses(made, own, circles)
    report = report_of_run(fitted, judged, (*balls, *mixed), notes=notes, seconds=time.monotonic() - began)
    made = replace(
        made,
        settings=replace(
            made.settings,
            place_error=place_error,
            findings=[[one.name, one.message, one.figure] for one in doubts] or None,
        ),
        held_out=report.held_out,
        report=report,
    )
    return made if presses is read else for_images_as_read(made, presses, read)


def for_images_as_read(made: Calibration, presses: Presses, read: Presses) -> Calibration:
    """The calibration of presses that were reduced (`Presses.reduced`), for their images as they were read."""
    side, shape = presses.reduced_by, read.image_shape
    model, forward, sigma = made.color_model, made.forward, made.slope_sigma
    assert forward is not None
    assert sigma is not None
    by_small = {small.digest: press for small, press in zip(presses.presses, read.presses)}
    used = [by_small[digest] for digest in made.training_digests]
    rows = []
    for row in made.report.presses:
        x, y, radius = presses.as_read((row.center_x_px, row.center_y_px, row.contact_radius_px))
        center_sigma, radius_sigma = (
            one and side * one for one in (row.center_sigma_px, row.contact_radius_sigma_px)
        )
        rows.append(
            replace(
                row,
                center_x_px=x,
                center_y_px=y,
                contact_radius_px=radius,
                center_sigma_px=center_sigma,
                contact_radius_sigma_px=radius_sigma,
            )
        )
    pixels = made.report.pixels.copy()
    for name in ("x_px", "y_px"):
        pixels[name] = (pixels[name] + 0.5) * side - 0.5
    noise = read.background_noise
    return replace(
        made,
        view=read.camera_view,
        image_shape=shape,
        mm_per_px=read.mm_per_px,
        mm_per_px_sigma=read.mm_per_px_sigma,
        background=read.background,
        background_noise=noise_from_image(read.background) if noise is None else noise,
        change=change_settings(read, made.change.offset),
        color_model=model.at_size(shape, 1 / side),
        forward=forward.at_size(shape, 1 / side),
        slope_sigma=replace(
            sigma,
            correlation_px=side * sigma.correlation_px,
            rest_correlation_px=side * sigma.rest_correlation_px,
            # Depth takes errors of pixels for independent, and there are more of them over the same errors now.
            depth_factor=side * sigma.depth_factor,
        ),
        training_digests=tuple(press.digest for press in used),
        settings=replace(
            made.settings, image_noise=image_noise([press.image for press in used], read.background).tolist()
        ),
        report=replace(made.report, presses=tuple(rows), pixels=pixels),
    )


def place_error_from_presses(
    calibration: Calibration, presses: Sequence[Press], contacts: Sequence[ContactCircle]
) -> float | None:
    """Root mean square error of a ball's center along an axis, over its displacement; None: too few pairs.

    Each press is compared with the next one of the same ball. Its center is found from the contact's slopes
    (`gelform.motion`) and from the circle in the image. Slopes are wrong by a little more at one place than at another, so
    the two differ by more, the farther the ball moved.
    """
    reconstruct, pitch = Reconstructor(calibration), calibration.known_mm_per_px
    middle = (np.array(calibration.image_shape[::-1]) - 1) / 2
    step = -(-len(presses) // SAMPLED)
    whole = [
        (press, np.array([circle.x_px, circle.y_px]))
        for press, circle in zip(presses[::step], contacts[::step])
        if circle.is_whole_in(calibration.image_shape)
    ]
    whole.sort(key=lambda one: one[0].ball_diameter_mm)
    shares: list[Numbers] = []
    results = [reconstruct.from_image(press.image) for press, _ in whole]
    for (first, second), ((one, from_px), (other, to_px)) in zip(pairwise(results), pairwise(whole)):
        start = np.eye(4)
        start[:2, 3] = travel = (to_px - from_px) * pitch
        distance = float(np.linalg.norm(travel))
        if one.ball_diameter_mm != other.ball_diameter_mm or distance < 1:
            continue  # in less than 1 mm the circles' own errors matter
        pose = motion_between(first, second, start=start).pose
        if pose is not None:
            center = np.array([*(from_px - middle) * pitch, first.peak_mm - one.ball_diameter_mm / 2])
            shares.append((moved(pose, center)[:2] - (to_px - middle) * pitch) / distance)
    return float(np.sqrt(np.mean(np.square(shares)))) if len(shares) >= 4 else None


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
    # About a background that is not, and a ball that is read otherwise than stated.
    findings: tuple[str, ...] = ()
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
    """Measure errors on presses of known balls and flat punches, whose circles are found as `calibrate` finds them.

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
    ratio = calibration.settings.contact_radius_ratio or 1.0
    rows, errors, pixels, radii = [], [], [], dict[float, list[float]]()
    small = presses.reduced()
    for done, (press, found) in enumerate(zip(presses.presses, prepare(small, progress=progress))):
        circle, reason = small.as_read(found.found.circle_px), found.refused or why_no_contact(found.found)
        row: dict[str, Any] = {
            "name": press.name,
            "ball_diameter_mm": press.ball_diameter_mm,
            "seen": press.digest in calibration.training_digests,
            "circle_px": circle,
            "reason": reason,
        }
        if reason is None:
            result = reconstruct.from_image(press.image)
            wrong, solved, _ = errors_of(done, press, circle, result, mm_per_px, ratio)
            errors.append(wrong)
            radii.setdefault(press.ball_diameter_mm, []).append(wrong.radius_percent)
            pixels.append(solved)
            row["errors"] = asdict(wrong)
        rows.append(row)
        progress(done + 1, len(presses.presses), "reconstructing presses")
    if not errors:
        reason = rows[0]["reason"] if rows else "there is none"
        raise DataError(f"No press of {presses.folder} could be evaluated; the first: {reason}.")
    seen = sum(row["seen"] for row in rows if row["reason"] is None)
    wrong_ball = [one for one in readings_of_errors(calibration, radii) if one.sigmas > MOST_SIGMAS]
    findings = (
        *(finding.message for finding in reconstruct.findings),
        *(one.sentence() for one in wrong_ball),
    )
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
