"""Rigid motions as matrices and as steps about a center. The equations of a small motion: the kernel against numpy, and
the derivatives against differences.
"""

import numpy as np
import pytest

import gelform
from gelform.motion import surface
from gelform.motion.surface import (
    TouchedSurface,
    about_other_center,
    checked_pose,
    moved,
    pose_of_step,
    step_of_pose,
    turn_deg,
)
from kernel_agreement import assert_kernel_agrees
from made.rigid_contacts import MM_PER_PX, contact_of, pose, texture

STEP = np.array([0.2, -0.1, 0.05, 0.03, -0.06, 0.12])
CENTER = np.array([1.0, -2.0, 0.5])


def test_a_step_and_its_pose():
    pose = pose_of_step(STEP, CENTER)
    np.testing.assert_allclose(step_of_pose(pose, CENTER), STEP, atol=1e-12)
    np.testing.assert_allclose(moved(pose, CENTER), CENTER + STEP[:3])
    assert turn_deg(pose) == pytest.approx(np.degrees(np.linalg.norm(STEP[3:])))
    offset, small = np.array([0.7, -0.3, 1.1]), 1e-5 * STEP  # about another center it is the same motion
    same = pose_of_step(about_other_center(offset) @ small, CENTER + offset)
    np.testing.assert_allclose(same, pose_of_step(small, CENTER), atol=1e-9)


def test_turns_lead_from_x_to_y_to_z():
    for k, (first, then) in enumerate(((1, 2), (2, 0), (0, 1))):
        step = np.zeros(6)
        step[3 + k] = 0.1
        axis = np.eye(3)[first]
        assert moved(pose_of_step(step, np.zeros(3)), axis)[then] == pytest.approx(np.sin(0.1))


@pytest.mark.parametrize(
    "wrong", [np.eye(3), 2 * np.eye(4), np.diag([1.0, 1, -1, 1]), np.eye(4) + np.eye(4, k=-1)]
)
def test_what_is_no_rigid_motion_is_refused(wrong):
    with pytest.raises(ValueError, match="rigid motion"):
        checked_pose(wrong, "start")


@pytest.fixture(scope="module")
def surfaces():
    moved = contact_of(texture(), pose(0.2, -0.1, 0.02, 1, -1, 3), seed=2)
    return TouchedSurface(contact_of(texture(), seed=1)), TouchedSurface(moved)


def between(values, x, y):
    """Bilinear interpolation at places inside the map."""
    row, col = (np.minimum(v.astype(int), size - 2) for v, size in zip((y, x), values.shape))
    a, b = (v.reshape(-1, *(1,) * (values.ndim - 2)) for v in (x - col, y - row))
    top = values[row, col] * (1 - a) + values[row, col + 1] * a
    return top * (1 - b) + b * (values[row + 1, col] * (1 - a) + values[row + 1, col + 1] * a)


def reference(
    points, slopes, variance, gradients, depth, along_x, along_y, variances, contact, inner, pose, center, pitch,
    origin, huber, residual, jacobian, weight, inside, normal,
):  # fmt: skip
    """The rows in double precision, one formula for all points."""
    turn, shift = pose[:, :3], pose[:, 3]
    q = points.astype(float) @ turn.T + shift
    n = np.column_stack([-slopes, np.ones(len(points))]).astype(float) @ turn.T
    x, y = (q[:, :2] / pitch + origin).T
    height, width = depth.shape
    there = (x >= 0) & (y >= 0) & (x <= width - 1) & (y <= height - 1)
    x, y = np.where(there, x, 0), np.where(there, y, 0)
    there &= (between(contact.astype(float), x, y) > 0.5) & (n[:, 2] > 0.2 * np.linalg.norm(n, axis=1))
    g, z = between(gradients.astype(float), x, y), between(depth.astype(float), x, y)
    change = np.stack([between(one.astype(float), x, y) for one in (along_x, along_y)], axis=2)
    basis = np.eye(3)
    shifts = [np.broadcast_to(e, q.shape) for e in basis]
    moves = np.stack([*shifts, *(np.cross(e, q - center) for e in basis)], 2)
    turns = np.stack([np.zeros_like(n)] * 3 + [np.cross(e, n) for e in basis], 2)
    slope = -n[:, :2] / n[:, 2:]
    of_normal = -(turns[:, :2] + slope[..., None] * turns[:, 2:]) / n[:, 2, None, None]
    of_depth = np.einsum("ni,nij->nj", g, moves[:, :2])[:, None] - moves[:, 2:]
    rows = np.concatenate([change @ moves[:, :2] - of_normal, of_depth], 1)
    residual = np.column_stack([g - slope, z - q[:, 2]])
    both = variance + between(variances.astype(float), x, y)
    weight = 1 / both
    there_too = there[:, None]
    rows, residual, weight = rows * there_too[..., None], residual * there_too, weight * there_too
    off = np.sqrt(weight) * np.abs(residual)
    most = huber * np.sqrt(np.sum(off**2) / (3 * there.sum()))
    weight = weight * np.where(off > most, most / np.maximum(off, 1e-12), 1)
    information = np.einsum("nki,nk,nkj->ij", rows, weight, rows)
    right = -np.einsum("nki,nk,nk->i", rows, weight, residual)
    inside = there & inner[np.floor(y + 0.5).astype(int), np.floor(x + 0.5).astype(int)]
    return residual, rows, weight, inside, np.column_stack([information, right])


