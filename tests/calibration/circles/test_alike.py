"""Frames of one press are found alike, presses that differ are not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.calibration.circles.alike import groups_alike
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.selection.folds import make_folds
from gelform.frames import pixels_digest


def grouped(presses, among):
    return groups_alike(presses, find_contacts(presses), among)


def again(press, noise):
    """Another frame of the same press."""
    change = press.color_change + noise.normal(0, 0.01, press.color_change.shape).astype(np.float32)
    return replace(press, color_change=change)


def test_presses_of_a_set_differ(prepared):
    assert grouped(prepared, range(len(prepared))) == [[i] for i in range(len(prepared))]


def test_frames_of_one_press_are_alike_through_the_noise(prepared):
    noise = np.random.default_rng(0)
    many = [*prepared[:4], again(prepared[1], noise), again(prepared[3], noise), again(prepared[1], noise)]
    assert grouped(many, range(7)) == [[0], [1, 4, 6], [2], [3, 5]]
    assert grouped(many, [6, 2, 4]) == [[6, 4], [2]]
    assert grouped(many, []) == []


def test_a_change_of_light_all_over_makes_no_difference(prepared):
    brighter = replace(prepared[0], color_change=prepared[0].color_change + np.float32(0.05))
    assert grouped([prepared[0], brighter], [0, 1]) == [[0, 1]]


def saved_again(press, how):
    """The same picture, saved in another way."""
    image = press.image.astype(np.float32)
    changed = {
        "as JPEG": lambda: cv2.imdecode(cv2.imencode(".jpg", press.image)[1], cv2.IMREAD_COLOR),
        "3 grey levels brighter": lambda: image + 3,
        "redder": lambda: image + np.array([3, 0, 0]),
        "5 % brighter": lambda: image * 1.05,
        "a moment later": lambda: image + np.random.default_rng(0).normal(0, 2, image.shape),
    }[how]()
    pixels = np.clip(np.rint(changed), 0, 255).astype(np.uint8)
    return replace(press, image=pixels, digest=pixels_digest(pixels))


@pytest.mark.parametrize(
    "how", ["as JPEG", "3 grey levels brighter", "redder", "5 % brighter", "a moment later"]
)
def test_one_picture_saved_in_two_ways_stays_in_one_fold(presses, how):
    four = presses.subset(range(4))
    both = prepare(replace(four, presses=(*four.presses, *(saved_again(one, how) for one in four.presses))))
    found = find_contacts(both)
    assert groups_alike(both, found, range(8)) == [[0, 4], [1, 5], [2, 6], [3, 7]]
    for fold in make_folds(both, found, range(8)):
        assert {i % 4 for i in fold.held_out}.isdisjoint(i % 4 for i in fold.training)


def test_the_same_ball_deeper_differs(prepared):
    """15 % more change, and the larger circle that it leaves."""
    deeper = replace(prepared[0], color_change=prepared[0].color_change * np.float32(1.15))
    (circle,) = find_contacts(prepared[:1])
    larger = replace(circle, radius_px=1.1 * circle.radius_px)
    assert len(groups_alike([prepared[0], deeper], [circle, larger], [0, 1])) == 2


def test_real_presses_differ(data):
    import gelform

    few = gelform.read_presses(data / "gelsight-ball-deep").subset(range(0, 42, 3))
    assert len(grouped(prepare(few), range(14))) == 14
