"""Joint moves: centres that are wrong by 2-4 px come back in a few steps, whatever the light does over the image."""

import numpy as np

from gelform.ball import ball_gradients, center_jacobian
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.joint import MAX_STEP_PX, joint_moves
from gelform.calibration.circles.samples import PreparedPress

SHAPE, BALL_PX, CONTACT_PX = (120, 160), 26.0, 20.0
TRUTH = [(x, y) for y in (30, 60, 90) for x in (30, 65, 100, 130)]


def press_at(center):
    """Colours that are linear in the slope, by lights that turn and weaken over the image, and a little even in it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    inside = np.hypot(x - center[0], y - center[1]) < CONTACT_PX
    slope = ball_gradients(x, y, center, BALL_PX) * inside[..., None]
    turn = 0.3 * (x - 80) / 80 + 2 * np.pi * np.arange(3)[:, None, None] / 3
    strength = 0.3 * (1 + 0.2 * (y - 60) / 60)
    change = strength * (np.cos(turn) * slope[..., 0] + np.sin(turn) * slope[..., 1])
    change += 0.02 * np.sum(slope**2, axis=-1)
    change = np.moveaxis(change, 0, -1).astype(np.float32)
    return PreparedPress("press", change, np.linalg.norm(change, axis=-1), BALL_PX)


def circles(centers):
    return [ContactCircle(x, y, CONTACT_PX, 0.8, 10.0) for x, y in centers]


def off_px(contacts):
    return np.hypot(*(np.array([(c.x_px, c.y_px) for c in contacts]) - TRUTH).T)


def test_wrong_centres_come_back():
    rng = np.random.default_rng(3)
    presses = [press_at(center) for center in TRUTH]
    contacts = circles(np.array(TRUTH) + rng.uniform(-3, 3, (len(TRUTH), 2)))
    assert np.median(off_px(contacts)) > 1.5
    for _ in range(4):
        moves = joint_moves(presses, contacts, 0.8, (1,), total=6000)
        contacts = circles([(c.x_px + dx, c.y_px + dy) for c, (dx, dy) in zip(contacts, moves)])
    assert off_px(contacts).max() < 0.3


def test_right_centres_stay_and_no_step_is_long():
    presses = [press_at(center) for center in TRUTH]
    stay = joint_moves(presses, circles(TRUTH), 0.8, (1,), total=6000)
    assert np.hypot(*stay.T).max() < 0.1
    far = circles([(x + 9, y) for x, y in TRUTH])
    assert np.hypot(*joint_moves(presses, far, 0.8, (1,), total=6000).T).max() <= MAX_STEP_PX / 2 + 1e-9


def test_the_jacobian_is_that_of_the_labels():
    at = np.array([3.0, -7.0, 11.0]), np.array([5.0, 2.0, -6.0])
    step = 1e-5
    for k, move in enumerate(((step, 0), (0, step))):
        numeric = (ball_gradients(*at, move, BALL_PX) - ball_gradients(*at, (0, 0), BALL_PX)) / step
        analytic = center_jacobian(ball_gradients(*at, (0, 0), BALL_PX), np.full(3, BALL_PX))[:, :, k]
        np.testing.assert_allclose(analytic, numeric, rtol=1e-4, atol=1e-6)
