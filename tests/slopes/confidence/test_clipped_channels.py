"""Clipped channels: which pixels they reach, and where too few channels are left to tell a slope."""

import numpy as np
import pytest

from gelform.image.background.change import ChangeSettings, PreparedBackground
from gelform.slopes.confidence import causes
from gelform.slopes.confidence.causes import ClippedChannels, ends_shown
from kernel_agreement import assert_kernel_agrees

FRAME = (41, 61)
BLURS = [0.0, 0.5, 0.6875, 1.0, 1.25, 2.5]


def gray(level=120):
    return np.full((*FRAME, 3), level, np.uint8)


def away_from(y, x):
    rows, columns = np.mgrid[: FRAME[0], : FRAME[1]]
    return np.hypot(rows - y, columns - x)


@pytest.mark.parametrize(("level", "counts"), [(0, True), (2, True), (3, False), (253, False), (254, True)])
@pytest.mark.parametrize("channel", [0, 1, 2])
def test_the_ends_of_the_range(level, counts, channel):
    image = gray()
    image[20, 30, channel] = level
    found, unseen = ClippedChannels(1.25, None, 1)(image, None)
    if not counts:
        assert found is unseen is None
        return
    assert found[20, 30].tolist() == [c == channel for c in range(3)]
    assert not unseen.any(), "two channels say enough"


@pytest.mark.parametrize("blur_px", BLURS)
def test_a_channel_is_clipped_as_far_as_its_blur_reaches(blur_px):
    """Outside it changes a color by less than 6 % of what it changes its own: the tail of a Gaussian at two sigma."""
    background, image = gray(), gray()
    image[20, 30, 1] = 255
    found = ClippedChannels(blur_px, None, 1)(image, None).channels
    assert not found[..., [0, 2]].any()
    reached = found[..., 1] > 0
    prepared = PreparedBackground(background, ChangeSettings(blur_px=blur_px))
    moved = np.abs(prepared.change(image) - prepared.change(background))[..., 1]
    assert moved[~reached].max() < 0.06 * moved.max()
    reach = np.ceil(2 * blur_px) + 1  # with what blooms
    assert reached[20, 30 - int(reach)]
    assert reached[20 + int(reach), 30]
    assert not reached[away_from(20, 30) > reach + 0.5].any()


def test_what_training_presses_showed_counts_fully():
    learnt = np.array([[False, True, False], [True, False, False]])
    found = ClippedChannels(1.25, learnt, 1)
    image = gray()
    image[10, 10], image[30, 40] = (120, 0, 120), (255, 120, 120)
    assert found(image, None) == (None, None)
    image[20, 50] = 0, 255, 120
    channels, _ = found(image, None)
    assert channels[20, 50].tolist() == [1, 1, 0]
    assert not channels[away_from(20, 50) > 5].any()


@pytest.mark.parametrize(("spare", "enough"), [(0, 3), (1, 2)])
def test_how_many_channels_a_slope_needs(spare, enough):
    image = gray()
    image[20, 30, :2] = 255
    image[10, 10, 2] = 0
    _, unseen = ClippedChannels(0.5, None, spare)(image, None)
    assert unseen[20, 30]
    assert unseen[10, 10] == (enough == 3)


def test_two_pixels_that_miss_one_channel_each_may_leave_too_few_between_them():
    image = gray()
    image[20, 30, 0], image[20, 34, 2] = 255, 0
    channels, unseen = ClippedChannels(1.0, None, 1)(image, None)
    np.testing.assert_array_equal(unseen, channels.sum(axis=-1) == 2)
    assert unseen[20, 32]
    assert not unseen[20, [30, 34]].any()


def test_hidden_and_unlit_pixels_do_not_clip():
    """A marker's black dot, and a corner that no light reaches."""
    hidden, outside = np.zeros(FRAME, bool), np.zeros(FRAME, bool)
    hidden[5:8, 5:8], outside[30:, 40:] = True, True
    image = gray()
    image[hidden | outside] = 0
    dark = ClippedChannels(1.25, None, 1, outside)
    assert dark(image, hidden) == (None, None)
    assert dark(image, None).unseen[6, 6]
    image[20, 30] = 0
    channels, unseen = dark(image, hidden)
    assert unseen[20, 30]
    assert not unseen[away_from(20, 30) > 5].any()
    assert ClippedChannels(1.25, None, 1)(image, hidden).unseen[35, 50]
    assert channels.dtype == np.uint8


def test_the_share_of_pixels_at_either_end():
    pixels = np.full((200, 3), 100, np.uint8)
    pixels[:20, 0], pixels[20:30, 0], pixels[:50, 2] = 2, 254, 255
    np.testing.assert_allclose(ends_shown(pixels), [[0.1, 0, 0], [0.05, 0, 0.25]])


def numpy_clipped(image, low, high, clipped, dark_to, saturated_from):
    return (((image <= dark_to) & low) | ((image >= saturated_from) & high)).astype(np.uint8)


@pytest.mark.parametrize("shape", [(1, 1), (1, 63), (1, 64), (1, 65), (7, 40)])
@pytest.mark.parametrize("levels", [(0, 256), (3, 254), (0, 200), (60, 256)])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_kernel_agrees_with_numpy_clipped(shape, levels, seed):
    rng = np.random.default_rng(seed)
    image = rng.integers(*levels, (*shape, 3), dtype=np.uint8)
    ends = rng.uniform(size=(2, 3)) > 0.3
    assert_kernel_agrees(
        causes._clipped_channels, numpy_clipped, image, ends[0], ends[1], np.empty_like(image), 2, 254
    )
