"""Coverage: a press shows the directions of its own slopes where it is, and the gap is where to press next."""

import numpy as np
import pytest

from gelform.calibration.report.coverage import DIRECTIONS, bins_of_press, coverage, direction_of, grid_of
from gelform.calibration.report.held_out import HeldOutSample

SHAPE, BALL = (120, 160), 60.0


def circles(places, radius=20.0):
    return [(float(x), float(y), radius) for x, y in places]


def everywhere(step=14):
    return [(x, y) for x in range(4, SHAPE[1], step) for y in range(4, SHAPE[0], step)]


def test_cells_are_about_square():
    assert grid_of((240, 320)) == (6, 8)
    assert grid_of((320, 240)) == (8, 6)
    assert grid_of((100, 1000)) == (2, 8)


@pytest.mark.parametrize(
    ("slope", "octant"), [((1, 0), 0), ((0, 1), 2), ((-1, 0), 4), ((0, -1), 6), ((1, 1), 1)]
)
def test_octants(slope, octant):
    assert direction_of(np.array([slope], dtype=float))[0] == octant


def test_left_of_a_ball_slopes_rise_to_the_right():
    """One cell left of the centre and one right of it: depth is largest in the middle."""
    seen = bins_of_press((80.0, 60.0, 30.0), BALL, 0.9, SHAPE, (1, 2))
    left, right = seen
    assert left[0]
    assert not left[4]
    assert right[4]
    assert not right[0]


def test_a_gel_pressed_everywhere_is_covered_and_one_press_is_not():
    full = coverage(circles(everywhere()), [BALL] * len(everywhere()), 0.8, [], SHAPE)
    alone = coverage(circles([(80, 60)]), [BALL], 0.8, [], SHAPE)
    assert full["covered"] > 0.95 > 0.3 > alone["covered"]
    assert np.shape(full["presses"]) == (full["rows"] * full["columns"], DIRECTIONS)


@pytest.mark.parametrize("gap", [(130, 30), (30, 90)])
def test_the_next_press_is_in_the_gap(gap):
    places = [p for p in everywhere(10) if np.hypot(p[0] - gap[0], p[1] - gap[1]) > 35]
    found = coverage(circles(places), [BALL] * len(places), 0.8, [], SHAPE)
    first = found["next"][0]
    assert np.hypot(first["x_px"] - gap[0], first["y_px"] - gap[1]) < 25


def test_the_second_place_is_another_one():
    found = coverage(circles([(20, 20)]), [BALL], 0.8, [], SHAPE)
    places = {(p["x_px"], p["y_px"]) for p in found["next"]}
    assert len(places) == 3


def test_where_errors_are_large_another_press_is_worth_more():
    y, x = (a.ravel().astype(np.float32) for a in np.mgrid[: SHAPE[0] : 2, : SHAPE[1] : 2])
    true = np.stack([np.cos(x), np.sin(x)], axis=1).astype(np.float32)
    here = np.hypot(x - 125, y - 85) < 25
    seen = np.where(here[:, None], 2 * true, 1.05 * true)
    read = HeldOutSample(0, (125.0, 85.0, 25.0), x, y, true, seen, np.zeros((0, 0), np.float32))
    places = everywhere(10)
    first = coverage(circles(places), [BALL] * len(places), 0.8, [read], SHAPE)["next"][0]
    assert np.hypot(first["x_px"] - 125, first["y_px"] - 85) < 30
