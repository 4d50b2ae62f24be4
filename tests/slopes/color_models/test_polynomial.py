"""Hierarchical polynomial: exact where it can be, simple where nothing is known, the light as a clue."""

import gc
from dataclasses import replace
from weakref import ref

import cv2
import numpy as np
import pytest

from gelform.foundations.checks import HIGHEST_SLOPE
from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.slopes.color_models import HierarchicalModel, PolynomialModel, polynomial
from gelform.slopes.color_models.seam import VaryingRegression, monomial_parents, monomials, node_positions
from kernel_agreement import assert_kernel_agrees
from made.images import SHAPE, ball_samples, lambertian_change, part_of, shading_change

pytestmark = pytest.mark.linear_algebra


def rms(model, samples):
    found = model.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    return np.sqrt(np.mean((found - samples.gradients) ** 2))


def at_few_places(samples, count=6, seed=0):
    """The samples within 6 px of a few places, as few presses give."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(5, SHAPE[1] - 5, count), rng.uniform(5, SHAPE[0] - 5, count)
    near = (np.hypot(samples.x_px[:, None] - x, samples.y_px[:, None] - y) < 6).any(axis=1)
    return part_of(samples, near)


def test_few_presses_leave_less_error_elsewhere_than_in_a_free_polynomial():
    few = at_few_places(ball_samples(shading_change, count=8000))
    noise = 0.02 * np.random.default_rng(1).normal(size=few.color_change.shape)
    few = replace(few, color_change=few.color_change + noise)
    unseen = ball_samples(shading_change, seed=5)
    free = PolynomialModel.fit(few, position_degrees=(5, 4, 3))
    assert rms(HierarchicalModel.fit(few), unseen) < 0.5 * rms(free, unseen)


def test_the_light_tells_what_the_place_does_not():
    """Color that weakens with the light, unlike any polynomial of the place: stripes."""
    wide = (96, 128)
    stripes = 80 * (1 + 0.6 * np.sign(np.sin(np.arange(wide[1]) // 2 / 6.0)))
    background = np.broadcast_to(stripes[:, None], (*wide, 3)).astype(np.float32)
    smooth = cv2.GaussianBlur(background, (0, 0), 8.0)[48, :, 0]

    def change(gradients, x, y):
        light = np.log(smooth[np.clip(2 * x, 0, wide[1] - 1).astype(int)])[:, None]
        mixed = gradients @ np.array([[1.0, 0.2, -0.7], [0.1, 0.9, 0.8]])
        return mixed / (1 + 0.3 * light / light.mean())

    samples, unseen = (ball_samples(change, seed=s) for s in (0, 6))
    samples, unseen = (replace(s, x_px=2 * s.x_px, y_px=2 * s.y_px, shape=wide) for s in (samples, unseen))
    settings = {"position_degrees": (1,), "ridge": 1e-6}
    without = rms(HierarchicalModel.fit(samples, **settings), unseen)
    known = rms(HierarchicalModel.fit(replace(samples, background=background), **settings), unseen)
    assert known < 0.6 * without


def test_colors_far_beyond_the_presses_are_no_steep_slopes():
    """Slopes of 0.8 were shown: three times their color is a slope of at most 1.6, and what it is more is its deviation."""
    samples = ball_samples(shading_change)
    model = HierarchicalModel.fit(samples, ridge=1e-6)
    steepest = 2 * np.linalg.norm(samples.gradients, axis=1).max()
    assert model.steepest == pytest.approx(steepest)
    change = np.zeros((*SHAPE, 3), np.float32)
    change[10, 20], change[30, 40] = samples.color_change[0], 3 * samples.color_change[0]
    free, none = replace(model, steepest=HIGHEST_SLOPE).prepare(change, SHAPE).gradients_from_color(change)
    found, deviation = model.prepare(change, SHAPE).gradients_from_color(change)
    assert none is None
    size = np.linalg.norm(free[30, 40])
    assert size > 1.2 * steepest, "the test's color has to be off"
    np.testing.assert_allclose(found[30, 40], free[30, 40] * steepest / size, rtol=1e-5)
    np.testing.assert_allclose(deviation[30, 40], size - steepest, rtol=1e-5)
    np.testing.assert_array_equal(found[10, 20], free[10, 20])
    assert np.count_nonzero(deviation) == 2
    at = model.gradients_at(change[30, 40][None], np.array([40]), np.array([30]))
    np.testing.assert_allclose(at[0], found[30, 40], rtol=1e-4)


def test_the_bound_is_kept_and_a_start_may_raise_it():
    samples = ball_samples(lambertian_change)
    model = HierarchicalModel.fit(samples)
    arrays, settings = model.to_arrays()
    assert HierarchicalModel.from_arrays(arrays, settings).steepest == model.steepest
    settings.pop("steepest")
    assert HierarchicalModel.from_arrays(arrays, settings).steepest == HIGHEST_SLOPE, "older files have none"
    gentle = replace(samples, gradients=0.1 * samples.gradients)
    assert HierarchicalModel.fit(gentle, start=model).steepest == model.steepest
    assert HierarchicalModel.fit(samples, start=HierarchicalModel.fit(gentle)).steepest == model.steepest
    wider = model.of_other_unit(np.ones((*model.nodes.shape[:2], 3)), 1.1)
    assert wider.steepest == model.steepest


def kernel_arguments(shape, degree, seed=0):
    """A color change, coefficients at nodes and which monomial comes from which, as the kernels take them."""
    rng = np.random.default_rng(seed)
    terms = monomials(3, degree)
    grid = (len(axis) for axis in node_positions(shape))
    nodes = rng.normal(0, 1, (*grid, len(terms), 2)).astype(np.float32)
    change = rng.normal(0, 0.3, (*shape, 3)).astype(np.float32)
    work = np.empty((2 * nodes.shape[1] + 4) * len(terms) + 5 * (shape[1] + 15), dtype=np.float32)
    return change, nodes, monomial_parents(terms), work, np.empty((*shape, 2), dtype=np.float32)


def slopes(change, nodes, degree):
    """Gradients by the model's own formula for scattered pixels."""
    height, width, _ = change.shape
    y, x = (axis.ravel() for axis in np.mgrid[:height, :width])
    model = HierarchicalModel(nodes.astype(np.float64), degree, (height, width))
    return model.gradients_at(change.reshape(-1, 3), x, y).reshape(height, width, 2)


