"""The forward response: fitted to colors, and one step back from it to the slopes."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelform.slopes.color_models import Samples, forward_response
from gelform.slopes.color_models.forward_response import (
    CLIPPED_STEP_SIGMA,
    TERMS,
    ForwardResponse,
    PreparedStep,
)
from gelform.slopes.color_models.seam import node_positions
from kernel_agreement import assert_kernel_agrees

pytestmark = pytest.mark.linear_algebra

SHAPE = (45, 70)
SHAPES = [(1, 1), (2, 3), (5, 16), (17, 17), (33, 50), (40, 321)]  # the last pixel on the last node included
# From three sides: no slope changes all channels alike.
LAMPS = np.array([[1.0, -0.5, -0.5], [0.0, 0.87, -0.87]])
NOISE = 0.004 * np.array([[1.0, 0.0, 0.0], [0.3, 0.9, 0.0], [-0.2, 0.4, 0.8]])  # times independent errors
COVARIANCE = NOISE @ NOISE.T
READ_SIGMA = 0.04, 0.1  # at rest, and per slope


def response(shape=SHAPE, bent=1.0, seed=0):
    """A response that turns over the image; `bent` is how far from linear in the normal it is."""
    rng = np.random.default_rng(seed)
    rows, columns = (axis / max(axis[-1], 1) for axis in node_positions(shape))
    nodes = np.empty((len(rows), len(columns), TERMS, 3))
    nodes[:, :, :2] = 0.1 * LAMPS
    nodes[:, :, 2:14] = bent * rng.normal(0, 1, (12, 3)) * np.repeat([0.01, 0.004, 0.002], [3, 4, 5])[:, None]
    nodes[:, :, 14:] = rng.normal(0, [[0.02], [0.005], [0.005]], (3, 3))
    nodes *= 1 + 0.3 * columns[:, None, None] - 0.2 * rows[:, None, None, None]
    return ForwardResponse(nodes, COVARIANCE, shape, READ_SIGMA)


def pixels(shape):
    """x and y of every pixel, row by row."""
    y, x = (axis.ravel() for axis in np.mgrid[: shape[0], : shape[1]])
    return x, y


def enlarged(depth, shape):
    """A coarse map of the same area at every pixel."""
    for axis, n in enumerate(shape):
        known = depth.shape[axis]
        places = (np.arange(n) + 0.5) * known / n - 0.5
        lines = [np.interp(places, np.arange(known), line) for line in np.moveaxis(depth, axis, -1)]
        depth = np.moveaxis(np.array(lines), -1, axis)
    return depth


def sigma_of(read):
    """Standard deviation of slopes that were read."""
    return np.hypot(READ_SIGMA[0], READ_SIGMA[1] * np.linalg.norm(read, axis=-1))


def scene(forward, noise=1.0, seed=1):
    """Slopes of a frame, those that were read there, the depth in coarse pixels, and the color change they give."""
    rng, (height, width) = np.random.default_rng(seed), forward.shape
    x, y = pixels(forward.shape)
    read = 0.3 * np.stack([np.sin(x / 9 + y / 17), np.cos(x / 13 - y / 8)], axis=-1)
    truth = read + sigma_of(read)[:, None] * rng.normal(size=read.shape)
    depth = rng.uniform(0, 15, (-(-height // 4), -(-width // 4))).astype(np.float32)
    at_pixels = enlarged(depth, forward.shape).ravel()
    change = forward.color_from_gradients(truth, x, y, depth_px=at_pixels)
    change += noise * rng.normal(size=change.shape) @ NOISE.T
    truth, read, change = (one.reshape(height, width, -1) for one in (truth, read, change))
    return truth, read.astype(np.float32), depth, change.astype(np.float32)


def scattered_step(forward, change, read, depth):
    """The step at every pixel of a frame, by the formula for scattered ones."""
    height, width, _ = change.shape
    at, place = enlarged(depth.astype(float), (height, width)).ravel(), pixels((height, width))
    slopes, tiny = read.reshape(-1, 2).astype(float), 1e-5

    def colors(slopes):
        return forward.color_from_gradients(slopes, *place, depth_px=at)

    ahead, behind = ([colors(slopes + s * tiny * axis) for axis in np.eye(2)] for s in (1, -1))
    jacobian = (np.stack(ahead, axis=-1) - np.stack(behind, axis=-1)) / (2 * tiny)
    left, inverse = change.reshape(-1, 3) - colors(slopes), np.linalg.inv(forward.covariance)
    prior = 1 / (forward.step_sigma[0] ** 2 + forward.step_sigma[1] ** 2 * np.sum(slopes**2, axis=1))
    weighted = np.einsum("ncm,ck->nmk", jacobian, inverse)
    information = weighted @ jacobian + prior[:, None, None] * np.eye(2)
    # A millionth of the diagonal keeps the kernel's determinant from 0.
    share = 1e-6 * information[:, 0, 0] * information[:, 1, 1] / np.linalg.det(information)
    covariance = np.linalg.inv(information) * (1 - share)[:, None, None]
    step = (covariance @ (weighted @ left[..., None]))[..., 0]
    step *= np.minimum(1, CLIPPED_STEP_SIGMA / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-9))
    left = left - np.einsum("ncm,nm->nc", jacobian, step)
    variance = np.trace(covariance, axis1=1, axis2=2) / 2
    found = slopes + step, variance, np.einsum("nc,ck,nk->n", left, inverse, left)
    return [part.reshape(height, width, *part.shape[1:]) for part in found]


def mask(shape):
    """Clipped channels: any one of half of the pixels, none of the others, the first among them."""
    channel = np.random.default_rng(6).integers(0, 6, shape)
    channel[0, 0] = 3
    return np.where(channel[:, :, None] == np.arange(3), 255, 0).astype(np.uint8)


def without(forward, channel):
    """The response where a channel says nothing: its error is boundless, and the slopes' prior wide."""
    covariance = forward.covariance.copy()
    covariance[channel, channel] += 1e6
    return replace(forward, covariance=covariance, step_sigma=(CLIPPED_STEP_SIGMA, 0.0))


