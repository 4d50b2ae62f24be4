"""Rigid motions as matrices and as steps about a center. The equations of a small motion: the kernel against numpy, and
the derivatives against differences.

Known motions of known bodies: found within their covariance, blind directions named, nothing invented. The
covariance of a pose: its parts, and that it lies in the seen directions alone. Which directions are seen, and the words
for those that are not.
"""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.motion import between as surface
from gelform.motion.between import (
    FOUND,
    LOST,
    UNSURE,
    TouchedSurface,
    about_other_center,
    blind_directions,
    checked_pose,
    has_moved,
    moved,
    pose_covariance,
    pose_of_step,
    step_of_pose,
    turn_deg,
)
from kernel_agreement import assert_kernel_agrees
from made.rigid_contacts import (
    BALL_MM,
    DEPTH_MM,
    MM_PER_PX,
    SHAPE,
    ball,
    contact_of,
    cylinder,
    plate,
    pose,
    texture,
)
from made.rigid_contacts import CENTER as MIDDLE

pytestmark = pytest.mark.linear_algebra
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


# Shift in mm and turns in degrees: one direction each, and all together.
MOTIONS = {
    "x": {"x": 0.3}, "y": {"y": -0.3}, "deeper": {"x": 0.3, "z": 0.05}, "tilt about x": {"x": 0.3, "tilt_x": 2.0},
    "tilt about y": {"y": 0.3, "tilt_y": 2.0}, "yaw": {"x": 0.3, "yaw": 6.0},
    "all": {"x": -0.2, "y": 0.25, "z": -0.03, "tilt_x": -1.0, "tilt_y": 1.5, "yaw": -5.0},
}  # fmt: skip


def off_by(motion, true):
    """The step from the true motion to the found one, about the contact's middle."""
    return step_of_pose(motion.pose @ np.linalg.inv(true), motion.center_mm)


@pytest.mark.parametrize("name", MOTIONS)
def test_a_textured_plate_without_errors(name):
    true = pose(**MOTIONS[name])
    found = gelform.motion_between(contact_of(texture()), contact_of(texture(), true))
    assert found.state == FOUND, found.why
    assert found.blind == ()
    assert np.abs(off_by(found, true)[:3]).max() < 0.004
    assert np.degrees(np.abs(off_by(found, true)[3:]).max()) < 0.15


def test_turns_of_a_ball_are_blind_and_named():
    """The ball moves and turns; its center is found, its turn is not, and nobody claims it."""
    true = pose_of_step(np.array([0.3, 0.15, 0, 0.05, -0.05, 0.15]), MIDDLE - (0, 0, BALL_MM))
    found = gelform.motion_between(contact_of(ball, seed=1), contact_of(ball, true, seed=2))
    assert found.state == FOUND
    center = np.array([0, 0, DEPTH_MM - BALL_MM])
    assert len(found.blind) == 3
    for one in found.blind:
        assert one.words.startswith("turns about the ball's center")
        assert one.correlation < 0.71
        named = np.array([float(v) for v in one.words.split("(")[1].split(")")[0].split(",")])
        assert np.abs(named - moved(true, center)).max() < 0.25
    assert np.abs(moved(found.pose, center) - moved(true, center))[:2].max() < 0.03
    sigma = np.sqrt(np.diag(found.covariance))
    assert np.degrees(sigma[3:].min()) > 9, "nothing is known about turns"
    assert np.degrees(np.linalg.norm(step_of_pose(found.pose, found.center_mm)[3:])) < 0.5


def test_blind_directions_take_the_prior_alone():
    true = pose_of_step(np.array([0.3, 0.15, 0, 0, 0, 0.1]), MIDDLE - (0, 0, BALL_MM))
    start = pose_of_step(np.array([0.2, 0.1, 0, 0, 0, 0.1]), MIDDLE - (0, 0, BALL_MM))
    a, b = contact_of(ball, seed=1), contact_of(ball, true, seed=2)
    found = gelform.motion_between(a, b, start=start, prior=(1.0, 0.02))
    assert np.sqrt(found.covariance[5, 5]) == pytest.approx(0.02, rel=0.05)
    assert step_of_pose(found.pose, found.center_mm)[5] == pytest.approx(0.1, abs=0.005)


