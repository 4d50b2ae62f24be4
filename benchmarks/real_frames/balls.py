"""Part of real_frames.py: the balls beside the other frames, each press judged by a calibration that has not seen it."""

from __future__ import annotations

from itertools import chain, islice
from typing import Any

from accuracy.real import held_out, of_folds, of_mini_ball, sigma
from real_frames.sets import Run

KEPT = ("presses", "rim_deg", "edge_deg", "inner_deg", "radius_percent", "cap_um", "off_contact_um")
MINI_BALL, HALVES = "mini-ball", 2  # the first two splits


def balls(run: Run) -> dict[str, Any]:
    """Errors of held-out presses: mini-ball's halves both ways, other sets in three folds; sigmas of mini-ball."""
    halves = islice(of_mini_ball(), HALVES) if MINI_BALL in run.sets else iter(())
    folds = map(of_folds, (name for name in run.sets if name != MINI_BALL))
    found = held_out(chain(halves, *folds), run.quick)
    figures: dict[str, Any] = {
        "errors": {name: {key: one[key] for key in KEPT} for name, one in found.items()}
    }
    if MINI_BALL in run.sets:
        figures["sigma"] = sigma(run.quick)
    return figures
