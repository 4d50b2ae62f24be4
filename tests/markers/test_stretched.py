"""Dots drawn out by a contact are found by an affine map where a shift alone is refused."""

import numpy as np
import pytest

from gelform.markers import MarkerFollower
from gelform.markers.patches import Patches, logs_from_image
from gelform.markers.stretched import StretchedPatches
from made.dots import grid, image_of_dots

RADIUS = 5.5
REST = grid(32.0, (160, 192), 16.0)
UNTOUCHED = image_of_dots(REST, radii=RADIUS, shape=(160, 192), noise=1.0)
LOGS = logs_from_image(UNTOUCHED)
DOT, MOVED = 8, np.array([3.3, -1.6])


def image_of_stretched(warp, moved=MOVED, light=0.3):
    """All dots at rest but one, which a map (2, 2) about its centre has stretched."""
    y, x = np.mgrid[:160, :192].astype(float)
    clean = image_of_dots(np.delete(REST, DOT, 0), radii=RADIUS, shape=(160, 192), light=light).astype(float)
    away = np.stack([x, y], axis=-1) - (REST[DOT] + moved)
    inside = np.hypot(*np.moveaxis(away @ np.linalg.inv(warp).T, -1, 0))
    clean *= (1 - 0.85 / (1 + np.exp((inside - RADIUS) / 0.4)))[..., None]
    noisy = clean + np.random.default_rng(1).normal(0, 1, clean.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def turned(longer, shorter, degrees):
    """A stretch along a direction."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s], [s, c]])
    return turn @ np.diag([longer, shorter]) @ turn.T


@pytest.mark.parametrize(
    ("longer", "shorter", "degrees"), [(1.0, 1.0, 0), (1.6, 1.1, 0), (1.7, 0.9, 40), (0.9, 0.6, 110)]
)
def test_a_stretched_dot_is_found_where_it_is(longer, shorter, degrees):
    patches = Patches(LOGS, REST, RADIUS)
    logs = logs_from_image(image_of_stretched(turned(longer, shorter, degrees)))
    found = StretchedPatches(LOGS, patches)(logs, MOVED[None] + [[1.5, -1.0]], np.array([DOT]))
    assert found.ok[0]
    assert np.abs(found.shift_px[0] - MOVED).max() < 0.1
    assert found.sigma_px[0] < 0.1


def test_a_shift_alone_refuses_it_and_the_follower_does_not():
    image = image_of_stretched(turned(1.9, 1.3, 20))
    plain = Patches(LOGS, REST, RADIUS)(logs_from_image(image), np.zeros((len(REST), 2)))
    assert not plain.ok[DOT]
    follower = MarkerFollower(UNTOUCHED)
    flow = follower(image)
    at = np.linalg.norm(follower.rest_px - REST[DOT], axis=1).argmin()
    assert flow.seen.all()
    assert np.abs(flow.displacement_px[at] - MOVED).max() < 0.25


def test_no_dot_is_none():
    patches = Patches(LOGS, REST, RADIUS)
    empty = logs_from_image(image_of_dots(np.delete(REST, DOT, 0), radii=RADIUS, shape=(160, 192), noise=1.0))
    assert not StretchedPatches(LOGS, patches)(empty, np.zeros((1, 2)), np.array([DOT])).ok[0]
    none = StretchedPatches(LOGS, patches)(empty, np.zeros((0, 2)), np.zeros(0, np.intp))
    assert len(none.shift_px) == len(none.ok) == 0
