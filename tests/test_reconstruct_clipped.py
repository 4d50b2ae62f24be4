"""Channels at an end of the camera's range: left out where training did not show them so, on a gel that is known exactly."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

import gelform
from made.small_gel import (
    LIGHTS,
    MM_PER_PX,
    SHAPE,
    Touch,
    background,
    calibration,
    depth_of,
    image_of,
    stepping,
)

TOUCH = Touch(radius_mm=3.0, depth_mm=0.6, x_px=40, y_px=32)
DEPTH = depth_of(TOUCH)
SLOPES = np.stack(np.gradient(DEPTH, MM_PER_PX)[::-1], axis=-1)
INSIDE = DEPTH > 0.03
SHOWN = np.ones((2, 3), bool)
BOX = np.s_[5:15, 60:75]  # beside the ball


def learnt(known):
    """A calibration whose presses showed every channel at both ends."""
    return replace(known, forward=replace(known.forward, clipped=SHOWN))


def exposed(*channels, level=240):
    """Background and image of which some channels are at a level at rest; of 240 the ball's bright side is beyond 255."""
    rest = background().copy()
    rest[..., list(channels)] = level
    normals = np.concatenate([-SLOPES, np.ones((*SHAPE, 1))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = rest * np.maximum(normals @ LIGHTS.T, 0) + np.random.default_rng(1).normal(0, 1, rest.shape)
    image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    assert (np.count_nonzero(image >= 254) > 250) == (level == 240)
    return rest, image


def slope_error(result, where):
    return float(np.sqrt(np.mean(np.square(result.observed_gradients - SLOPES)[where])))


def depth_error_um(result):
    return 1e3 * np.sqrt(np.mean((result.depth_mm - DEPTH) ** 2))


def test_a_channel_that_clips_in_use_is_left_out():
    """Each pixel here lacks one channel at most: the other two say the slope nearly as well."""
    for channels in [(0,), (1,), (2,), (0, 1, 2)]:
        rest, image = exposed(*channels)
        clips = (image >= 254).any(axis=-1) & INSIDE
        reconstruct = gelform.Reconstructor(replace(stepping(), background=rest))
        result, why = reconstruct(image), reconstruct.explain(image)
        as_it_is = gelform.Reconstructor(replace(learnt(stepping()), background=rest))(image)
        assert slope_error(result, clips) < 0.6 * slope_error(as_it_is, clips)
        assert slope_error(result, clips) < 1.5 * slope_error(result, INSIDE & ~clips)
        off = np.linalg.norm(result.observed_gradients - SLOPES, axis=-1)
        assert (off > 3 * why.gradients_sigma)[clips].mean() < 0.01
        assert np.median(result.confidence[clips]) == 1
        assert (why.maps["saturated"][clips] > 0).all()
        assert depth_error_um(result) < 3


def test_what_is_left_out_is_missed():
    """The step's own deviation says what two channels say less than three, of the same ball less exposed."""
    for channel in [0, 1, 2]:
        rest, image = exposed(channel)
        two = gelform.Reconstructor(replace(stepping(), background=rest)).explain(image)
        clips = (image >= 254).any(axis=-1) & INSIDE
        rest, image = exposed(channel, level=200)
        three = gelform.Reconstructor(replace(stepping(), background=rest)).explain(image)
        assert not three.maps["saturated"].any()
        assert 1.1 < np.median(two.maps["saturated"][clips] / three.law[clips]) < 2
        beside = (two.maps["saturated"] == 0) & INSIDE
        assert np.median(two.law[beside] / three.law[beside]) == pytest.approx(1, abs=0.02)


def test_a_channel_that_training_showed_clipped_counts_fully():
    for channel, (level, within) in product([0, 1, 2], [(254, 253), (2, 3), (0, 3)]):
        image, other = image_of(TOUCH), image_of(TOUCH)
        image[BOX[0], BOX[1], channel], other[BOX[0], BOX[1], channel] = level, within
        shown, left_out = gelform.Reconstructor(learnt(stepping())), gelform.Reconstructor(stepping())
        assert not shown.explain(image).maps["saturated"].any()
        assert not shown.explain(image).maps["dark"].any()
        apart = [
            np.abs(one(image).observed_gradients - one(other).observed_gradients)[BOX].max()
            for one in (shown, left_out)
        ]
        assert apart[0] < 0.1 < apart[1]


def test_of_two_clipped_channels_nothing_is_known():
    for channels, level in product([[0, 1], [0, 2], [1, 2], [0, 1, 2]], [0, 2, 254, 255]):
        image = image_of(TOUCH)
        image[BOX[0], BOX[1], channels] = level
        reconstruct = gelform.Reconstructor(stepping())
        result, why = reconstruct(image), reconstruct.explain(image)
        assert 0 < result.confidence[BOX].max() < 1e-5
        assert result.gradients_sigma[BOX].min() > 0.2
        name = "dark" if level < 100 else "saturated"
        assert [finding.name for finding in why.findings] == [name]
        assert depth_error_um(result) < 8


def test_a_dead_channel_beside_the_ball_does_no_harm():
    for channel, level in product([0, 1, 2], [0, 255]):
        image = image_of(TOUCH)
        image[BOX[0], BOX[1], channel] = level
        reconstruct = gelform.Reconstructor(stepping())
        result, why = reconstruct(image), reconstruct.explain(image)
        off = np.linalg.norm(result.observed_gradients - SLOPES, axis=-1)
        assert (off[BOX] < 4 * why.gradients_sigma[BOX]).all()
        assert (why.maps["dark" if level == 0 else "saturated"][BOX] > 0).all()
        assert depth_error_um(result) < 12


def test_without_a_step_a_clipped_channel_costs_the_pixel_its_weight():
    """As in calibrations that were imported; the rest gives its result."""
    image, own = image_of(TOUCH), calibration().slope_sigma
    image[BOX[0], BOX[1], 1] = 255
    stepless = replace(stepping(), forward=replace(stepping().forward, step_sigma=None))
    for known, sigma in product([calibration(), stepless], [own, None]):
        result = gelform.Reconstructor(replace(known, slope_sigma=sigma))(image)
        assert result.confidence[BOX].max() < 1e-5
        assert (result.gradients_sigma is None) == (sigma is None)
        assert depth_error_um(result) < 10
    mixed = ((0.9, 0.08, 0.02), (0.1, 0.85, 0.05), (0.0, 0.1, 0.9))
    undone = replace(stepping(), change=replace(stepping().change, crosstalk=mixed))
    in_all_three = gelform.Reconstructor(undone)(image)
    assert in_all_three.confidence[BOX].max() < 1e-5


def test_black_dots_and_a_corner_that_is_never_lit_clip_nothing_around_them():
    y, x = np.indices(SHAPE)
    dots, corner = ((y - 4) % 10 < 4) & ((x - 4) % 10 < 4) & (y > 3) & (x > 3), (y < 10) & (x < 12)
    for name, black in (("marker", dots), ("outside", corner)):
        rest, image = background().copy(), image_of(TOUCH)
        rest[black], image[black] = 1, 1 if name == "marker" else 0
        why = gelform.Reconstructor(replace(stepping(), background=rest)).explain(image)
        assert {finding.name for finding in why.findings} == {name}
        assert why.maps[name].any()
        assert not why.maps["dark"].any()
