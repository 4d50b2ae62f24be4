"""Steps of whole frames: those of the response at each pixel, with the depth of the slopes that were read."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.color_models._shared.nodes import node_positions
from gelform.color_models.forward_response import TERMS, ForwardResponse
from gelform.color_models.frame_depth import FrameDepth
from gelform.color_models.stepped import SteppedSlopes

SHAPE, UNTOUCHED = (90, 121), 0.02


@pytest.fixture(scope="module")
def response():
    """Lights from three sides, stronger towards the right, and a pressed gel that is brighter."""
    rows, columns = (len(axis) for axis in node_positions(SHAPE))
    nodes = np.zeros((rows, columns, TERMS, 3))
    nodes[:, :, 0] = [0.3, -0.15, -0.1]
    nodes[:, :, 1] = [0.0, 0.25, -0.2]
    nodes *= np.linspace(0.8, 1.2, columns)[:, None, None]
    nodes[:, :, 2:5] = 0.01
    nodes[:, :, -3] = [0.1, 0.05, 0.08]
    nodes[:, :, -2] = 0.02
    covariance = 1e-4 * np.array([[1.0, 0.3, 0.2], [0.3, 1.5, 0.1], [0.2, 0.1, 0.8]])
    return ForwardResponse(nodes, covariance, SHAPE, (0.02, 0.1))


def pixels():
    """Columns and rows of all pixels, row by row."""
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    return x, y


@pytest.fixture(scope="module")
def frame(response):
    """Color change of a bump 5 px deep, its slopes, and what a color model reads there: 10 % too little."""
    x, y = pixels()
    depth = 5 * np.exp(-((x - 70) ** 2 + (y - 40) ** 2) / 300)
    slopes = np.stack([70 - x, 40 - y], axis=1) * (depth / 150)[:, None]
    change = response.color_from_gradients(slopes, x, y, depth_px=depth)
    change += np.random.default_rng(0).normal(0, 0.002, change.shape)
    read = (0.9 * slopes).reshape(*SHAPE, 2).astype(np.float32)
    return change.reshape(*SHAPE, 3).astype(np.float32), read, slopes.reshape(*SHAPE, 2)


def full_depth(change, read, hidden=None):
    """Of the slopes that were read, at every pixel."""
    depth = FrameDepth(SHAPE, UNTOUCHED)(change, read, hidden)
    return cv2.resize(depth, SHAPE[::-1], interpolation=cv2.INTER_LINEAR)


def test_a_step_is_that_of_the_response_with_the_frames_depth(response, frame):
    change, read, _ = frame
    stepped = SteppedSlopes(response, SHAPE, UNTOUCHED)
    assert stepped.steps
    found, depth = stepped(change, read), full_depth(change, read)
    assert 4 < depth.max() < 5
    at = change.reshape(-1, 3), read.reshape(-1, 2), *pixels()
    wanted = response.step(*at, depth.ravel())
    np.testing.assert_allclose(found.gradients.reshape(-1, 2), wanted.gradients, atol=2e-4)
    np.testing.assert_allclose(found.variance.ravel(), wanted.variance, rtol=2e-3)
    np.testing.assert_allclose(found.residual.ravel(), wanted.residual, rtol=0.02, atol=0.02)


def test_slopes_come_nearer_to_the_truth(response, frame):
    """And would not without the depth, which the color tells of too."""
    change, read, true = frame
    found = SteppedSlopes(response, SHAPE, UNTOUCHED)(change, read).gradients
    off = [np.sqrt(np.mean((one - true) ** 2)) for one in (read, found)]
    assert off[1] < 0.5 * off[0]
    blind = replace(response, nodes=response.nodes * (np.arange(TERMS) < TERMS - 3)[:, None])
    without = SteppedSlopes(blind, SHAPE, UNTOUCHED)(change, read).gradients
    assert np.sqrt(np.mean((without - true) ** 2)) > 1.8 * off[1]


@pytest.mark.parametrize("stepless", [True, False])
def test_without_a_response_or_its_prior_no_step_is_taken(response, frame, stepless):
    """The depth is there all the same: a forward response is fitted with it."""
    change, read, _ = frame
    plain = SteppedSlopes(replace(response, step_sigma=None) if stepless else None, SHAPE, UNTOUCHED)
    assert not plain.steps
    assert plain(change, read) is None
    np.testing.assert_array_equal(plain.depth_px(change, read), full_depth(change, read))


def test_what_is_hidden_does_not_reach_the_steps_around_it(response, frame):
    """Its slopes would be in the depth of the whole frame, and that in all steps."""
    change, read, _ = frame
    hidden = np.zeros(SHAPE, dtype=bool)
    hidden[40:52, 20:32] = True
    garbled = read.copy()
    garbled[hidden] = 3.0
    stepped = SteppedSlopes(response, SHAPE, UNTOUCHED)
    plain, guarded, open_ = stepped(change, read), stepped(change, garbled, hidden), stepped(change, garbled)
    apart = [np.abs(one.gradients - plain.gradients)[~hidden].max() for one in (guarded, open_)]
    assert apart[0] < 0.1 * apart[1]
    assert apart[0] < 0.003 < 0.02 < apart[1]
    np.testing.assert_array_equal(
        stepped.depth_px(change, garbled, hidden), full_depth(change, garbled, hidden)
    )


def test_clipped_channels_say_nothing_to_a_step(response, frame):
    change, read, true = frame
    clipped = np.zeros((*SHAPE, 3), np.uint8)
    clipped[30:50, 60:80, 2] = 1
    dark = change.copy()
    dark[clipped > 0] = -0.5
    darker = dark - np.float32(0.3) * clipped
    stepped = SteppedSlopes(response, SHAPE, UNTOUCHED)
    known, other = stepped(dark, read, None, clipped), stepped(darker, read, None, clipped)
    where = clipped[..., 2] > 0
    np.testing.assert_allclose(known.gradients[where], other.gradients[where], atol=1e-5)
    off = [np.sqrt(np.mean((one.gradients - true)[where] ** 2)) for one in (known, stepped(dark, read))]
    assert off[0] < 0.3 * off[1]
