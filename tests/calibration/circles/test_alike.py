"""Frames of one press are found alike, presses that differ are not."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.calibration.circles.alike import groups_alike
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.samples import PreparedPress
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
    assert grouped(many, [2]) == [[2]]


def pattern(seed, shape=(120, 160)):
    """A color change of 12 x 16 even blocks, of mean square 1 and median 0."""
    blocks = np.random.default_rng(seed).choice([-1.0, 1.0], (shape[0] // 10, shape[1] // 10, 3))
    blocks[0, 0] = blocks[1, 1] = 0
    return np.kron(blocks, np.ones((10, 10, 1))).astype(np.float32)


def alike(changes, circles=None, balls=(40.0, 40.0)):
    """Whether two presses are alike by these color changes, and by circles far apart if none are given."""
    circles = circles or [(30, 30, 15), (90, 60, 15)]
    presses = [PreparedPress("one", one, one[..., 0], ball) for one, ball in zip(changes, balls)]
    found = [ContactCircle(*circle, 1.0, 9.0) for circle in circles]
    return groups_alike(presses, found, [0, 1]) == [[0, 1]]


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        (1.075 * pattern(0), True),
        (1.084 * pattern(0), False),  # 7.7 % of the larger change, 8.4 % of the smaller
        (pattern(0) + 0.07 * pattern(1), True),
        (pattern(0) + 0.09 * pattern(1), False),
        (pattern(0) + np.float32(0.5), True),  # light all over
    ],
)
def test_changes_are_alike_up_to_eight_per_cent_of_the_smaller(other, expected):
    assert alike([pattern(0), other]) == expected


@pytest.mark.parametrize(
    ("circle", "balls", "expected"),
    [
        ((30.9, 30, 15), (40.0, 40.0), True),
        ((31.1, 30, 15), (40.0, 40.0), False),  # 2 px at 240 rows
        ((30, 30, 15.5), (40.0, 40.0), True),
        ((30, 30, 15.7), (40.0, 40.0), False),
        ((30, 30, 15), (40.0, 41.0), False),
    ],
)
def test_the_same_ball_in_the_same_circle_is_alike_whatever_the_colours(circle, balls, expected):
    assert alike([pattern(0), pattern(1)], [(30, 30, 15), circle], balls) == expected


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


def test_real_presses_differ(data):
    import gelform

    few = gelform.read_presses(data / "gelsight-ball-deep").subset(range(0, 42, 3))
    assert len(grouped(prepare(few), range(14))) == 14
