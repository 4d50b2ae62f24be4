"""Frames of one press are found alike, presses that differ are not."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles.alike import groups_alike
from gelform.calibration.circles.prepare import prepare


@pytest.fixture(scope="module")
def prepared(presses):
    return prepare(presses)


def again(press, noise):
    """Another frame of the same press."""
    change = press.color_change + noise.normal(0, 0.01, press.color_change.shape).astype(np.float32)
    return replace(press, color_change=change)


def test_presses_of_a_set_differ(prepared):
    assert groups_alike(prepared, range(len(prepared))) == [[i] for i in range(len(prepared))]


def test_frames_of_one_press_are_alike_through_the_noise(prepared):
    noise = np.random.default_rng(0)
    many = [*prepared[:4], again(prepared[1], noise), again(prepared[3], noise), again(prepared[1], noise)]
    assert groups_alike(many, range(7)) == [[0], [1, 4, 6], [2], [3, 5]]
    assert groups_alike(many, [6, 2, 4]) == [[6, 4], [2]]
    assert groups_alike(many, []) == []


def test_a_change_of_light_all_over_makes_no_difference(prepared):
    brighter = replace(prepared[0], color_change=prepared[0].color_change + np.float32(0.05))
    assert groups_alike([prepared[0], brighter], [0, 1]) == [[0, 1]]


def test_the_same_ball_a_little_deeper_differs(prepared):
    deeper = replace(prepared[0], color_change=prepared[0].color_change * np.float32(1.15))
    assert len(groups_alike([prepared[0], deeper], [0, 1])) == 2


def test_real_presses_differ(data):
    import gelform

    few = gelform.read_presses(data / "gelsight-ball-deep").subset(range(0, 42, 3))
    assert len(groups_alike(prepare(few), range(14))) == 14
