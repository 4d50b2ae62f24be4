"""Frames of one press are one press, however they were taken; presses of other places, or of another ball, are others."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.circles.find import ContactCircle
from gelform.calibration.circles.prepare import find_contacts, prepare
from gelform.calibration.circles.repeated import repeated_presses
from gelform.calibration.circles.samples import PreparedPress
from gelform.image.frame import pixels_digest

SHAPE = (240, 320)


def repeated(presses):
    prepared = prepare(presses)
    return repeated_presses(presses, prepared, find_contacts(prepared))


def saved_again(press, how):
    """The same picture, saved in another way."""
    image = press.image.astype(np.float32)
    changed = {
        "as JPEG": lambda: cv2.imdecode(cv2.imencode(".jpg", press.image)[1], cv2.IMREAD_COLOR),
        "3 gray levels brighter": lambda: image + 3,
        "redder": lambda: image + np.array([3, 0, 0]),
        "5 % brighter": lambda: image * 1.05,
        "a moment later": lambda: image + np.random.default_rng(0).normal(0, 2, image.shape),
    }[how]()
    pixels = np.clip(np.rint(changed), 0, 255).astype(np.uint8)
    return replace(press, name=f"{press.name} {how}", image=pixels, digest=pixels_digest(pixels))


@pytest.mark.parametrize(
    "how", ["as JPEG", "3 gray levels brighter", "redder", "5 % brighter", "a moment later"]
)
def test_one_picture_saved_in_two_ways_is_one_press(presses, how):
    four = presses.subset(range(4))
    both = replace(four, presses=(*four.presses, *(saved_again(one, how) for one in four.presses)))
    assert {frozenset(pair) for pair in repeated(both).items()} == {frozenset((k, k + 4)) for k in range(4)}
    assert repeated(four) == {}


def kept(presses, circles, balls=(60.0,) * 9):
    """The frames that show a press again, and the ones that stay, by circles (x, y, radius) and balls, px."""
    blank = np.zeros(SHAPE, np.float32)
    found = [ContactCircle(*circle, 1.0, 9.0) for circle in circles]
    prepared = [PreparedPress("", blank[..., None], blank, ball) for _, ball in zip(found, balls)]
    one = presses.presses[0]
    frames = tuple(replace(one, digest=str(k)) for k in range(len(found)))
    background = np.zeros((*SHAPE, 3), np.float32)
    return repeated_presses(replace(presses, presses=frames, background=background), prepared, found)


def test_a_press_that_deepens_is_one_and_the_deepest_frame_stays(presses):
    deepening = [(100, 90, 20), (100.5, 90, 24), (200, 90, 24), (100, 91, 30), (100, 90, 29)]
    assert kept(presses, deepening) == {0: 3, 1: 3, 4: 3}
    assert kept(presses, [(100, 90, 30), (100, 90, 61)]) == {1: 0}, "there the gel has left the ball"
    assert kept(presses, [(100, 90, 30), (100, 90, 30)]) == {1: 0}, "of equal ones the first"


def test_the_same_place_is_within_two_pixels_and_of_the_same_ball(presses):
    assert kept(presses, [(100, 90, 30), (101.9, 90, 30)]) == {1: 0}
    assert kept(presses, [(100, 90, 30), (102.1, 90, 30)]) == {}
    assert kept(presses, [(100, 90, 30), (100, 90, 30)], (60.0, 61.0)) == {}
    drifting = [(100 + 1.5 * k, 90, 30 + 0.1 * k) for k in range(4)]
    assert kept(presses, drifting) == {0: 3, 1: 3, 2: 3}, "by way of the frames between"


def test_frames_without_a_contact_hide_no_press(presses):
    """Their circles are somewhere; each is rejected for its own reason."""
    blank = replace(presses.presses[0], digest="blank", image=presses.background.astype(np.uint8))
    found = [ContactCircle(30, 20, 10, 1.0, 9.0), ContactCircle(30, 20, 14, 0.0, 1.0)]
    both = replace(presses, presses=(presses.presses[0], blank))
    assert repeated_presses(both, prepare(both), found) == {}
    assert repeated_presses(both, prepare(both), found[1:] * 2) == {}


def test_one_image_of_two_balls_is_refused(presses):
    one = presses.presses[0]
    other = replace(one, name="other", ball_diameter_mm=1.0)
    with pytest.raises(gelform.CalibrationError, match="same image, listed with balls of 1 and"):
        repeated(replace(presses, presses=(*presses.presses, other)))


@pytest.mark.slow
def test_real_presses_differ(data):
    few = gelform.read_presses(data / "mini-ball").subset(range(0, 67, 3))
    assert repeated(few) == {}
    again = replace(few, presses=(*few.presses, *(saved_again(one, "as JPEG") for one in few.presses)))
    assert len(repeated(again)) == len(few.presses)
