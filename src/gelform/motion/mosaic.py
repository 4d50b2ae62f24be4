"""One surface of several contacts: the slopes and depths of all, in the frame of the first, solved as one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from gelform.depth.integrate import integrate
from gelform.errors import GelformError
from gelform.foundations.checks import check_list
from gelform.foundations.fill import fill_unknown
from gelform.motion.between import Motion, sensor_of
from gelform.motion.rigid import Array, checked_pose, inverse_of, moved
from gelform.motion.surface import LARGEST_SIGMA, TouchedSurface
from gelform.motion.track import Tracked
from gelform.result import Reconstruction
from gelform.slopes.gradients import slopes_of_solution

DEPTH_SHARE = 1e-3  # weight of the mean depth beside the slopes, which know the shape better
MOST_SIDE = 4000  # px, of a mosaic
STEPS = 4  # until the place in a contact that a pixel shows is known to a fraction of a pixel
SURE = 0.5  # share of a pixel that must be touched
TINY = 1e-12  # weight where nothing is known


class Layer(NamedTuple):
    """What one result shows of the surface (H, W): slopes, depth, and the variances of both, infinite where nothing."""

    gradients: Array
    depth: Array
    variances: Array


def mosaic(
    results: Sequence[Reconstruction], poses: Sequence[Motion | Tracked | ArrayLike]
) -> Reconstruction:
    """The surface that several results of one object show together, as a result of its own.

    Minimizes `sum W |grad z - g|^2 + 1e-3 sum w (z - mean z)^2` over what all contacts show: g are their slopes and z their
    depths, moved back to the first frame, W and w the inverse variances.

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
    motions = [one.motion if isinstance(one, Tracked) else one for one in check_list(poses, "poses")]
    if len(results) != len(motions):
        raise ValueError(f"Expected one pose for each result, got {len(results)} and {len(motions)}.")
    if len({sensor_of(one) for one in results}) > 1:
        raise ValueError("Expected results of one sensor and calibration, got several.")
    seen: list[tuple[TouchedSurface, Array, Motion | None]] = []
    for result, motion in zip(results, motions):
        surface = TouchedSurface(result)
        pose = checked_pose(motion, "a pose") if not isinstance(motion, Motion) else motion.pose
        if pose is not None and surface.count:
            seen.append((surface, pose, motion if isinstance(motion, Motion) else None))
    if not seen:
        raise GelformError("No result has both a contact and a pose, so there is no surface.")
    shape, pitch = shape_of(seen), seen[0][0].pitch
    layers = [layer_of(*one, shape) for one in seen]
    # Variances add up in the layers, and their inverses over the layers.
    of_slope, of_depth = (np.stack([1 / layer.variances[..., k] for layer in layers]) for k in (0, 1))
    known_px = np.asarray(of_depth.sum(axis=0) > 0)
    slope_weight, depth_weight = (np.maximum(of.sum(axis=0), TINY) for of in (of_slope, of_depth))
    slopes = (
        sum(w[..., None] * layer.gradients for w, layer in zip(of_slope, layers)) / slope_weight[..., None]
    )
    total = sum(w * layer.depth for w, layer in zip(of_depth, layers))
    # Filled beyond the border, or its slopes there would be of a step down to 0.
    mean = fill_unknown(np.asarray(total / depth_weight, np.float32)[..., None], known_px)[..., 0]
    weight = slope_weight / slope_weight.max()
    # The anchor holds at 0: what is solved for is the difference from the mean depth.
    solution = integrate(
        slopes - slopes_of_solution(mean, (pitch[0], pitch[1])), mm_per_px=tuple(pitch), weights=weight, mask=known_px,
        anchor=np.where(known_px, DEPTH_SHARE * depth_weight * pitch.prod() / slope_weight.max(), 0),
    )  # fmt: skip
    depth = np.where(known_px, mean + solution.depth_mm, 0).astype(np.float32)
    # Errors of depth are much alike in all contacts, so several are no surer than one.
    count = np.count_nonzero(of_depth, axis=0)
    sigma = np.where(known_px, np.sqrt(count / depth_weight), LARGEST_SIGMA).astype(np.float32)
    slope_sigma = np.where(known_px, 1 / np.sqrt(slope_weight), LARGEST_SIGMA).astype(np.float32)
    return Reconstruction(
        depth=depth, depth_sigma_mm=sigma, gradients=slopes_of_solution(depth, (pitch[0], pitch[1])),
        gradients_sigma=np.stack([slope_sigma, slope_sigma], axis=-1), confidence=weight.astype(np.float32) * known_px,
        contact=known_px, known=known_px, mm_per_px=results[0].mm_per_px, mm_per_px_sigma=results[0].mm_per_px_sigma,
        solver=solution.solver, curl_rms=solution.curl_rms, calibration_digest=results[0].calibration_digest,
    )  # fmt: skip


