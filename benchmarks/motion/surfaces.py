"""A simulated plate under eight presses as one surface: steps at its seams, and truth within sigma."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.ndimage import map_coordinates

import gelform
from gelform.motion.track import layer_of, placed, shape_of
from gelform.simulate import HeightMap, Pose, simulate_pose
from motion.judged import pose_at, two, within
from motion.shapes import simulated_sensor

PRESSES, APART_MM = 8, 1.5
RELIEF_MM_PER_PX = 0.05
SEAM_PX = 2  # px on each side of a seam


def surface(quick: bool) -> dict[str, Any]:
    """Steps of the error across seams, median and 95 %, um, of the mosaic and of the mean of depths; RMS; within sigma."""
    sensor, calibration = simulated_sensor()
    reconstruct, rng = gelform.Reconstructor(calibration), np.random.default_rng(4)
    relief = plate()
    places = [((k - (PRESSES - 1) / 2) * APART_MM, 0.3 * (-1) ** k) for k in range(PRESSES)]
    presses = [
        simulate_pose(sensor, relief, Pose(0.45, place), rng=rng, oversample=1)
        for place in places[: 3 if quick else PRESSES]
    ]
    results = [reconstruct.from_image(press.image) for press in presses]
    f, motions = calibration.settings.place_error, [gelform.motion_between(results[0], results[0])]
    for a, b, one, other in zip(results, results[1:], places, places[1:]):
        start = pose_at(*np.subtract(other, one) + rng.normal(0, 0.1, 2), 0, 0, np.zeros(3))
        motions.append(gelform.motion_between(a, b, start=start, place_error=f))
    path = chained(motions)
    whole = gelform.mosaic(results, path)
    seen = placed(results, path)
    layers = np.stack([layer_of(*one, shape_of(seen)) for one in seen])
    share = layers[:, 5]
    there = share > 0
    # The baseline: the weighted mean, which does not know where a contact ends.
    depths, weights = (
        np.sum(np.where(there, layers[:, k] / np.maximum(share, 1e-12), 0), axis=0) for k in (2, 4)
    )
    mean = depths / np.maximum(weights, 1e-12)
    true = true_depth(relief, whole, places[0], presses[0])
    figures = {"presses": len(seen), "pixels": int(whole.known.sum())}
    for name, depth in (("mosaic", whole.depth_mm), ("mean", mean)):
        error = depth - true
        error = error - np.median(error[whole.known])
        figures[name] = {
            "seams_um": two(steps(error, there), 1e3), "rms_um": 1e3 * float(np.std(error[whole.known])),
            "within": within((error / whole.depth_sigma_mm)[whole.known]),
        }  # fmt: skip
    return figures


def chained(motions: list[Any]) -> list[Any]:
    """Motions from the first frame, of motions from each frame to the next."""
    from gelform.motion.track import after

    path = [motions[0]]
    for motion in motions[1:]:
        path.append(motion if motion.pose is None or path[-1].pose is None else after(path[-1], motion))
    return path


def plate() -> HeightMap:
    """A long bar, 8 mm wide, with bumps some tens of micrometers high: beside it the gel is at rest."""
    rng = np.random.default_rng(7)
    y, x = (np.mgrid[:161, :961] - np.array([80, 480])[:, None, None]) * RELIEF_MM_PER_PX
    waves = rng.uniform(0.8, 2.5, (12, 2)) * rng.choice([-1, 1], (12, 2))
    bumps = sum(
        h * np.sin(a * x + b * y + p)
        for h, (a, b), p in zip(rng.uniform(0.01, 0.03, 12), waves, rng.uniform(0, 6, 12))
    )
    return HeightMap(bumps, RELIEF_MM_PER_PX)


def true_depth(relief: HeightMap, whole: Any, place: tuple[float, float], press: Any) -> np.ndarray:
    """The plate's depth in the mosaic's pixels, in the frame of the first press."""
    height, width = whole.shape
    row, col = np.mgrid[:height, :width]
    x = (col - (width - 1) / 2) * whole.mm_per_px - place[0]
    y = (row - (height - 1) / 2) * whole.mm_per_px - place[1]
    heights = np.asarray(relief.height_mm)
    at = [
        (y / RELIEF_MM_PER_PX + (heights.shape[0] - 1) / 2),
        (x / RELIEF_MM_PER_PX + (heights.shape[1] - 1) / 2),
    ]
    return map_coordinates(heights - heights.max(), at, order=3) + press.press_depth_mm


def steps(error: np.ndarray, there: np.ndarray) -> np.ndarray:
    """Differences of an error (H, W) across the seams along x: where another set of contacts (N, H, W) begins."""
    known = there.any(axis=0)
    changes = np.any(there[:, :, 1:] != there[:, :, :-1], axis=0) & known[:, 1:] & known[:, :-1]
    row, col = np.nonzero(changes)
    inside = (col >= SEAM_PX) & (col + 1 + SEAM_PX < error.shape[1])
    row, col = row[inside], col[inside]
    both = known[row, col - SEAM_PX + 1] & known[row, col + SEAM_PX]
    row, col = row[both], col[both]
    return error[row, col + SEAM_PX] - error[row, col - SEAM_PX + 1]
