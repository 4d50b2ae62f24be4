"""Each standard deviation that gelform states, against a truth it has not seen: as many errors lie within as it says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

import gelform
from gelform.calibration.circles.find import distances_px
from gelform.calibration.geometry.scale import scale_from_points
from gelform.image.markers.follower import MarkerFollower
from gelform.image.registration import PreparedRegistration
from gelform.motion.between import LOST, step_of_pose
from gelform.result.metrics import ball_gradients
from gelform.simulate import Ball, simulate_press
from made.images import grid, image_of_dots
from made.rigid_contacts import contact_of, pose, texture
from made.small_gel import Touch, depth_of, image_of
from made.small_gel import calibration as known_calibration

# Radius and depth, mm, and the place, mm, of balls that the calibration has not seen.
BALLS = [(3.0, 0.6, (1.0, -0.5)), (3.4, 0.4, (-2.0, 1.0)), (2.8, 0.7, (2.5, 1.5)), (3.0, 0.5, (-1.0, -2.0))]


@pytest.fixture(scope="module")
def read(calibration, sensor):
    """Simulated presses, and what a calibrated sensor makes of their images."""
    reconstruct, rng = gelform.Reconstructor(calibration), np.random.default_rng(8)
    made = [simulate_press(sensor, Ball(r), depth_mm=d, center_mm=at, rng=rng) for r, d, at in BALLS]
    return [(one, reconstruct(one.image)) for one in made]


def slopes(read, where):
    return [((r.gradients - made.gradients) / r.gradients_sigma)[where(made)] for made, r in read]


def depths(read, where):
    return [((r.depth_mm - made.depth_mm) / r.depth_sigma_mm)[where(made)] for made, r in read]


def radii(made):
    """Distance of each pixel from the ball's axis, in contact radii."""
    y, x = np.indices(made.depth_mm.shape)
    return np.hypot(x - made.center_px[0], y - made.center_px[1]) / made.contact_radius_px


def shapes(read):
    """Depths minus their mean over the contact."""
    for made, result in read:
        error = (result.depth_mm - made.depth_mm)[made.contact]
        sigma = result.depth_difference_sigma(made.contact)[made.contact]
        assert sigma.mean() < 0.8 * result.depth_sigma_mm[made.contact].mean(), (
            "better known than against zero"
        )
        yield (error - error.mean()) / sigma


def known_gel():
    """Sigma is of the calibration's 3 to 6 % of slope, the noise here of one: errors may be smaller, never larger."""
    for touch in (Touch(), Touch(3.0, 0.3, 30, 40, 5)):
        result = gelform.Reconstructor(known_calibration())(image_of(touch))
        yield (result.depth_mm - depth_of(touch)) / result.depth_sigma_mm


def motions():
    rng = np.random.default_rng(0)
    for seed in range(40):
        face = texture(seed)
        true = pose(*rng.uniform(-0.25, 0.25, 2), *rng.uniform(-1, 1, 4) * (0.03, 1, 1, 5))
        before, after = contact_of(face, seed=2 * seed), contact_of(face, true, seed=2 * seed + 1)
        found = gelform.motion_between(before, after, place_error=0.0)
        if found.state != LOST and not found.blind:
            off = step_of_pose(found.pose @ np.linalg.inv(true), found.center_mm)
            yield off / np.sqrt(np.diag(found.covariance))


def shifts_of_the_camera():
    rng = np.random.default_rng(2)
    grain = ndimage.gaussian_filter(rng.standard_normal((140, 160)), 1.5)
    gel = (110 * (1 + 0.03 * grain / grain.std()))[..., None] * [0.9, 1.0, 0.8]

    def taken(shift):
        moved = ndimage.shift(gel, (*shift[::-1], 0), order=3, mode="nearest")
        return np.clip(moved + rng.normal(0, 1, gel.shape), 0, 255).astype(np.float32)

    registered = PreparedRegistration(taken((0, 0)))
    for shift in rng.uniform(-2, 2, (20, 2)):
        found = registered(taken(shift))
        yield (found.shift_px - shift) / found.shift_sigma_px