def shape_of(seen: Sequence[tuple[TouchedSurface, Array, Motion | None]]) -> tuple[int, int]:
    """The size (H, W) about the first frame's middle that holds all contacts, odd or even as the first frame's."""
    reach = [
        np.abs(moved(inverse_of(pose), one.points)[:, :2] / one.pitch).max(axis=0) for one, pose, _ in seen
    ]
    across, down = np.ceil(np.max(reach, axis=0)).astype(int).tolist()
    first = seen[0][0].shape
    height, width = 2 * down + 2 + first[0] % 2, 2 * across + 2 + first[1] % 2
    if max(height, width) > MOST_SIDE:
        raise ValueError(
            f"Expected a surface of at most {MOST_SIDE} px a side, got {height}x{width}: are the poses in mm?"
        )
    return height, width


def layer_of(surface: TouchedSurface, pose: Array, motion: Motion | None, shape: tuple[int, int]) -> Layer:
    """A contact in the frame of the first: for each pixel, the place in the contact that was there."""
    height, width = shape
    back, turn, pitch = inverse_of(pose), pose[:3, :3], surface.pitch
    row, col = np.mgrid[:height, :width]
    place = np.stack([col - (width - 1) / 2, row - (height - 1) / 2], axis=-1) * pitch
    depth = np.full(shape, float(surface.points[:, 2].mean()))
    there = moved(pose, np.dstack([place, depth]))  # in the contact's frame
    for _ in range(STEPS):
        pixel = surface.pixels_at(there)
        there[..., 2] = _sampled(surface.depth, pixel)
        off = place - moved(back, there)[..., :2]
        there[..., :2] += off @ turn[:2, :2].T
    pixel = surface.pixels_at(there)
    there[..., 2] = _sampled(surface.depth, pixel)
    slopes, variances = (
        _sampled(surface.gradients, pixel),
        _sampled(surface.variances, pixel).astype(np.float64),
    )
    missing = _sampled(surface.contact.astype(np.float32), pixel) <= SURE
    if motion is not None and motion.covariance is not None and motion.center_mm is not None:
        variances[..., 1] += _pose_variance(there - motion.center_mm, slopes, motion.covariance)
    normal = np.dstack([-slopes, np.ones(shape)]) @ turn  # turned back
    variances[missing] = np.inf
    return Layer(-normal[..., :2] / normal[..., 2:], moved(back, there)[..., 2], variances)


def _pose_variance(away: Array, slopes: NDArray[np.float32], covariance: Array) -> Array:
    """Variance (H, W) of the depth by an error of the pose about a point that is `away` (H, W, 3), mm^2."""
    normal = np.dstack([-slopes, np.ones(slopes.shape[:2])])
    change = np.concatenate([normal, np.cross(away, normal)], axis=-1)
    return np.asarray(np.einsum("...i,ij,...j->...", change, covariance, change), dtype=np.float64)


def _sampled(values: NDArray[np.float32], pixel: NDArray[np.float32]) -> NDArray[np.float32]:
    """Values (h, w) or (h, w, 2) at places (H, W, 2), px, between pixels; 0 outside."""
    return np.asarray(cv2.remap(values, pixel, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT))