def test_a_sure_prior_is_kept():
    a, b = contact_of(texture(), seed=1), contact_of(texture(), pose(0.3), seed=2)
    found = gelform.motion_between(a, b, start=pose(0.2), prior=(1e-5, 1e-5))
    np.testing.assert_allclose(found.pose, pose(0.2), atol=1e-3)


def test_a_cylinder_shifts_and_turns_along_its_axis_unseen():
    true = pose(0.1, 0.3)
    found = gelform.motion_between(contact_of(cylinder, seed=1), contact_of(cylinder, true, seed=2))
    words = sorted(one.words for one in found.blind)
    assert words[0] == "shifts along x"
    assert words[1].startswith("turns about x through")
    assert len(words) == 2
    assert off_by(found, true)[1] == pytest.approx(0, abs=0.01)
    assert found.pose[0, 3] == pytest.approx(0, abs=0.05), "no motion along the axis is claimed"


def test_a_plate_shows_depth_and_tilts_alone():
    true = pose(0.3, 0.2, 0.05, 1.0, -0.5)
    found = gelform.motion_between(contact_of(plate, seed=1), contact_of(plate, true, seed=2))
    assert len(found.blind) == 3
    step = step_of_pose(found.pose, np.array([0.3, 0.2, DEPTH_MM + 0.05]))
    np.testing.assert_allclose(step[2:5], [0.05, *np.radians([1.0, -0.5])], atol=0.01)


def test_what_fills_the_view_has_no_depth():
    a, b = (contact_of(texture(), one, radius_mm=20, seed=3) for one in (None, pose(0.3, z=0.05)))
    found = gelform.motion_between(a, b)
    assert found.state == FOUND, found.why
    (blind,) = found.blind
    assert blind.words == "shifts along z: the contact fills the view, nothing is at rest"
    assert np.sqrt(found.covariance[2, 2]) > 9
    assert found.pose[0, 3] == pytest.approx(0.3, abs=0.01)


def column(x, y):
    """A ball whose contact is nearly one column."""
    return np.sqrt(np.maximum(BALL_MM**2 - x**2 - (y / 40) ** 2, 1e-9)) - BALL_MM - 3 * np.abs(x)


def touching(face, where):
    one = contact_of(face)
    contact = np.zeros(one.shape, bool)
    contact[where] = True
    return replace(one, contact=contact)


DOTS, FOUR_ROWS = np.s_[::4, ::4], np.s_[60:64]
DEGENERATE = {
    "a plate": lambda: (contact_of(plate), contact_of(plate, pose(0.3))),
    "a plate twice": lambda: [contact_of(plate)] * 2,
    "a texture twice": lambda: [contact_of(texture(), seed=1)] * 2,
    "a ball twice": lambda: [contact_of(ball)] * 2,
    "a cylinder": lambda: (contact_of(cylinder), contact_of(cylinder, pose(0.3))),
    "dots of one pixel": lambda: [touching(texture(), DOTS)] * 2,
    "dots on a plate": lambda: [touching(plate, DOTS)] * 2,
    "nearly one column": lambda: (contact_of(column), contact_of(column, pose(0.05))),
    "a line of a plate": lambda: [touching(plate, FOUR_ROWS)] * 2,
}


@pytest.mark.parametrize("name", DEGENERATE)
def test_the_covariance_is_definite_where_residuals_say_nothing(name):
    """So nobody who inverts it meets a singular matrix; rounding may not decide that."""
    found = gelform.motion_between(*DEGENERATE[name]())
    assert found.state == UNSURE, found.why
    assert np.isfinite(found.pose).all()
    np.testing.assert_allclose(found.covariance, found.covariance.T, rtol=1e-6, atol=1e-12)
    unit = 1 / np.sqrt(np.diag(found.covariance))
    assert np.linalg.eigvalsh(unit[:, None] * found.covariance * unit).min() > 1e-10


