"""One surface of several contacts: the slopes and depths of all, in the frame of the first, solved as one."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.depth.integrate import integrate
from gelform.errors import GelformError
from gelform.foundations.checks import check_list
from gelform.foundations.fill import fill_unknown
from gelform.motion.between import Motion, sensor_of
from gelform.motion.rigid import Array, checked_pose, moved
from gelform.motion.surface import LARGEST_SIGMA, TouchedSurface
from gelform.motion.track import Tracked
from gelform.result import Reconstruction
from gelform.slopes.gradients import slopes_of_solution

DEPTH_SHARE = 1e-3  # weight of the mean depth beside the slopes, which know the shape better
BLENDED_PX = 20.0  # px from its border, over which a contact gains its weight
MOST_SIDE = 4000  # px, of a mosaic
STEPS = 5  # until the place in a contact that a pixel shows is known to a fraction of a pixel
SURE = 0.5  # share of a pixel that must be touched
TINY = 1e-12  # weight where nothing is known
Placed = tuple[TouchedSurface, Array, Array, Array]  # with its pose, covariance and center


def mosaic(
    results: Sequence[Reconstruction], poses: Sequence[Motion | Tracked | ArrayLike]
) -> Reconstruction:
    """The surface that several results of one object show together, as a result of its own.

    Minimizes `sum W |grad z - g|^2 + 1e-3 sum w (z - mean z)^2` over what all contacts show: g are their slopes and z their
    depths, moved back to the first frame, W and w the inverse variances, less toward the border of a contact.

    Parameters
    ----------
    results : (H, W) each, of one sensor, with a scale
    poses : of each result, from the first frame to it: from `track` or `motion_between`, or (4, 4). Lost ones are left out

    Returns
    -------
    Reconstruction
        Its middle is that of the first frame, its pixels are as large. `known` and `contact` are where a contact was;
        `depth_sigma_mm` has the depths' sigma and the poses' covariance.

    Raises
    ------
    ValueError, TypeError, GelformError
        Not one pose for each result; results of different sensors or without a scale; none with a contact and a pose; a
        surface wider than 4000 px.
    """
    check_list(results, "results", Reconstruction)
    check_list(poses, "poses")
    if len(results) != len(poses):
        raise ValueError(f"Expected one pose for each result, got {len(results)} and {len(poses)}.")
    if len({sensor_of(one) for one in results}) > 1:
        raise ValueError("Expected results of one sensor and calibration, got several.")
    seen = placed(results, poses)
    if not seen:
        raise GelformError("No result has both a contact and a pose, so there is no surface.")
    shape, pitch = shape_of(seen), seen[0][0].pitch
    totals = sum((layer_of(*one, shape) for one in seen), np.zeros((6, *shape)))
    *slopes_and_depth, slope_weight, depth_weight, share = totals
    known_px = np.asarray(share > 0)
    slope_weight, depth_weight = np.maximum(slope_weight, TINY), np.maximum(depth_weight, TINY)
    slopes = np.dstack(slopes_and_depth[:2]) / slope_weight[..., None]
    # Filled beyond the border, or its slopes there would be of a step down to 0.
    mean = fill_unknown(np.asarray(slopes_and_depth[2] / depth_weight, np.float32)[..., None], known_px)[
        ..., 0
    ]
    weight = slope_weight / slope_weight.max()
    # The anchor holds at 0: what is solved for is the difference from the mean depth.
    solution = integrate(
        slopes - slopes_of_solution(mean, (pitch[0], pitch[1])), mm_per_px=tuple(pitch), weights=weight, mask=known_px,
        anchor=np.where(known_px, DEPTH_SHARE * depth_weight * pitch.prod() / slope_weight.max(), 0),
    )  # fmt: skip
    depth = np.where(known_px, mean + solution.depth_mm, 0).astype(np.float32)
    # Errors of depth are much alike in all contacts, so several are no surer than one.
    sigma = np.where(known_px, np.sqrt(share / depth_weight), LARGEST_SIGMA).astype(np.float32)
    slope_sigma = np.where(known_px, 1 / np.sqrt(slope_weight), LARGEST_SIGMA).astype(np.float32)
    return Reconstruction(
        depth=depth, depth_sigma_mm=sigma, gradients=slopes_of_solution(depth, (pitch[0], pitch[1])),
        gradients_sigma=np.stack([slope_sigma, slope_sigma], axis=-1), confidence=weight.astype(np.float32) * known_px,
        contact=known_px, known=known_px, mm_per_px=results[0].mm_per_px, mm_per_px_sigma=results[0].mm_per_px_sigma,
        solver=solution.solver, curl_rms=solution.curl_rms, calibration_digest=results[0].calibration_digest,
    )  # fmt: skip


def placed(results: Sequence[Reconstruction], poses: Sequence[Motion | Tracked | ArrayLike]) -> list[Placed]:
    """The surfaces of the results with a contact and a pose; a matrix alone is sure."""
    found = []
    for surface, one in zip(map(TouchedSurface, results), poses):
        if not surface.count:
            continue
        motion = one.motion if isinstance(one, Tracked) else one
        if not isinstance(motion, Motion):
            found.append((surface, checked_pose(motion, "a pose"), np.zeros((6, 6)), surface.middle))
        elif motion.pose is not None and motion.covariance is not None and motion.center_mm is not None:
            found.append((surface, motion.pose, motion.covariance, motion.center_mm))
    return found


def shape_of(seen: Sequence[Placed]) -> tuple[int, int]:
    """The size (H, W) about the first frame's middle that holds all contacts, odd or even as the first frame's."""
    reach = [
        np.abs(moved(np.linalg.inv(pose), one.points)[:, :2] / one.pitch).max(axis=0)
        for one, pose, *_ in seen
    ]
    across, down = np.ceil(np.max(reach, axis=0)).astype(int).tolist()
    first = seen[0][0].shape
    height, width = 2 * down + 2 + first[0] % 2, 2 * across + 2 + first[1] % 2
    if max(height, width) > MOST_SIDE:
        raise ValueError(
            f"Expected a surface of at most {MOST_SIDE} px a side, got {height}x{width}: are the poses in mm?"
        )
    return height, width


def layer_of(
    surface: TouchedSurface, pose: Array, covariance: Array, center: Array, shape: tuple[int, int]
) -> Array:
    """A contact in the frame of the first: what each pixel (H, W) adds to sums, from the place that was there.

    Both slopes and the depth, weighted; their weights; the share (0-1) of what the contact weighs in its middle.
    """
    height, width = shape
    back, turn = np.linalg.inv(pose), pose[:3, :3]
    row, col = np.mgrid[:height, :width]
    place = np.stack([col - (width - 1) / 2, row - (height - 1) / 2], axis=-1) * surface.pitch
    there = moved(pose, np.dstack([place, np.full(shape, surface.middle[2])]))  # in the contact's frame
    for _ in range(STEPS):
        pixel = surface.pixels_at(there)
        there[..., 2] = _sampled(surface.depth, pixel)
        there[..., :2] += (place - moved(back, there)[..., :2]) @ turn[:2, :2].T
    slopes, variances = (
        _sampled(surface.gradients, pixel),
        _sampled(surface.variances, pixel).astype(np.float64),
    )
    touched = cv2.copyMakeBorder(surface.contact.view(np.uint8), 1, 1, 1, 1, cv2.BORDER_CONSTANT, value=0)
    inward_px = _sampled(cv2.distanceTransform(touched, cv2.DIST_L2, 3)[1:-1, 1:-1], pixel)
    share = np.where(inward_px > SURE, np.minimum(inward_px / BLENDED_PX, 1), 0)
    of_depth = variances[..., 2] + _pose_variance(there - center, slopes, covariance)
    normal = np.dstack([-slopes, np.ones(shape)]) @ turn  # turned back
    slope_weight = 2 * share / np.maximum(variances[..., 0] + variances[..., 1], TINY)
    depth_weight = share / np.maximum(of_depth, TINY)
    values = np.dstack([-normal[..., :2] / normal[..., 2:], moved(back, there)[..., 2]])
    weighted = values * np.dstack([slope_weight, slope_weight, depth_weight])
    return np.stack([*np.moveaxis(weighted, -1, 0), slope_weight, depth_weight, share])


def _pose_variance(away: Array, slopes: NDArray[np.float32], covariance: Array) -> Array:
    """Variance (H, W) of the depth by an error of the pose about a point that is `away` (H, W, 3), mm^2."""
    normal = np.dstack([-slopes, np.ones(slopes.shape[:2])])
    change = np.concatenate([normal, np.cross(away, normal)], axis=-1)
    return np.asarray(np.einsum("...i,ij,...j->...", change, covariance, change), dtype=np.float64)


def _sampled(values: NDArray[np.float32], pixel: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values (h, w) or (h, w, n) at places (H, W, 2), px, between pixels; 0 outside."""
    return np.asarray(cv2.remap(values, pixel, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))
