"""The covariance of a pose: its parts, and that it lies in the seen directions alone."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.motion.covariance import pose_covariance
from gelform.motion.rigid import step_of_pose
from gelform.motion.surface import TouchedSurface
from made.rigid_contacts import SHAPE, contact_of, pose, texture

pytestmark = pytest.mark.linear_algebra


@pytest.fixture(scope="module")
def fitted():
    first, second = (
        TouchedSurface(contact_of(texture(), one, seed=k)) for k, one in enumerate((None, pose(0.2)))
    )
    return first, first.equations(second, pose(0.2))


def covariance_of(first, at, mm, directions=6):
    seen = np.eye(6)[:, :directions]
    inverse = seen @ np.linalg.inv(seen.T @ at.information @ seen) @ seen.T
    return pose_covariance(first, at, inverse, mm)


def test_the_place_adds_to_x_and_y_and_to_turns_over_the_contact(fitted):
    plain, placed = (covariance_of(*fitted, mm) for mm in (0.0, 0.1))
    away = fitted[0].points - fitted[0].middle
    turns = 0.01 * np.square([0.25, 0.25, 0.7]) / np.mean(np.sum(np.square(away), axis=1))
    np.testing.assert_allclose(placed - plain, np.diag([0.01, 0.01, 0, *turns]), rtol=1e-5, atol=1e-12)
    assert (np.linalg.eigvalsh(plain) > 0).all()


def test_what_all_slopes_have_in_common(fitted):
    """Without other errors the covariance is that of slopes off by 0.003, and too steep by 2 %, along each axis."""
    first, at = fitted
    wanted = np.zeros((6, 6))
    for axis in (0, 1):
        for error in (0.003, 0.02 * first.slopes[:, axis]):
            wrong = np.zeros_like(at.residual)
            wrong[:, axis] = error
            right = np.einsum("nki,nk,nk->i", at.jacobian, at.weight, wrong)
            by = np.linalg.solve(at.information, right)
            wanted += np.outer(by, by)
    sure = replace(at, residual=np.zeros_like(at.residual))
    np.testing.assert_allclose(covariance_of(first, sure, 0.0), wanted, rtol=1e-3, atol=1e-12)


def test_unseen_directions_have_no_variance(fitted):
    covariance = covariance_of(*fitted, 0.0, directions=5)
    assert np.abs(covariance[5]).max() < 1e-12
    assert covariance[0, 0] > 0


@pytest.mark.parametrize("shift", [(0.08, 0), (0, -0.12), (0.06, 0.06)])
def test_what_stays_at_its_place_pulls_the_object_back(shift):
    """The same errors in both frames match best without a motion, so residuals do not show them; the covariance does."""
    rng = np.random.default_rng(3)
    noise = [cv2.GaussianBlur(rng.normal(size=(*SHAPE, 2)), (0, 0), 3) for _ in range(3)]
    staying, *changing = (0.01 * one / one.std() for one in noise)
    contacts = [contact_of(lambda x, y: 0.1 * texture(1)(x, y), one) for one in (None, pose(*shift))]
    first, second = (
        replace(one, gradients=(one.gradients + staying + 0.7 * errors).astype(np.float32))
        for one, errors in zip(contacts, changing)
    )
    found = gelform.motion_between(first, second, place_error=0.0)
    direction = np.array(shift) / np.linalg.norm(shift)
    off = step_of_pose(found.pose @ np.linalg.inv(pose(*shift)), found.center_mm)[:2] @ direction
    assert off < -0.005, "drawn back"
    assert 0.5 < -off / np.sqrt(direction @ found.covariance[:2, :2] @ direction) < 2
