"""Steps of whole frames: those of the response at each pixel, with the depth of the slopes that were read."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.depth.coarse import COARSER, coarse_of
from gelform.depth.stepped import CoarseDepth, SteppedSlopes
from gelform.slopes.color_models._shared.least_squares import node_positions
from gelform.slopes.color_models.forward_response import TERMS, ForwardResponse, PreparedStep

SHAPE, UNTOUCHED = (90, 121), 0.02


@pytest.fixture(scope="module")
def response():
    """Lights from three sides, stronger toward the right, and a pressed gel that is brighter."""
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


def test_a_step_is_that_of_the_response_with_the_frames_depth(response, frame):
    change, read, _ = frame
    stepped = SteppedSlopes(response, SHAPE, UNTOUCHED)
    assert stepped.steps
    assert 4 < CoarseDepth(SHAPE, UNTOUCHED).at_pixels(change, read).max() < 5
    depth = CoarseDepth(SHAPE, UNTOUCHED)(change, read)
    for found, wanted in zip(stepped(change, read), PreparedStep(response)(change, read, depth)):
        np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("stepless", [True, False])
def test_without_a_response_or_its_prior_no_step_is_taken(response, frame, stepless):
    change, read, _ = frame
    plain = SteppedSlopes(replace(response, step_sigma=None) if stepless else None, SHAPE, UNTOUCHED)
    assert not plain.steps
    assert plain(change, read) is None


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


ODD = (90, 121)


def bump(shape=ODD, height_px=4.0, width_px=10.0, center=(70, 40)):
    """Depth (H, W), px, and slopes (H, W, 2) of a Gaussian bump, and a color change that is there where it is."""
    y, x = np.mgrid[: shape[0], : shape[1]].astype(float)
    dx, dy = x - center[0], y - center[1]
    depth = height_px * np.exp(-(dx**2 + dy**2) / (2 * width_px**2))
    slopes = np.stack([-dx, -dy], axis=-1) * (depth / width_px**2)[..., None]
    change = np.repeat(np.linalg.norm(slopes, axis=-1, keepdims=True), 3, axis=-1)
    return depth, slopes.astype(np.float32), change.astype(np.float32)


def coarse(values):
    """Means over the coarser grid."""
    return cv2.resize(values, coarse_of(values.shape[:2]).shape[::-1], interpolation=cv2.INTER_AREA)


@pytest.mark.parametrize("shape", [(90, 120), (90, 121), (89, 122)])
def test_the_grid_covers_the_frame(shape):
    (rows, columns), (x_px, y_px) = coarse_of(shape).shape, coarse_of(shape).pitch_px
    assert (rows * y_px, columns * x_px) == pytest.approx(shape)
    assert COARSER <= min(x_px, y_px) <= max(x_px, y_px) < 1.1 * COARSER
    assert (coarse_of((1, 5)).shape, coarse_of((1, 5)).pitch_px) == ((2, 2), (2.5, 0.5)), "the smallest"


@pytest.mark.parametrize("shape", [(90, 120), ODD])
@pytest.mark.parametrize("offset", [0.0, 0.02])
def test_depth_is_that_of_the_slopes_and_0_where_the_gel_is_untouched(shape, offset):
    depth, slopes, change = bump(shape)
    found = CoarseDepth(shape, 0.01)(change + np.float32(offset), slopes + np.float32(offset))
    assert found.shape == coarse_of(shape).shape
    assert found.min() == 0
    np.testing.assert_allclose(found, coarse(depth), atol=0.15)
    assert found.max() == pytest.approx(coarse(depth).max(), rel=0.04)


def test_nothing_is_below_the_untouched_gel_and_what_is_hidden_altogether_is_level():
    """A dent and a bulge: the forward response knows pressed gel, so the bulge is at 0."""
    down, up = bump(center=(30, 40)), bump(center=(90, 45))
    measure = CoarseDepth(ODD, 0.01)
    found = measure(down[2] + up[2], down[1] - up[1])
    np.testing.assert_allclose(found, np.maximum(coarse(down[0] - up[0]), 0), atol=0.25)
    assert found.min() == 0
    assert not measure(down[2], down[1], np.ones(ODD, dtype=bool)).any()


def test_where_all_of_the_gel_is_touched_the_least_changed_is_at_0():
    """Gel that is bent everywhere: no color is as little changed as untouched gel's, and 2 % of them are taken for it."""
    y, x = np.mgrid[: ODD[0], : ODD[1]].astype(float)
    depth = 3 * np.sin(x / 15) * np.cos(y / 20)
    slopes = np.stack([np.cos(x / 15) * np.cos(y / 20) / 5, -0.15 * np.sin(x / 15) * np.sin(y / 20)], axis=-1)
    change = np.concatenate([slopes, np.abs(slopes[..., :1]) + depth[..., None] / 20], axis=-1).astype(
        np.float32
    )
    slopes = slopes.astype(np.float32)
    means = coarse(change)
    size = np.linalg.norm(means - np.median(means, axis=(0, 1)), axis=-1)
    found, known, more = (
        CoarseDepth(ODD, limit)(change, slopes) for limit in (1e-9, *np.quantile(size, [0.02, 0.9]))
    )
    np.testing.assert_allclose(found, known, atol=0.2)
    assert np.abs(found - more).max() > 0.5, "what is guarded against"


def hidden_by(name, shape=ODD):
    """Markers of 7 px, 15 px apart, all over the frame, or a bar over a flank of the bump."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.hypot(x % 15 - 7, y % 15 - 7) < 3.5 if name == "dots" else (x >= 76) & (x < 84)


@pytest.mark.parametrize("name", ["dots", "bar"])
def test_what_hidden_pixels_show_does_not_count(name):
    """Their slopes and colors are anything: the depth is that of what is seen around them."""
    depth, slopes, change = bump()
    hidden, rng = hidden_by(name), np.random.default_rng(0)
    count = np.count_nonzero(hidden)
    garbled, colored = slopes.copy(), change.copy()
    garbled[hidden], colored[hidden] = rng.normal(1, 2, (count, 2)), rng.uniform(-1, 3, (count, 3))
    measure = CoarseDepth(ODD, 0.01)
    found = measure(colored, garbled, hidden)
    np.testing.assert_allclose(found, coarse(depth), atol=0.4)
    assert np.abs(measure(colored, garbled) - coarse(depth)).max() > 2, "what is guarded against"
    other = measure(colored[..., ::-1].copy(), np.where(hidden[..., None], -garbled, garbled), hidden)
    np.testing.assert_allclose(other, found, atol=1e-4)


def test_slopes_and_depths_of_a_ruined_frame_give_a_finite_step(response):
    rng = np.random.default_rng(0)
    change = rng.normal(0, 10, (*SHAPE, 3)).astype(np.float32)
    read = (rng.normal(size=(*SHAPE, 2)) * 10 ** rng.uniform(-2, 4, (*SHAPE, 1))).astype(np.float32)
    depth_px = rng.uniform(0, 1e5, (22, 30)).astype(np.float32)  # such slopes add up to that
    clipped = (rng.random((*SHAPE, 3)) < 0.1).astype(np.uint8)
    for values in PreparedStep(response)(change, read, depth_px, clipped):
        assert np.isfinite(values).all()