@pytest.mark.parametrize("shape", [(1, 1), (5, 16), (17, 17), (33, 50), (40, 321)])
@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_the_kernel_agrees_with_numpy(shape, degree):
    """Sizes of which the last pixel lies on the last node included."""
    arguments = kernel_arguments(shape, degree)
    assert_kernel_agrees(
        polynomial._hierarchical_gradients,
        lambda change, nodes, parents, work, out, most: slopes(change, nodes, degree),
        *arguments, 1.0,
    )  # fmt: skip
    steepest = np.abs(slopes(*arguments[:2], degree)).max()
    for most, beyond in ((0.999 * steepest, 1), (1.001 * steepest, 0)):
        assert polynomial._hierarchical_gradients(*arguments, most) == beyond


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_one_pass_gives_what_two_give(dtype):
    shape = (33, 50)
    rng = np.random.default_rng(3)
    image = rng.integers(0, 256, (*shape, 3)).astype(dtype)
    rest = rng.uniform(50, 200, (*shape, 3)).astype(np.float32)
    pending = PreparedBackground(rest, ChangeSettings(blur_px=1.25)).pending(image, None)
    _, nodes, parents, work, out = kernel_arguments(shape, 3)
    two = pending.write(np.empty((*shape, 3), np.float32))
    assert_kernel_agrees(
        polynomial._hierarchical_from_image,
        lambda *_: (two, slopes(two, nodes, 3)),
        *pending.arguments, nodes, parents, np.empty(work.size + pending.work_size, np.float32), two.copy(), out, 1.0,
    )  # fmt: skip
    ready = HierarchicalModel(nodes.astype(float), 3, shape).prepare(rest, shape)
    change = np.empty((*shape, 3), np.float32)
    found, _ = ready.gradients_in_one_pass(pending, change)
    np.testing.assert_array_equal(found, ready.gradients_from_color(two)[0])
    np.testing.assert_array_equal(change, two)


def test_a_start_is_corrected_by_what_it_does_not_explain():
    """Another unit's slopes are a fifth too small: what the presses add is the missing fifth, not all of it again."""
    samples = ball_samples(lambertian_change)
    whole = HierarchicalModel.fit(samples, ridge=1e-6)
    start = replace(whole, nodes=0.8 * whole.nodes)
    assert rms(start, samples) > 0.05
    assert rms(HierarchicalModel.fit(samples, start=start), samples) < 0.001
    held = HierarchicalModel.fit(samples, start=start, ridge=1e6)
    np.testing.assert_allclose(held.nodes, start.nodes, atol=1e-3)


def test_fits_one_after_the_other_are_those_of_each_alone():
    """What is worked out for one ridge is there for the next, and for nothing else."""
    samples = ball_samples(lambertian_change)
    turned = replace(samples, gradients=-samples.gradients)
    lighter = replace(samples, weight=samples.weight * np.linspace(0.1, 1, len(samples.weight)))
    moved = replace(samples, x_px=samples.x_px[::-1].copy())
    first = HierarchicalModel.fit(part_of(samples), position_degrees=(2, 1))
    start = replace(first, nodes=0.5 * first.nodes)
    asked = [((2, 1), 1e-3, None), ((2, 1), 1e-5, None), ((2, 1), 1e-5, start), ((1,), 1e-3, None)]
    for one in (samples, turned, samples, lighter, moved, samples):
        for degrees, ridge, begun in asked:
            how = {"position_degrees": degrees, "ridge": ridge, "start": begun}
            found, alone = (HierarchicalModel.fit(given, **how) for given in (one, part_of(one)))
            np.testing.assert_array_equal(found.nodes, alone.nodes)


def test_columns_are_worked_out_once_and_end_with_their_samples(monkeypatch):
    made, of = [], VaryingRegression.of
    monkeypatch.setattr(VaryingRegression, "of", lambda *given: made.append(of(*given)) or made[-1])
    samples = part_of(ball_samples(lambertian_change))
    for ridge in (1e-3, 1e-4):
        HierarchicalModel.fit(samples, position_degrees=(2, 1), ridge=ridge)
    assert len(made) == 1
    there = ref(made.pop())
    del samples
    gc.collect()
    assert there() is None


def test_each_variant_is_stiffer_than_the_next():
    ridges = [variant["ridge"] for variant in HierarchicalModel.variants(20)]
    assert ridges == sorted(ridges, reverse=True)
    with pytest.raises(ValueError, match="ridge > 0"):
        HierarchicalModel.fit(ball_samples(lambertian_change), ridge=0)
