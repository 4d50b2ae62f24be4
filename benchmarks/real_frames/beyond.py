"""Part of real_frames.py: whether slopes that the presses have not shown, or another unit's, are stated as unsure.

Balls are the truth. A calibration of gentle slopes is trained on the inner part of each contact alone, and judged on
held-out pixels that are steeper. A carried calibration is of another unit of the same make.
"""

from __future__ import annotations

from typing import Any
from unittest.mock import patch

import numpy as np

import gelform
from accuracy.real import EDGES, STEEPEST
from gelform.calibration import held_out
from gelform.calibration.circles.find import PreparedPress
from gelform.result.metrics import ball_center, score_slopes
from presses import unlabeled
from real_frames.edges import SURE
from real_frames.sets import Run, percent
from report import table

OWN = ("mini-ball", "mini-d", "digit-ball")
CARRIED = (("mini-ball", "mini-d"), ("mini-d", "mini-ball"))  # whose calibration, whose presses
GENTLE = (0.4, 0.5)  # mm/mm, steepest slope of the training
FAR_RADII = 2.5  # of the visible circle; beyond it nothing touches
INNER = 0.6  # of the visible circle: where a sure pixel is expected
TOP, RIM_PX = 0.2, 1.5  # of the edge's radius; half the width of the ring at the edge
# A height over the edge is a difference of two depths. A depth's own sigma, against gel at rest, is wider, because the gel
# around the contact has slopes too.
CAPS = (
    *(f"caps within {n} sigma of the difference, %" for n in (1, 2)),
    *(f"caps within {n} depth sigma, %" for n in (1, 2)),
)


def beyond(run: Run) -> dict[str, Any]:
    """Balls by half of a unit's presses, by such without steep slopes, and by another unit's calibration."""
    figures: dict[str, Any] = {"balls": {}, "steeper": {}}
    for name in (one for one in OWN if one in run.sets):
        presses = run.labeled(name)
        even, odd = (presses.subset(range(k, len(presses.presses), 2)) for k in (0, 1))
        test, edge = run.some(odd.presses), EDGES[name]
        own = run.kept(f"{name}, even", lambda even=even: gelform.calibrate(unlabeled(even), start=None))
        figures["balls"][f"{name}, own"] = on_balls(own, test, edge)
        for limit in GENTLE:
            gentle = run.kept(
                f"{name}, even, below {limit}", lambda even=even, limit=limit: below(even, limit)
            )
            figures["steeper"][f"{name}, below {limit}"] = steeper(gentle, test, edge, limit)
    for of, name in (pair for pair in CARRIED if set(pair) <= set(run.sets)):
        presses = run.labeled(name)
        carried = run.carried(of, presses.background, presses.mm_per_px)
        test = run.some(presses.presses)
        figures["balls"][f"{name}, by {of}'s"] = on_balls(carried, test, EDGES[name])
    for what, rows in figures.items():
        header = [what, *next(iter(rows.values()))] if rows else [what]
        print("\n" + table(header, [[k, *v.values()] for k, v in rows.items()]), flush=True)
    return figures


def below(presses: Any, limit: float) -> gelform.Calibration:
    """A calibration that has seen, and judged itself by, the slopes below a limit alone."""
    radius, factors = PreparedPress.contact_radius, held_out.with_factors

    def near(self: PreparedPress, contact: Any) -> float:
        return min(radius(self, contact), float(np.sin(np.arctan(limit))) * self.ball_radius_px)

    def of_gentle(sigma: Any, pixels: np.ndarray, *others: Any) -> Any:
        return factors(sigma, pixels[np.linalg.norm(pixels["true"], axis=1) < limit], *others)

    with (
        patch.object(PreparedPress, "contact_radius", near),
        patch.object(held_out, "with_factors", of_gentle),
    ):
        return gelform.calibrate(unlabeled(presses), start=None)


def steeper(calibration: gelform.Calibration, presses: Any, edge: float, limit: float) -> dict[str, float]:
    """Held-out pixels whose true slope exceeds the limit: share within two sigma, and share that counts as sure."""
    reconstruct, pixels = gelform.Reconstructor(calibration), []
    for press in presses:
        result = reconstruct.from_image(press.image)
        true, off, inside = slopes_inside(press, result, edge)
        above = np.linalg.norm(true, axis=1) > limit
        sure = result.confidence[inside][above] > SURE
        pixels.append(np.column_stack([(off[above] <= 2).mean(axis=1), sure]))
    within, sure = np.concatenate(pixels).T
    return {"pixels": len(within), "within 2 sigma, %": percent(within), "sure, %": percent(sure)}


def on_balls(calibration: gelform.Calibration, presses: Any, edge: float) -> dict[str, float]:
    """Slopes inside the contact edge within one sigma; sure pixels of the inner part; height of the cap."""
    reconstruct, rows = gelform.Reconstructor(calibration), []
    for press in presses:
        result = reconstruct.from_image(press.image)
        _, off, inside = slopes_inside(press, result, edge)
        rows.append(
            [
                (off <= 1).mean(),
                sure_inner(result, press),
                *_cap(press, result, inside),
            ]
        )
    names = ("slopes within 1 sigma, %", "sure inside 0.6, %", *CAPS)
    return {"presses": len(rows), **dict(zip(names, (100 * np.mean(rows, axis=0)).tolist()))}


def slopes_inside(press: Any, result: Any, edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """True slopes (N, 2) inside the contact edge, errors over sigma (N, 2), and the pixels' mask (H, W)."""
    x, y, radius = press.label
    ball_px = press.ball_diameter_mm / 2 / result.mm_per_px
    inside = distance(result, (x, y)) < min(edge * radius, STEEPEST * ball_px)
    rows, columns = np.nonzero(inside)
    score = score_slopes(result.gradients[inside], columns, rows, (x, y), ball_px)
    return score.true_gradients, np.abs(score.errors) / result.gradients_sigma[inside], inside


def sure_inner(result: Any, press: Any) -> float:
    """Share of sure pixels in the inner part of the visible circle."""
    x, y, radius = press.label
    return float((result.confidence[distance(result, (x, y)) < INNER * radius] > SURE).mean())


def _cap(press: Any, result: Any, inside: np.ndarray) -> list[bool]:
    """Whether the height of the ball's top over the contact edge is right, by `CAPS`."""
    pitch = result.mm_per_px
    ball_px, radius = press.ball_diameter_mm / 2 / pitch, float(np.sqrt(inside.sum() / np.pi))
    rows, columns = np.nonzero(inside)
    center = ball_center(result.gradients[inside], columns, rows, press.label[:2], ball_px)
    away = distance(result, center)
    off = result.depth_mm - pitch * np.sqrt(np.maximum(ball_px**2 - away**2, 0))
    top, rim = away < TOP * radius, np.abs(away - radius) < RIM_PX
    error = abs(off[top].mean() - off[rim].mean())
    return [
        bool(error < n * stated[top].mean())
        for stated in (result.depth_difference_sigma(rim), result.depth_sigma_mm)
        for n in (1, 2)
    ]


def distance(result: Any, center: Any) -> np.ndarray:
    """Distance of each pixel (H, W) from a place (x, y), px."""
    y, x = np.mgrid[: result.shape[0], : result.shape[1]]
    return np.hypot(x - center[0], y - center[1])