def test_the_kernel_is_the_written_method(surfaces):
    first, second = surfaces
    motion = pose(0.25, -0.05, 0.02, 1, -2, 2)[:3]
    n = len(first.points)
    assert_kernel_agrees(
        surface._motion_rows, reference, first.points, first.slopes, first.point_variances, second.gradients,
        second.depth, *second.derivatives, second.variances, second.contact, second.inner, motion.copy(),
        np.array([0.2, 0.1, 0.5]), second.pitch, second.origin, 2.0, np.zeros((n, 3), np.float32),
        np.zeros((n, 3, 6), np.float32), np.zeros((n, 3), np.float32), np.zeros(n, bool), np.zeros((6, 7)), tolerance=2e-4,
    )  # fmt: skip


def test_the_jacobian_is_the_change_of_the_residuals():
    """For each of the six steps, on a surface without errors."""
    first = TouchedSurface(contact_of(texture()))
    second = TouchedSurface(contact_of(texture(), pose(0.1, 0.05)))
    begin = pose(0.1, 0.05)
    at = first.equations(second, begin)
    for k in range(6):
        step = np.zeros(6)
        step[k] = 0.02
        after, before = (first.equations(second, pose_of_step(s * step, at.center) @ begin) for s in (1, -1))
        inner = at.shared & after.shared & before.shared & first.own.inside
        change = (after.residual - before.residual)[inner] / (2 * step[k])
        wanted = at.jacobian[inner, :, k]
        left = np.sqrt(np.mean(np.square(change - wanted), axis=0)) / np.sqrt(np.mean(np.square(change)))
        assert left.max() < 0.12, f"{k}: {left}"


def test_points_are_in_millimeters_from_the_middle(surfaces):
    first, _ = surfaces
    row, col = first.pixels[7]
    x, y = (np.array([col, row]) - first.origin) * MM_PER_PX
    np.testing.assert_allclose(first.points[7, :2], (x, y), atol=1e-6)
    np.testing.assert_allclose(first.points[:, :2].mean(axis=0), 0, atol=0.02)  # the contact is in the middle
    assert first.points[7, 2] == first.depth[row, col]


def test_gaps_between_the_tops_of_a_texture_belong_to_the_contact():
    result = contact_of(texture())
    holes = result.contact.copy()
    holes[::5, ::5] = False
    assert TouchedSurface(contact_of(texture(), contact=holes)).count > TouchedSurface(result).count - 10
    assert holes.sum() < result.contact.sum() - 150
    unknown = ~((np.indices(result.shape) % 5 == 0).all(axis=0))
    assert TouchedSurface(contact_of(texture(), known=unknown)).count < TouchedSurface(result).count


def test_a_result_without_a_scale_has_no_motion():
    with pytest.raises(gelform.GelformError, match="no scale"):
        TouchedSurface(contact_of(texture(), mm_per_px=None))