def test_unknown_sigmas_count_little():
    """NaN, infinity, or none at all."""
    first, second = contact_of(texture(), seed=1), contact_of(texture(), pose(0.3), seed=2)
    slopes, depth = first.gradients_sigma.copy(), first.depth_sigma_mm.copy()
    slopes[50:55], depth[60:65] = np.nan, np.inf
    for sigmas in ((slopes, depth), (None, None)):
        unsure = replace(first, gradients_sigma=sigmas[0], depth_sigma_mm=sigmas[1])
        assert gelform.motion_between(unsure, second).pose[0, 3] == pytest.approx(0.3, abs=0.01)


def test_without_a_start_the_middle_of_the_contact_leads():
    true = pose(1.3, -0.9, yaw=3.0)
    found = gelform.motion_between(contact_of(texture(), seed=1), contact_of(texture(), true, seed=2))
    assert found.state == FOUND, found.why
    assert np.abs(off_by(found, true)).max() < 0.02


def test_slopes_count_as_they_were_read():
    """The solved ones may have a crest at another place."""
    first, second = contact_of(texture(), seed=1), contact_of(texture(), pose(0.3), seed=2)
    solved = np.roll(second.gradients, 2, axis=1)
    second = replace(second, gradients=solved, observed_gradients=second.gradients)
    found = gelform.motion_between(first, second)
    assert found.pose[0, 3] == pytest.approx(0.3, abs=0.01)


def test_an_object_that_hardly_moved_cannot_be_told_from_a_blind_one():
    found = gelform.motion_between(contact_of(texture(), seed=1), contact_of(texture(), pose(0.05), seed=2))
    assert found.state == UNSURE
    assert found.pose[0, 3] == pytest.approx(0.05, abs=0.01)


def touch(motion=None, face=None, **how):
    """A contact of the sensor "a"."""
    return contact_of(face or texture(), motion, **{"calibration_digest": "a", **how})


# What came second, and about where it was expected.
REFUSED = {
    "another sensor": (touch(calibration_digest="b"), None),
    "out of order": (touch(time_s=0.5), None),
    "no contact": (touch(radius_mm=0.2), None),
    r"have \d+ % of the contact in common \(\d+ px\), and a motion needs 25 % and 256 px": (
        touch(pose(4.6), stays=True),
        pose(4.5),
    ),
    "from the start": (touch(pose(0.7)), np.eye(4)),
    "turned by 1[123]": (touch(pose(yaw=12)), pose(yaw=11)),
    "another object": (touch(face=lambda x, y: 0.6 * texture(5)(3 * x, 3 * y)), None),
}


@pytest.mark.parametrize("why", REFUSED)
def test_no_motion_is_invented(why):
    second, start = REFUSED[why]
    found = gelform.motion_between(touch(time_s=1.0, seed=1), second, start=start)
    assert found.state == LOST
    assert found.pose is found.covariance is found.center_mm is None
    assert re.search(why, found.why), found.why


def test_what_no_gel_shows_and_a_result_without_a_scale_are_refused():
    one = contact_of(plate)
    far = {name: getattr(one, name) + np.float32(1e18) for name in ("depth", "gradients")}
    beyond = (({name: values}, r"up to 1e\+06, got 1\.0e\+18 mm") for name, values in far.items())
    for changed, said in (*beyond, ({"mm_per_px": None}, "no scale")):
        with pytest.raises(gelform.GelformError, match=said):
            gelform.motion_between(replace(one, **changed), one)


def test_wrong_arguments_are_errors():
    priors = [{"prior": prior} for prior in [(0.1,), (0.1, 0), (1e-300, 0.1), (0.1, 1e9)]]
    for wrong in (*priors, {"start": np.zeros((4, 4))}, {"place_error": -1}):
        with pytest.raises(ValueError, match="Expected"):
            gelform.motion_between(touch(), touch(), **wrong)


