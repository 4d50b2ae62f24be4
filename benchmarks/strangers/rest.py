"""Parts of strangers.py: gels at rest that are refused, called touched, or have a contact; two moments of one unit."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

import gelform
from gelform.calibration.starters import load_starter
from real_frames.sets import MINI, Run
from starters.make import unit_of
from strangers.rows import Row, row, shown
from strangers.units import (
    BEGINNING,
    MAKES,
    SECOND,
    Said,
    background,
    clips,
    own,
    pitch_of,
    said_of,
    starter_without,
    wedge_rests,
)

# Findings that say or hint that something touches the gel
TOUCH = ("background_touched",)
# px, and gray levels by which a block of a frame at rest moves at most: the codec's steps are under 4
BLOCK, STILL = 8, 5.0
PER_CLIP = 4
HIGH_MM = 0.05


def rest(run: Run) -> dict[str, Any]:
    """Backgrounds at rest given to the starter of their make; then frames at rest on them."""
    return {**_backgrounds(run), **_frames(run)}


def _backgrounds(run: Run) -> dict[str, Row]:
    given: dict[str, list[Any]] = {}
    for name in MAKES:
        made = starter_without(run, name)
        given[name] = [said_of(made.for_frame, background(run, name), mm_per_px=pitch_of(name))]
    shipped = load_starter(MINI)
    for one in clips(run):
        given.setdefault(one.crop, []).append(said_of(shipped.for_frame, one.background))
    rows = {}
    for name, said in given.items():
        rows[f"{name}, refused"] = row(no=[why is not None for why, _ in said])
        figures = [found[key] for _, found in said for key in TOUCH if key in found]
        called = [any(key in found for key in TOUCH) for _, found in said]
        rows[f"{name}, called touched"] = row(no=called, figures=figures)
    return shown("background at rest", rows)


def _frames(run: Run) -> dict[str, Row]:
    """Frames of the first second of each clip that do not move, with the starter on the clip's beginning."""
    results: dict[str, list[Any]] = {}
    for one in clips(run):
        reconstruct = gelform.Reconstructor(unit_of(load_starter(MINI), one.background))
        still = [image for image in one.frames[BEGINNING:SECOND] if is_still(image, one.background)]
        for image in still[:: max(1, len(still) // PER_CLIP)]:
            results.setdefault(one.crop, []).append(_judged(reconstruct, image))
    rows = {}
    for name, found in results.items():
        contact, depth, sigma, doubt = (list(column) for column in zip(*found))
        rows[f"{name}, contact"] = row(no=contact) | _depths(depth, sigma)
        high = [mm > HIGH_MM and not said for mm, said in zip(depth, doubt)]
        rows[f"{name}, high"] = row(no=high)
        rows[f"{name}, a finding beside the calibration's"] = row(no=doubt)
    return shown("frame at rest", rows)


def is_still(image: np.ndarray, at_rest: np.ndarray) -> bool:
    """Whether no block of an image differs from the gel at rest by more than a codec's steps."""
    change = image.astype(np.float32) - at_rest
    height, width = (n // BLOCK * BLOCK for n in change.shape[:2])
    blocks = change[:height, :width].reshape(height // BLOCK, BLOCK, width // BLOCK, BLOCK, 3)
    return float(np.abs(blocks.mean(axis=(1, 3))).max()) < STILL


def _judged(reconstruct: gelform.Reconstructor, image: np.ndarray) -> tuple[bool, float, float, bool]:
    result = reconstruct.from_image(image)
    assert result.depth_sigma_mm is not None
    at = np.unravel_index(int(np.where(result.known, result.depth_mm, -np.inf).argmax()), result.shape)
    own_findings = {one.name for one in reconstruct.findings}
    doubt = bool({one.name for one in result.health} - own_findings)
    return bool(result.contacts), float(result.depth_mm[at]), float(result.depth_sigma_mm[at]), doubt


def _depths(depth: list[float], sigma: list[float]) -> dict[str, float]:
    """Highest depth of the frames at rest: median, 95 %, and the worst with its sigma."""
    worst = int(np.argmax(depth))
    return {
        "highest, median mm": float(np.median(depth)),
        "highest, 95 % mm": float(np.quantile(depth, 0.95)),
        "worst mm": depth[worst],
        "its sigma mm": sigma[worst],
    }


def moments(run: Run) -> dict[str, Row]:
    """Another moment at rest of the same unit as today's background: refused, or called touched."""
    given: dict[str, list[Any]] = {}
    of_crop: dict[str, list[np.ndarray]] = {}
    for one in clips(run):
        of_crop.setdefault(one.crop, []).append(one.background)
    for name, images in of_crop.items():
        for first, second in pairwise(images):
            calibration = unit_of(load_starter(MINI), first)
            given.setdefault(name, []).append(today(calibration, second))
    rests = list(wedge_rests().values())
    given["force-wedge"] = [today(own(run, "force-wedge"), image) for image in run.some(rests)]
    rows = {}
    for name, said in given.items():
        rows[f"{name}, refused"] = row(no=[why is not None for why, _ in said])
        for key in ("background_touched", "background_pattern"):
            figures = [found[key] for _, found in said if key in found]
            rows[f"{name}, {key}"] = row(no=[key in found for _, found in said], figures=figures)
    return shown("another moment at rest", rows)


def today(calibration: gelform.Calibration, image: np.ndarray) -> Said:
    """Why today's background was refused, or None; and the findings that the calibration alone does not have."""
    why, found = said_of(gelform.Reconstructor, calibration, background=image)
    known = {one.name: one.figure for one in calibration.findings}
    return why, {name: figure for name, figure in found.items() if known.get(name) != figure}