def frame_step(forward, change, read, depth, clipped):
    """What a frame's step has to be: two steps of the other channels where one is clipped, one of all elsewhere."""
    expected = scattered_step(forward, change, read, depth)
    for channel in range(3 if clipped is not None else 0):
        once = scattered_step(without(forward, channel), change, read, depth)
        twice = scattered_step(without(forward, channel), change, once[0], depth)
        here = clipped[:, :, channel] != 0
        for whole, part in zip(expected, twice):
            whole[here] = part[here]
    return tuple(expected)


def rms(errors):
    return np.sqrt(np.mean(np.square(errors)))


# What it says of colors


def test_noisy_samples_give_the_response_back():
    known, rng, count = response(), np.random.default_rng(3), 12_000

    def drawn():
        slopes, depth = rng.normal(0, 0.3, (count, 2)), rng.uniform(0, 15, count)
        slopes[::4] = 0
        return slopes, rng.uniform(0, SHAPE[1] - 1, count), rng.uniform(0, SHAPE[0] - 1, count), depth

    slopes, x, y, depth = drawn()
    noise = rng.normal(size=(count, 3)) @ NOISE.T
    noise[::4] /= 5  # the gel at rest is not what the covariance is of
    change = known.color_from_gradients(slopes, x, y, depth_px=depth) + noise
    samples = Samples(change, x, y, slopes, np.ones(count), SHAPE, depth_px=depth)
    found, stiffer = ForwardResponse.fit_each(samples, (1e-6, 1.0), step_sigma=READ_SIGMA)
    *unseen, depth = drawn()
    wanted = known.color_from_gradients(*unseen, depth_px=depth)
    assert rms(found.color_from_gradients(*unseen, depth_px=depth) - wanted) < 0.25 * rms(NOISE) * np.sqrt(3)
    assert rms(stiffer.color_from_gradients(*unseen, depth_px=depth) - wanted) > 0.01
    np.testing.assert_allclose(found.covariance, COVARIANCE, atol=0.06 * COVARIANCE.max())
    assert found.step_sigma == READ_SIGMA
    assert found.shape == SHAPE
    at_rest = found.color_from_gradients(np.zeros((count, 2)), *unseen[1:])
    np.testing.assert_array_equal(at_rest, 0)


# One step


