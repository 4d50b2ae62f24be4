"""Part of real_frames.py: the edge of a cube, whose faces are steeper than any ball shows, on a Mini without presses."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

import gelform
from edges_of_cube import Edge, crest_error_mm, edge_in, frames
from real_frames.sets import MINI_MM_PER_PX, Run, percent
from report import table

CARRIED = ("starter", "mini-ball", "mini-d")  # what reads the frames: of other units
SURE = 0.3  # confidence; pixels above count as sure
COLUMNS, APART_MM = (
    12,
    2.5,
)  # the last of a frame, where the light drifted; distance from the faces where gel is at rest


def edges(run: Run) -> dict[str, Any]:
    """Angle and slopes of the faces, whether their sigma and confidence say that they are wrong, and the crest's depth."""
    background, images = frames()
    figures: dict[str, Any] = {}
    for name in (one for one in CARRIED if one == "starter" or one in run.sets):
        reconstruct = gelform.Reconstructor(run.carried(name, background.astype(np.float32)))
        results = map(reconstruct.from_image, run.some(list(images.values())))
        pairs = [(edge_in(result.gradients, MINI_MM_PER_PX), result) for result in results]
        figures[name] = summary([judged(edge, result) for edge, result in pairs if edge is not None])
    header = ["cube edge, read by", *next(iter(figures.values()))]
    print("\n" + table(header, [[k, *v.values()] for k, v in figures.items()]), flush=True)
    return figures


def judged(edge: Edge, result: Any) -> dict[str, Any]:
    """Figures of one frame: of all pixels of both faces, and of the depth at the edge against flat faces of 45 degrees."""
    off, sure = [], []
    for face, true in zip(edge.faces, edge.true_gradients):
        sigma = np.hypot(*(result.gradients_sigma[face] * edge.across).T)
        off.append(np.abs((result.gradients[face] - true) @ edge.across) / sigma)
        sure.append(result.confidence[face] > SURE)
    missing = crest_error_mm(edge, result.depth_mm, MINI_MM_PER_PX)
    return {
        "border": border_off(edge.faces.any(axis=0), result),
        "angle": 180 - edge.angle_deg,
        "slopes": np.sort(edge.slopes),
        "off": np.concatenate(off),
        "sure": np.concatenate(sure),
        "missing": missing,
        "sigma": float(np.nanmean(result.depth_sigma_mm[edge.crest])),
    }


def border_off(touched: np.ndarray, result: Any) -> np.ndarray:
    """|depth| over its sigma at the known pixels (N,) of the last columns that are far from what is touched (H, W)."""
    away = cv2.distanceTransform((~touched).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    last = result.known & (away > APART_MM / MINI_MM_PER_PX)
    last[:, :-COLUMNS] = False
    return np.abs(result.depth_mm[last]) / result.depth_sigma_mm[last]


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Figures of all frames; pixels of all frames count alike."""
    if not rows:
        return {"frames": 0}
    off, sure, border = (np.concatenate([row[key] for row in rows]) for key in ("off", "sure", "border"))
    missing, sigma = (np.array([row[key] for row in rows]) for key in ("missing", "sigma"))
    flat, steep = np.median([row["slopes"] for row in rows], axis=0).tolist()
    return {
        "frames": len(rows),
        "angle of faces, deg": float(np.mean([row["angle"] for row in rows])),
        "flatter face's slope": flat,
        "steeper face's slope": steep,
        "error over sigma, median": float(np.median(off)),
        "within 2 sigma, %": percent(off <= 2),
        "confidence > 0.3, %": percent(sure),
        "crest too low by, um": float(1e3 * np.mean(missing)),
        "crest within 2 depth sigma, %": percent(np.abs(missing) <= 2 * sigma),
        f"last {COLUMNS} columns beyond 2 depth sigma, %": percent(border > 2),
    }
