"""Presses for several benchmarks: mini-ball with its reference circles; simulated presses in calibration's form."""

from __future__ import annotations

import csv
import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import gelform
from gelform.calibration.presses.press_set import Presses
from gelform.depth.coarse import RestAnchor
from gelform.depth.solvers import SOLVERS
from gelform.simulate import SimulatedPresses

DATA = Path(os.environ.get("GELFORM_DATA", Path(__file__).parents[2] / "shared" / "data"))
Circle = tuple[float, float, float]


def data_is_missing(part: str) -> bool:
    """Whether the real data are missing; then print that the part is left out."""
    if not DATA.is_dir():
        print(f"\n{part}: left out, no data in {DATA} (set GELFORM_DATA).")
    return not DATA.is_dir()


def reference_circles(name: str = "mini-ball") -> dict[str, Circle]:
    """Center and radius (px) of the contacts of a set that has them, for scoring, by the names of the presses."""
    with (DATA / name / "reference_circles.csv").open(encoding="utf-8") as file:
        return {
            row["image"]: (
                float(row["center_x_px"]),
                float(row["center_y_px"]),
                float(row["contact_radius_px"]),
            )
            for row in csv.DictReader(file)
        }


def mini_ball() -> tuple[Presses, list[int]]:
    """The presses, labeled with the reference circles, and their order by name."""
    presses, circles = gelform.read_presses(DATA / "mini-ball"), reference_circles()
    labeled = tuple(replace(p, label=circles[p.name]) for p in presses.presses)
    return replace(presses, presses=labeled), by_name(presses)


def depth_by(solver: str, reconstruct: gelform.Reconstructor, image: NDArray[Any]) -> NDArray[np.float32]:
    """Depth (H, W), mm, of an image by another solver than a frame's, with weights and anchor if it takes them."""
    record = reconstruct.record(image)
    slopes, fixed = record.slopes, record.fixed
    how: dict[str, Any] = {"zero": slopes.at_rest}
    if SOLVERS[solver].takes_weights:
        sigma = fixed.slope_sigma.full_confidence_sigma
        anchor = RestAnchor(slopes.at_rest.shape, fixed.pitch, sigma)(slopes.gradients, slopes.at_rest)
        how = {"weights": slopes.weights(sigma), "anchor": anchor}
    depth = gelform.depth_from_gradients(slopes.gradients, mm_per_px=fixed.pitch, solver=solver, **how)
    return fixed.limit.bound(depth)[0]


def by_name(presses: Presses) -> list[int]:
    """The indices of the presses in the order of their names."""
    return sorted(range(len(presses.presses)), key=lambda i: presses.presses[i].name)


def unlabeled(presses: Presses, indices: Sequence[int] | None = None) -> Presses:
    """These presses, or all, without their circles."""
    chosen = presses.presses if indices is None else [presses.presses[i] for i in indices]
    return replace(presses, presses=tuple(replace(press, label=None) for press in chosen))


def labeled(presses: Presses) -> Presses:
    """The presses accepted by a calibration on all, without a starter, with its circles; people's labels stay."""
    if presses.presses[0].label is not None:
        return presses
    return with_circles(presses, gelform.calibrate(presses, start=None))


def with_circles(presses: Presses, calibration: gelform.Calibration) -> Presses:
    """The presses that a calibration accepted, with its circles."""
    rows = calibration.report.presses
    kept = (
        replace(press, label=(row.center_x_px, row.center_y_px, row.contact_radius_px))
        for press, row in zip(presses.presses, rows)
        if row.accepted
    )
    return replace(presses, presses=tuple(kept))


def presses_of(made: SimulatedPresses) -> Presses:
    """Simulated presses in the form that calibration reads."""
    with tempfile.TemporaryDirectory() as folder:
        gelform.save_simulated_presses(Path(folder) / "presses", made, truth=False)
        return gelform.read_presses(Path(folder) / "presses")