def test_the_pose_is_that_of_the_simulator(sensor, calibration):
    """Axes and signs, through images: x to the right, y down, yaw clockwise in the image."""
    from gelform.simulate import HeightMap, Pose, simulate_pose

    rng = np.random.default_rng(0)
    y, x = (np.mgrid[:121, :121] - 60) * 0.05
    relief = HeightMap(texture(3)(0.6 * x, 0.6 * y) - 5 * (np.hypot(x, y) >= 2.6), 0.05)
    at = [Pose(0.5, (-0.3, 0.2)), Pose(0.5, (0.1, 0.0), spin_deg=4.0)]
    frames = (simulate_pose(sensor, relief, one, rng=rng, oversample=1).image for one in at)
    a, b = map(gelform.Reconstructor(calibration).from_image, frames)
    found = gelform.motion_between(a, b, start=pose(0.3, -0.1))
    assert found.state == FOUND, found.why
    np.testing.assert_allclose(moved(found.pose, [-0.3, 0.2, 0.4])[:2], (0.1, 0.0), atol=0.04)
    assert np.degrees(np.arctan2(found.pose[1, 0], found.pose[0, 0])) == pytest.approx(4.0, abs=0.8)


@pytest.fixture(scope="module")
def fitted():
    contacts = (contact_of(texture(), one, seed=k) for k, one in enumerate((None, pose(0.2))))
    first, second = map(TouchedSurface, contacts)
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
    unseen = covariance_of(*fitted, 0.0, directions=5)
    assert np.abs(unseen[5]).max() < 1e-12
    assert unseen[0, 0] > 0


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


def blind_of(face, seeds=(1, 2), **fields):
    poses = zip(seeds, (None, pose(0.3, 0.1)))
    first, second = (TouchedSurface(contact_of(face, one, seed=k, **fields)) for k, one in poses)
    return blind_directions(first, first.equations(second, pose(0.3, 0.1)))[:2]


@pytest.mark.slow
def test_all_turns_of_a_ball_are_blind_and_no_texture_is():
    values = [one.correlation for seed in range(8) for one in blind_of(ball, (seed, seed + 50))[0]]
    assert len(values) == 24
    assert not any(blind_of(texture(seed), (seed, seed + 50))[0] for seed in range(8))


def test_the_same_errors_in_both_frames_look_like_shape():
    """That is why an object has to move: the test could not tell otherwise."""
    first = TouchedSurface(contact_of(cylinder, seed=1))
    at = first.equations(first, np.eye(4))
    assert blind_directions(first, at)[0] == ()
    assert not has_moved(first, np.eye(4))
    assert has_moved(first, pose(0.3))
    assert has_moved(first, pose(yaw=-16)), "a turn moves what is away from its center"


def oval(x, y):
    """A lens with radii of 3 and 5 mm."""
    return -(x**2) / 6 - y**2 / 10


def test_shape_counts_from_the_error_that_slopes_may_carry():
    """An oval rolls unseen at most, unless its slopes may be as wrong as they would be of a ball."""
    assert not any("ball" in one.words or "about z" in one.words for one in blind_of(oval)[0])
    unsure = {"gradients_sigma": np.full((*SHAPE, 2), 0.15, np.float32)}
    found = [one.words for one in blind_of(oval, **unsure)[0]]
    assert len(found) == 3
    assert all(words.startswith("turns about the ball's center") for words in found)


def edge(x, y):
    """A roof whose ridge lies along (1, 0.1)."""
    return -0.4 * np.abs(y - 0.1 * x)


def test_a_blind_shift_turns_nothing():
    """Its least turn, times a prior of 10 mm, would make a yaw look uncertain that is seen."""
    for seeds in ((1, 2), (3, 4), (5, 6)):
        (blind,), seen = blind_of(edge, seeds)
        assert blind.words.startswith("shifts along"), blind.words
        np.testing.assert_array_equal(blind.direction[3:], 0)
        along = blind.direction[:3] / np.sign(blind.direction[0])
        np.testing.assert_allclose(along, np.array([1, 0.1, 0]) / np.hypot(1, 0.1), atol=0.01)
        assert np.linalg.matrix_rank(seen[3:]) == 3, "all turns are seen"


def test_the_other_directions_are_seen():
    """Free motions of a ball are shifts; those of a cylinder do not roll, and do not shift along it."""
    blind, seen = blind_of(ball)
    assert len(blind) == 3
    np.testing.assert_array_equal(seen, np.eye(6)[:, :3])
    blind, seen = blind_of(cylinder)
    assert (len(blind), seen.shape) == (2, (6, 4))
    assert np.abs(seen[3]).max() < 0.02
    assert np.abs(seen[0]).max() < 0.2
    assert blind_of(texture())[1].shape == (6, 6)