@pytest.mark.parametrize(("noise", "share"), [(1.0, 0.3), (0.01, 0.06)])
def test_a_step_brings_slopes_near_those_whose_color_was_seen(noise, share):
    """Without noise only the bend is left."""
    forward = replace(response(), covariance=noise**2 * COVARIANCE)
    truth, read, depth, change = scene(forward, noise)
    stepped = PreparedStep(forward)(change, read, depth)
    assert rms(stepped.gradients - truth) < share * rms(read - truth)


def test_its_variance_is_that_of_its_errors():
    forward = response(bent=0.2)
    truth, read, depth, change = scene(forward)
    stepped = PreparedStep(forward)(change, read, depth)
    ratio = np.mean(np.square(stepped.gradients - truth)) / np.mean(stepped.variance)
    assert ratio == pytest.approx(1, abs=0.1)


def test_the_prior_says_how_far_to_trust_the_reading():
    forward = response()
    truth, read, depth, change = scene(forward)
    sure, usual, vague = (
        PreparedStep(replace(forward, step_sigma=sigma))(change, read, depth)
        for sigma in ((1e-4, 0.0), READ_SIGMA, (0.1, 100.0))
    )
    np.testing.assert_allclose(sure.gradients, read, atol=1e-3)
    np.testing.assert_allclose(sure.variance, 1e-8, rtol=0.01)
    assert (vague.variance > usual.variance).all()
    assert rms(vague.gradients - truth) > rms(usual.gradients - truth)


def test_what_is_left_of_usual_colors_is_chi_square_of_one_degree_of_freedom():
    forward = response(bent=0.2)
    _, read, depth, change = scene(forward)
    left = PreparedStep(forward)(change, read, depth).residual
    # Beside the degree of freedom that no slope explains, a little of what the prior keeps slopes from explaining.
    kept = np.mean(2 * PreparedStep(forward)(change, read, depth).variance / sigma_of(read) ** 2)
    assert kept < 0.2
    assert np.mean(left) == pytest.approx(1 + kept, abs=0.12)
    for share, within in ((0.5, 0.455), (0.9, 2.706), (0.99, 6.635)):
        assert np.mean(left < within * (1 + kept)) == pytest.approx(share, abs=0.05)


# Frames


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("masked", [False, True])
def test_the_kernel_agrees_with_numpy(shape, masked):
    """Steps that are shortened, and pixels of one clipped channel included."""
    rng, forward = np.random.default_rng(4), response(shape, seed=4)
    _, read, depth, change = scene(forward)
    change[rng.uniform(size=shape) < 0.2] += rng.normal(0, 0.2, 3).astype(np.float32)
    clipped = mask(shape) if masked else None
    step = PreparedStep(forward)
    if shape == SHAPES[-1]:
        length = np.linalg.norm(step(change, read, depth).gradients - read, axis=2)
        assert np.isclose(length, CLIPPED_STEP_SIGMA).any()
        assert (length < 0.9 * CLIPPED_STEP_SIGMA).any()
    assert_kernel_agrees(
        forward_response._forward_step,
        lambda change, read, depth, clipped, *_: frame_step(forward, change, read, depth, clipped),
        change, read, depth, clipped, step._nodes, forward.roots,
        np.full(step._work_size, np.nan, np.float32), np.empty_like(read), np.empty(shape, np.float32),
        np.empty(shape, np.float32), *np.square(READ_SIGMA).tolist(), CLIPPED_STEP_SIGMA**-2,
        tolerance=5e-5 if masked else 1e-5,  # two channels tell some slopes badly
    )  # fmt: skip


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_a_clipped_channel_says_nothing_and_the_other_two_enough(channel):
    forward = response(bent=0.5)
    truth, read, depth, change = scene(forward)
    clipped = np.zeros((*SHAPE, 3), np.uint8)
    clipped[3:30, 7:60, channel] = 1
    inside = clipped[:, :, channel] != 0
    wild = change.copy()
    wild[inside, channel] = np.random.default_rng(5).normal(0, 100, inside.sum())
    step = PreparedStep(forward)
    unclipped, found, again = (
        step(*arguments)
        for arguments in ((change, read, depth), (change, read, depth, clipped), (wild, read, depth, clipped))
    )
    for one, other in zip(found, again):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(found, unclipped):
        np.testing.assert_array_equal(one[~inside], other[~inside])
    error = (found.gradients - truth)[inside]
    assert rms(error) < 0.5 * rms((read - truth)[inside])
    assert rms(error) > rms((unclipped.gradients - truth)[inside])
    assert np.mean(np.square(error)) / np.mean(found.variance[inside]) == pytest.approx(1, abs=0.15)
    assert np.abs(step(wild, read, depth).gradients - truth)[inside].mean() > 0.1


