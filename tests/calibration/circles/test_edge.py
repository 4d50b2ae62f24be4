"""Where the gel leaves the ball, on gels drawn with a known end of the contact."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from gelform.calibration.circles.edge import LEAST_GAIN, RINGS, contact_radius_ratio, edge_of_gains
from gelform.calibration.circles.find import ContactCircle, magnitude
from gelform.calibration.circles.samples import USUAL_EDGE, PreparedPress

SHAPE, BALL_PX, CONTACT_PX, FALLS_PX = (120, 160), 40.0, 22.0, 14.0
TOWARD = np.array([[1.0, 0.1], [-0.5, 0.8], [-0.4, -0.9]])  # of three lights
MIDDLES = (RINGS[:-1] + RINGS[1:]) / 2


def steepness(away):
    """Of a gel that follows a ball up to 22 px and comes back to rest over some 14 px."""
    inside = np.minimum(away, CONTACT_PX)
    return inside / np.sqrt(BALL_PX**2 - inside**2) * np.exp(-np.maximum(away - CONTACT_PX, 0) / FALLS_PX)


def left_ball_at_px():
    """Where the gel's slope is 0.7 of the ball's."""
    return brentq(lambda r: steepness(r) * np.sqrt(BALL_PX**2 - r**2) / r - LEAST_GAIN, 22, 35)


def press(rng, visible_px, ball_px=BALL_PX):
    """A press somewhere in the frame; its rim is seen where one likes."""
    x, y = rng.uniform(45, 115), rng.uniform(45, 75)
    rows, cols = np.mgrid[: SHAPE[0], : SHAPE[1]]
    u, v = cols - x, rows - y
    away = np.hypot(u, v)
    slopes = -(steepness(away) / np.maximum(away, 1e-9))[..., None] * np.stack([u, v], axis=-1)
    change = slopes @ TOWARD.T + 0.1 * np.square(slopes).sum(-1, keepdims=True)
    change = (change + rng.normal(0, 0.01, change.shape)).astype(np.float32)
    contact = ContactCircle(x, y, visible_px, 0.9, 5.0)
    return PreparedPress("press", change, magnitude(change), ball_px), contact


def presses(count, visible_px, seed=3):
    rng = np.random.default_rng(seed)
    return zip(*(press(rng, visible_px) for _ in range(count)))


@pytest.mark.parametrize(
    ("count", "visible"), [(12, 1.6), pytest.param(24, 1.6, marks=pytest.mark.slow), (18, 1.25)]
)
def test_the_edge_of_a_visible_circle_is_found(count, visible):
    """Within a ring, whatever part of the visible circle it is."""
    wanted = left_ball_at_px() / (visible * CONTACT_PX)
    assert contact_radius_ratio(*presses(count, visible * CONTACT_PX)) == pytest.approx(wanted, abs=0.03)


def test_a_gel_that_follows_the_ball_to_the_rim_has_its_edge_there_and_few_presses_do_not_tell():
    assert contact_radius_ratio(*presses(18, CONTACT_PX)) == pytest.approx(1, abs=0.05)
    assert contact_radius_ratio(*presses(11, 1.6 * CONTACT_PX)) == USUAL_EDGE


def test_what_presses_were_prepared_with_does_not_decide():
    """The edge is measured up to the visible rim, not up to an edge that was assumed before."""
    made, contacts = presses(12, 1.3 * CONTACT_PX)
    assumed = [replace(one, contact_radius_ratio=0.5) for one in made]
    assert contact_radius_ratio(assumed, contacts) == contact_radius_ratio(made, contacts)


def gains_of(curve, presses=3):
    """The same gains in all presses."""
    return np.tile(np.asarray(curve, dtype=np.float64), (presses, 1))


@pytest.mark.parametrize("read", [1.0, 0.7])
@pytest.mark.parametrize("edge", [0.52, 0.7, 0.86])
def test_a_curve_is_cut_where_it_falls_below_what_is_read_further_in(read, edge):
    """Linear through 0.7 at the edge; a model that reads all slopes too gently says nothing of it."""
    falls = np.clip(LEAST_GAIN - 4 * (MIDDLES - edge), 0.05, 1)
    assert edge_of_gains(read * gains_of(falls)) == pytest.approx(edge, abs=1e-6)


def test_the_median_press_decides_and_one_that_never_falls_has_its_edge_at_the_rim():
    flat, falling = np.ones(len(MIDDLES)), np.where(MIDDLES < 0.6, 1, 0.3)
    assert edge_of_gains(np.stack([flat, flat, falling])) == 1
    assert edge_of_gains(np.stack([flat, falling, falling])) == edge_of_gains(gains_of(falling))
    for end in (0.9, 1.3):
        assert edge_of_gains(gains_of(np.linspace(1, end, len(MIDDLES)))) == 1


def test_one_low_ring_is_no_edge():
    """A scratch, or a cast shadow: two rings in a row have to be below, but for the last one."""
    curve = np.ones(len(MIDDLES))
    curve[9] = 0.4
    assert edge_of_gains(gains_of(curve)) == 1
    curve[10] = 0.4
    assert MIDDLES[8] < edge_of_gains(gains_of(curve)) < MIDDLES[9]
    last = np.ones(len(MIDDLES))
    last[-1] = 2 * LEAST_GAIN - 1
    assert edge_of_gains(gains_of(last)) == pytest.approx((MIDDLES[-2] + MIDDLES[-1]) / 2)


@pytest.mark.filterwarnings("error")
def test_rings_that_a_press_does_not_show_do_not_count():
    """Cut by the border, or steeper than a ball's rim is followed: NaN, in one press or in all."""
    falling = np.where(MIDDLES < 0.6, 1, 0.3)
    gains = gains_of(falling, 5)
    wanted = edge_of_gains(gains)
    gains[0, :4] = gains[1, 8:14] = gains[2, -3:] = np.nan
    assert edge_of_gains(gains) == wanted
    gains[:, -3:] = np.nan
    assert edge_of_gains(gains) == wanted
    level = gains_of(np.ones(len(MIDDLES)))
    level[:, 12:] = np.nan
    assert edge_of_gains(level) == 1
