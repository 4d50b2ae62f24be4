"""How far the gel follows the ball, on gels drawn with a known end of the contact."""

import numpy as np
import pytest

from gelform.calibration.circles.find import ContactCircle, magnitude
from gelform.calibration.circles.followed import LEAST_PRESSES, USUAL_CIRCLE, followed_share
from gelform.calibration.circles.samples import PreparedPress

SHAPE, BALL_PX, CONTACT_PX, FALLS_PX = (120, 160), 40.0, 22.0, 14.0
TOWARD = np.array([[1.0, 0.1], [-0.5, 0.8], [-0.4, -0.9]])  # of three lights


def press(rng, visible_px):
    """A gel that follows a ball up to 22 px and comes back to rest over some 14 px; its rim is seen where one likes."""
    x, y = rng.uniform(45, 115), rng.uniform(45, 75)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = cols - x, rows - y
    away = np.hypot(u, v)
    steep = np.minimum(away, CONTACT_PX) / np.sqrt(BALL_PX**2 - np.minimum(away, CONTACT_PX) ** 2)
    steep *= np.exp(-np.maximum(away - CONTACT_PX, 0) / FALLS_PX)
    slopes = -steep[..., None] * np.stack([u, v], axis=-1) / np.maximum(away, 1e-9)[..., None]
    change = slopes @ TOWARD.T + 0.1 * np.square(slopes).sum(-1, keepdims=True)
    change = (change + rng.normal(0, 0.01, change.shape)).astype(np.float32)
    contact = ContactCircle(x, y, visible_px, 0.9, 5.0)
    return PreparedPress("press", change, magnitude(change), BALL_PX), contact


@pytest.mark.parametrize("count", [LEAST_PRESSES, 24])
def test_the_end_of_a_wide_visible_circle_is_found(count):
    rng = np.random.default_rng(3)
    presses, contacts = zip(*(press(rng, 1.6 * CONTACT_PX) for _ in range(count)))
    contact = USUAL_CIRCLE * followed_share(presses, contacts)
    assert contact == pytest.approx(1 / 1.6, abs=0.08), "of the visible radius, within half a ring"


def test_a_usual_gel_is_taken_as_it_is():
    rng = np.random.default_rng(4)
    presses, contacts = zip(*(press(rng, 1.05 * CONTACT_PX) for _ in range(20)))
    assert followed_share(presses, contacts) == 1


def test_too_few_presses_do_not_tell():
    rng = np.random.default_rng(5)
    presses, contacts = zip(*(press(rng, 1.6 * CONTACT_PX) for _ in range(LEAST_PRESSES - 1)))
    assert followed_share(presses, contacts) == 1


def test_deep_presses_go_by_the_ball():
    rng = np.random.default_rng(6)
    presses, contacts = zip(*(press(rng, 1.05 * BALL_PX) for _ in range(20)))
    assert followed_share(presses, contacts) == 1