def test_slopes_and_depths_of_a_ruined_frame_give_a_finite_step():
    rng = np.random.default_rng(0)
    change = rng.normal(0, 10, (*SHAPE, 3)).astype(np.float32)
    read = rng.normal(size=(*SHAPE, 2)) * 10 ** rng.uniform(-2, 4, (*SHAPE, 1))
    depth_px = rng.uniform(0, 1e5, (11, 17)).astype(np.float32)  # such slopes add up to that
    clipped = (rng.random((*SHAPE, 3)) < 0.1).astype(np.uint8)
    for values in PreparedStep(response())(change, read.astype(np.float32), depth_px, clipped):
        assert np.isfinite(values).all()


def test_a_frame_of_another_size_is_refused():
    forward = response()
    _, read, depth, change = scene(response((60, 90)))
    with pytest.raises(ValueError, match="do not fit"):
        PreparedStep(forward)(change, read, depth)


def test_another_unit_is_read_at_the_same_place_and_depth_in_mm():
    """Its pixels are twice as wide: half the distance from the middle, half the depth in pixels, half the color change."""
    known = response()
    unit = known.of_other_unit(np.full((1, 1, 3), 2.0), 2.0)
    rows, columns = node_positions(SHAPE)
    middle, slopes = (np.array(SHAPE[::-1]) - 1) / 2, np.float64([[0.3, -0.2]])
    x, y = columns[2:3], rows[1:2]  # a node of the unit, so that nothing is interpolated there
    far = middle + 2 * (np.array([x[0], y[0]]) - middle)
    made = known.color_from_gradients(slopes, far[:1], far[1:], depth_px=6.0)
    np.testing.assert_allclose(unit.color_from_gradients(slopes, x, y, depth_px=3.0), made / 2, rtol=1e-9)
    np.testing.assert_allclose(unit.covariance, known.covariance / 4)


def test_for_images_of_more_pixels_a_place_and_a_depth_in_mm_have_the_same_color():
    known = response()
    large = known.at_size((2 * SHAPE[0], 2 * SHAPE[1]), 0.5)
    slopes, at = np.float64([[0.3, -0.2]] * 3), np.float64([16, 17, 20])
    made = known.color_from_gradients(slopes, at, at, depth_px=3.0)
    found = large.color_from_gradients(slopes, 2 * at + 0.5, 2 * at + 0.5, depth_px=6.0)
    np.testing.assert_allclose(found, made, rtol=2e-3)


# Files and mistakes


def test_arrays_make_the_same_response():
    known = replace(response(), residual_scale=1.7, clipped=np.eye(2, 3, dtype=bool))
    for forward in (known, replace(known, clipped=None), replace(known, step_sigma=None)):
        arrays, settings = forward.to_arrays()
        again = ForwardResponse.from_arrays(arrays, json.loads(json.dumps(settings)))
        for part in ("nodes", "covariance", "shape", "step_sigma", "residual_scale", "clipped"):
            np.testing.assert_array_equal(getattr(again, part), getattr(forward, part), err_msg=part)
        assert again.step_sigma == forward.step_sigma


def test_what_is_no_response_is_refused():
    forward = response()
    for wrong in (
        {"nodes": forward.nodes[:, :, 1:]},
        {"nodes": forward.nodes[0]},
        {"nodes": np.full_like(forward.nodes, np.nan)},
        {"covariance": -COVARIANCE},
        {"covariance": np.eye(2)},
        {"covariance": np.zeros((3, 3))},
        {"covariance": np.full((3, 3), np.inf)},
        {"step_sigma": (0.0, 0.1)},
        {"step_sigma": (np.nan, 0.1)},
        {"step_sigma": (0.1, -0.1)},
        {"residual_scale": 0.0},
    ):
        with pytest.raises(ValueError, match="Expected"):
            replace(forward, **wrong)
