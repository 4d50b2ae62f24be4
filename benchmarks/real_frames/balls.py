"""Part of real_frames.py: the balls beside the other frames, each press judged by a calibration that has not seen it."""

from __future__ import annotations

from itertools import chain, islice
from typing import Any

import numpy as np

from accuracy.real import held_out, of_folds, of_mini_ball, scored, sigma
from real_frames.beyond import FAR_RADII, distance, slopes_inside
from real_frames.edges import SURE
from real_frames.sets import Run, percent
from report import table

KEPT = ("presses", "rim_deg", "edge_deg", "inner_deg", "radius_percent", "cap_um", "off_contact_um")
MINI_BALL, HALVES = "mini-ball", 2  # the first two splits
RING_RADII, BORDER = 3.0, 0.05  # radii of the visible circle where the ring ends; part of the height


def balls(run: Run) -> dict[str, Any]:
    """Errors of held-out presses: mini-ball's halves both ways, other sets in three folds; sigmas of mini-ball."""
    halves = islice(of_mini_ball(), HALVES) if MINI_BALL in run.sets else iter(())
    folds = map(of_folds, (name for name in run.sets if name != MINI_BALL))
    found = held_out(chain(halves, *folds), run.quick, scored_and_stated)
    shares = [key for key in next(iter(found.values())) if key.endswith("%")]
    print("\n" + table(["stated", *shares], [[n, *(one[k] for k in shares)] for n, one in found.items()]))
    figures: dict[str, Any] = {
        "errors": {name: {key: one[key] for key in (*KEPT, *shares)} for name, one in found.items()}
    }
    if MINI_BALL in run.sets:
        figures["sigma"] = sigma(run.quick)
    return figures


def scored_and_stated(
    press_and_result: tuple[Any, Any], circle: Any, mm_per_px: float, edge: float
) -> dict[str, float]:
    """Errors of one press, and how far its stated deviations hold."""
    errors = scored(press_and_result, circle, mm_per_px, edge)
    return errors | stated(*press_and_result, edge)


def stated(press: Any, result: Any, edge: float) -> dict[str, float]:
    """Percent of pixels within 1 and 2 sigma: depth off contact, in a ring beside it, at the border; slopes in contact.

    Off contact is beyond 2.5 radii of the visible circle, where depth is known; the ring ends at 3. `sure` are pixels
    inside the contact edge whose confidence exceeds 0.3.
    """
    (height, width), (x, y, radius) = result.shape, press.label
    away, off = distance(result, (x, y)), np.abs(result.depth_mm) / result.depth_sigma_mm
    inner = np.zeros(result.shape, dtype=bool)
    margin = round(BORDER * height)
    inner[margin : height - margin, margin : width - margin] = True
    far = result.known & (away > FAR_RADII * radius)
    regions = {"far": far, "ring": far & (away < RING_RADII * radius), "border": far & ~inner}
    within = {f"{name}{n} %": percent(off[region] <= n) for name, region in regions.items() for n in (1, 2)}
    _, slopes, inside = slopes_inside(press, result, edge)
    within |= {f"slopes{n} %": percent(slopes <= n) for n in (1, 2)}
    return within | {"sure %": percent(result.confidence[inside] > SURE)}
