"""Sets of ball presses."""

import re

import numpy as np
import pytest

from gelform.simulate import simulate_ball_presses
from made.sensors import SMALL


def test_one_press_of_a_set_does_not_depend_on_how_many_follow():
    few = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=2, rng=np.random.default_rng(5))
    again = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=3, rng=np.random.default_rng(5))
    for a, b in zip(few.presses, again.presses):
        np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(few.background, again.background)


def test_ball_presses_are_spread_and_some_are_cut_by_the_border():
    done = []
    simulated = simulate_ball_presses(
        SMALL, ball_diameters_mm=[6.31, 9.5], count=30, rng=np.random.default_rng(0), oversample=1,
        progress=lambda k, n, what: done.append((k, n)),
    )  # fmt: skip
    assert done[0] == (1, 30)
    assert done[-1] == (30, 30)
    centers = np.array([press.center_px for press in simulated.presses])
    counts, *_ = np.histogram2d(*centers.T, bins=3, range=[[0, 64], [0, 48]])
    assert counts.min() >= 2
    radius = np.array([press.contact_radius_px for press in simulated.presses])
    cut = (centers.min(axis=1) < radius) | ((63, 47) - centers < radius[:, None]).any(axis=1)
    assert 5 < cut.sum() < 28
    rims = [np.hypot(*np.moveaxis(p.gradients[p.contact], -1, 0)).max() for p in simulated.presses]
    assert 0.5 < np.median(rims) < 0.95
    assert {press.ball_diameter_mm for press in simulated.presses} == {6.31, 9.5}


REFUSED = [
    (
        lambda: simulate_ball_presses(SMALL, ball_diameters_mm=[], count=3, rng=np.random.default_rng()),
        "a ball",
    ),
]


@pytest.mark.parametrize(("make", "message"), REFUSED)
def test_bad_settings_are_refused_with_the_reason(make, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        make()
