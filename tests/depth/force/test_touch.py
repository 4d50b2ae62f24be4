"""The numbers of a touch: its volume, its place, and the motion of the dots, on maps and motions that are written out."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.depth.force.model import Dots
from gelform.depth.force.touch import DotMotion, Touch, touch_from_dots, touch_from_result, touches_in_order
from gelform.image.markers import MarkerFlow
from gelform.result import Reconstruction

pytestmark = pytest.mark.linear_algebra

SHAPE, PITCH = (60, 80), 0.1
GRID = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 1.2 + 0.8
STILL = DotMotion(0, 0, 0, 0, 0)


def pressed(where=np.s_[20:30, 30:50], depth_mm=0.5, **known):
    """A block, pressed into the gel."""
    depth = np.zeros(SHAPE, dtype=np.float32)
    depth[where] = depth_mm
    gradients = np.zeros((*SHAPE, 2), dtype=np.float32)
    more = {"confidence": np.full(SHAPE, 0.8, np.float32), "outside_change": 0.1, "mm_per_px": PITCH} | known
    return Reconstruction(
        depth=depth, depth_sigma_mm=None, gradients=gradients, gradients_sigma=None, contact=depth > 0,
        known=np.ones(SHAPE, dtype=bool), calibration_digest="a", **more,
    )  # fmt: skip


def dotted(moved_mm, seen=None, **known):
    """The block beside a grid of dots that moved."""
    rest = (GRID / PITCH).astype(np.float32)
    seen = np.ones(len(GRID), dtype=bool) if seen is None else seen
    now = (rest + np.asarray(moved_mm) / PITCH).astype(np.float32)
    flow = MarkerFlow(rest, now, seen, np.full(len(GRID), 0.1, np.float32), PITCH)
    return pressed(markers=flow, **known)


def test_the_volume_of_a_block():
    touch = touch_from_result(pressed())
    assert touch.volume_mm3 == pytest.approx(1.0 * 2.0 * 0.5, rel=1e-6)
    assert touch.confidence == pytest.approx(0.8)
    assert (touch.outside_change, touch.border_share, touch.calibration_digest) == (0.1, 0, "a")
    assert touch.dots is None is touch.rest_mm


def test_uneven_pixels_and_depth_outside_the_contact():
    result = pressed(mm_per_px=(0.1, 0.2))
    result.depth[:10] = -0.3
    assert touch_from_result(result).volume_mm3 == pytest.approx(2.0, rel=1e-6)


def test_a_volume_is_as_uncertain_as_its_depth():
    """Whose deviation has what depth below 0 shows beside the contact."""
    sigma = np.full(SHAPE, 0.03, np.float32)
    sigma[20:30, 30:50] = 0.1
    stated = replace(pressed(), depth_sigma_mm=sigma)
    stated.depth[~stated.contact] = -0.2
    assert touch_from_result(stated).volume_sigma_mm3 == pytest.approx(0.1 * 2, rel=1e-5)
    assert touch_from_result(pressed()).volume_sigma_mm3 == 0, "nothing is stated of the depth"


def test_a_force_falls_from_a_tenth_below_the_largest_volume_of_a_contact():
    touches = [Touch(volume_mm3=volume) for volume in (0, 1, 2, 1.9, 1.7, 0, 1, None, 0.5)]
    falling = [touch.falling for touch in touches_in_order(touches)]
    assert falling == [False, False, False, False, True, False, False, False, False]


def test_the_part_of_a_contact_at_the_border():
    assert touch_from_result(pressed(np.s_[0:20, 30:50])).border_share == pytest.approx(2 / 20)
    assert touch_from_result(pressed(np.s_[20:30, -1:])).border_share == 1
    assert touch_from_result(pressed(np.s_[2:58, 2:78])).border_share == 0


@pytest.mark.parametrize(("known", "volume"), [({"depth_mm": 0}, 0), ({"mm_per_px": None}, None)])
def test_no_contact_and_no_scale(known, volume):
    assert touch_from_result(pressed(**known)).volume_mm3 == volume


def test_dots_that_turn_slide_and_tilt():
    angle, middle = 0.02, GRID.mean(axis=0)
    at = GRID - middle
    turned = at @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) - at
    moved = np.column_stack([turned + np.array([0.3, -0.2]), 0.1 + at @ (0.05, -0.04)])
    motion = touch_from_dots(GRID, moved).dots
    assert motion == pytest.approx((0.3, -0.2, np.sin(angle), 0.05, -0.04), abs=1e-12)
    assert touch_from_dots(GRID, moved[:, :2]).dots == pytest.approx(
        (0.3, -0.2, np.sin(angle), 0, 0), abs=1e-12
    )


def test_the_dots_of_a_result_rise_with_its_depth():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32) * PITCH
    result = dotted((0.3, -0.2))
    result.depth[:] = 0.03 * x - 0.02 * y
    motion = touch_from_result(result).dots
    assert motion == pytest.approx((0.3, -0.2, 0, 0.03, -0.02), abs=1e-4)


def test_unseen_dots_do_not_count_and_too_few_say_nothing():
    seen = np.arange(len(GRID)) % 2 == 0
    moved = np.where(seen[:, None], (0.3, -0.2), (9.0, 9.0))
    assert touch_from_result(dotted(moved, seen)).dots[:2] == pytest.approx((0.3, -0.2), abs=1e-5)
    few = touch_from_result(dotted(moved, np.arange(len(GRID)) < 4))
    assert few.dots is None
    assert few.rest_mm.shape == GRID.shape


@pytest.mark.parametrize(
    ("rest", "same"),
    [(GRID + 0.05, True), (GRID[3:], True), (GRID + 0.5, False), (GRID * 1.4, False), (GRID[:10], False)],
)
def test_the_same_dots_and_others(rest, same):
    assert (Dots(GRID).why_none(Touch(rest_mm=rest, dots=STILL)) == "") is same


@pytest.mark.parametrize(
    ("rest", "moved"), [(GRID, GRID[:4]), (GRID[:2], GRID[:2]), (GRID[:6], GRID[:6]), (GRID[0], GRID[0])]
)
def test_dots_that_tell_no_motion(rest, moved):
    with pytest.raises(ValueError, match="Expected"):
        gelform.touch_from_dots(rest, moved)