def markers():
    rng, rest = np.random.default_rng(3), grid()
    follower = MarkerFollower(image_of_dots(rest).astype(np.float32))
    for seed in range(8):
        moved = rng.uniform(-1, 1, rest.shape)
        flow = follower(image_of_dots(rest + moved, noise=2.0, seed=seed))
        own = np.linalg.norm(flow.rest_px[:, None] - rest, axis=-1).argmin(axis=1)
        yield ((flow.displacement_px - moved[own]) / flow.sigma_px[:, None])[flow.seen]


def scales():
    rng, a, b = np.random.default_rng(4), np.array([30.0, 40.0]), np.array([250.0, 130.0])
    for _ in range(400):
        length = 12.0 + rng.normal(0, 0.02)
        ends = (tuple(end + rng.normal(0, 0.5, 2)) for end in (a, b))
        scale = scale_from_points(*ends, length, sigma_px=0.5, sigma_mm=0.02)
        yield np.array([scale.mm_per_px - 12 / np.hypot(*(b - a))]) / scale.sigma


# Errors over sigma, their least and largest part within one, and their least part within two. A sensor of few rows is
# stated a little too widely (docs/decisions/0009-stated-slopes.md).
STATED = {
    "solved slopes of a contact": (
        lambda read: slopes(read, lambda made: radii(made) < 0.85),
        (0.6, 0.99),
        0.95,
    ),
    "solved slopes at rest": (lambda read: slopes(read, lambda made: radii(made) > 3), (0.6, 0.97), 0.95),
    "depth of a frame": (lambda read: depths(read, lambda _: ...), (0.5, 0.85), 0.9),
    "depth of a contact": (lambda read: depths(read, lambda made: made.contact), (0.5, 0.95), 0.9),
    "shape of a contact": (shapes, (0.5, 0.9), 0.88),
    "depth of a known gel": (lambda _: known_gel(), (0.5, 1.01), 0.98),
    "motion": (lambda _: motions(), (0.6, 0.98), 0.95),
    "shift of the camera": (lambda _: shifts_of_the_camera(), (0.5, 0.95), 0.9),
    "places of markers": (lambda _: markers(), (0.6, 0.95), 0.95),
    "scale of two marks": (lambda _: scales(), (0.62, 0.76), 0.93),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", STATED)
def test_as_many_errors_are_within_sigma_as_it_says(what, read):
    errors, (least, most), two = STATED[what]
    ratio = np.abs(np.concatenate([np.ravel(one) for one in errors(read)]))
    assert len(ratio) > 30
    assert least < np.mean(ratio < 1) < most
    assert np.mean(ratio < 2) > two


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mini-ball", "digit-ball"])
def test_as_many_slopes_of_real_presses_are_within_sigma_as_it_says(data, name):
    """Of presses that no calibration has seen, inside the circle where the gel surely follows the ball.

    About the center that the slopes themselves show: the circle's is off by a pixel, which is as much as sigma.
    """
    presses = gelform.read_presses(data / name)
    count = len(presses.presses)
    trained, judged = (
        presses.subset(range(first, count, count // most)) for first, most in ((0, 14), (1, 7))
    )
    calibration = gelform.calibrate(trained, start=None)
    reconstruct, ratios = gelform.Reconstructor(calibration), []
    for row, press in zip(gelform.evaluate(calibration, judged).rows, judged.presses):
        assert row["reason"] is None
        x, y, radius = row["circle_px"]
        rows, columns = np.nonzero(distances_px(presses.image_shape, x, y) < 0.7 * radius)
        result = reconstruct.from_image(press.image)
        true = ball_gradients(columns, rows, (x, y), press.ball_diameter_mm / 2 / presses.mm_per_px)
        off = result.gradients[rows, columns] - true
        ratios.append((off - off.mean(axis=0)) / result.gradients_sigma[rows, columns])
    ratio = np.abs(np.concatenate(ratios))
    assert 0.6 < np.mean(ratio < 1) < 0.88
    assert 0.88 < np.mean(ratio < 2) < 0.985
