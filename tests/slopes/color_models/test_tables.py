"""The lookup table: a multilinear law is met, smooth at zero, honest off its gamut. Interpolation: exact on a line,
close on shading, and it knows when it is far from its samples.
"""

from dataclasses import replace

import numpy as np
import pytest

from gelform.slopes.color_models import InterpolationModel, Samples
from gelform.slopes.color_models.tables import Lattice, LookupModel, corner_weights, held_out_residuals
from gelform.slopes.gradients import STEEPEST_GEL
from made.images import SHAPE, ball_samples, lambertian_change, part_of, shading_change

FLAT = np.full((*SHAPE, 3), 100, dtype=np.float32)


def linear_samples(count=4000, seed=0, noise=0.0):
    """Slopes that are linear in color, the more so to the right: multilinear in color and place."""
    rng = np.random.default_rng(seed)
    change = rng.uniform(-0.3, 0.4, (count, 3))
    x, y = rng.uniform(0, SHAPE[1] - 1, count), rng.uniform(0, SHAPE[0] - 1, count)
    gradients = change @ np.array([[1.0, 0.2], [-0.4, 0.8], [0.1, -0.9]]) * (1 + x / SHAPE[1])[:, None]
    gradients += noise * rng.standard_normal(gradients.shape)
    return Samples(change, x, y, gradients, np.ones(count), SHAPE)


def gradients_of(model, samples):
    return model.gradients_at(samples.color_change, samples.x_px, samples.y_px)


def test_a_multilinear_law_is_met():
    model = LookupModel.fit(linear_samples(), nodes=8, positions=(2, 2), smoothness=1e-6)
    unseen = linear_samples(seed=1)
    inside = part_of(unseen, (np.abs(unseen.color_change - 0.05) < 0.33).all(axis=1))
    off = gradients_of(model, inside) - inside.gradients
    assert np.sqrt(np.mean(off**2)) < 0.01
    assert np.quantile(np.abs(off), 0.99) < 0.03


def test_zero_is_exact_and_smooth():
    model = LookupModel.fit(ball_samples(shading_change), positions=(2, 2))
    place = np.array([10.0]), np.array([30.0])
    assert np.abs(model.gradients_at(np.zeros((1, 3)), *place)).max() == 0
    red, green, blue = np.rint(-model.low / model.step).astype(int)
    np.testing.assert_allclose(model.low + model.step * (red, green, blue), 0, atol=1e-12)
    assert np.abs(model.table[:, :, red, green, blue, :2]).max() == 0
    for direction in np.eye(3):
        up, down = (model.gradients_at(s * 1e-3 * direction[None], *place) for s in (1, -1))
        assert np.linalg.norm(up) > 1e-4
        np.testing.assert_allclose(up, -down, atol=0.35 * np.linalg.norm(up))


def test_empty_corners_follow_their_neighbors_and_are_marked():
    """A slab of red that no sample had: the fill goes on as the samples did, and says that it is a guess."""
    samples = linear_samples(6000)
    red = samples.color_change[:, 0]
    model = LookupModel.fit(part_of(samples, (red < 0.0) | (red > 0.25)), nodes=15, positions=(1, 2))
    gap = part_of(samples, (red > 0.1) & (red < 0.15))
    error = gradients_of(model, gap) - gap.gradients
    assert np.sqrt(np.mean(error**2)) < 0.25 * np.sqrt(np.mean(gap.gradients**2))
    prepared = model.prepare(FLAT, SHAPE)
    inside, outside = (np.full((*SHAPE, 3), (r, 0.05, 0.05), dtype=np.float32) for r in (0.125, -0.1))
    assert prepared.gradients_from_color(inside)[1].min() > 0.5 * STEEPEST_GEL
    assert prepared.gradients_from_color(outside)[1].max() < 0.1


def test_off_gamut_colors_have_a_large_deviation():
    model = LookupModel.fit(ball_samples(lambertian_change), positions=(1, 1))
    prepared = model.prepare(FLAT, SHAPE)
    at_home = lambertian_change(np.full((SHAPE[0] * SHAPE[1], 2), 0.3), None, None).reshape(*SHAPE, 3)
    assert prepared.gradients_from_color(at_home.astype(np.float32))[1].max() < 0.1
    odd = np.zeros((*SHAPE, 3), dtype=np.float32) + np.array([0.6, 0.6, 0.6], dtype=np.float32)
    assert prepared.gradients_from_color(odd)[1].min() > 0.5 * STEEPEST_GEL
    assert np.isfinite(prepared.gradients_from_color(odd * 100)[0]).all()


def test_deviation_is_that_of_the_noise():
    for noise in (0.02, 0.1):  # of samples that were not fitted: more than the noise
        samples = linear_samples(1500, noise=noise)
        found = LookupModel.fit(samples, nodes=6, positions=(2, 2)).table[..., 2]
        assert noise < np.median(found[found < STEEPEST_GEL]) < 1.6 * noise


def test_settings_out_of_range():
    for model, settings, said in (
        (LookupModel, {"nodes": 3}, "Expected at least 4 nodes"),
        (LookupModel, {"positions": (0, 2)}, "Expected at least 4 nodes"),
        (InterpolationModel, {"points": 3}, "points >= 16"),
        (InterpolationModel, {"place_scale": 0.0}, "place_scale > 0"),
    ):
        with pytest.raises(ValueError, match=said):
            model.fit(linear_samples(100), **settings)


def test_the_table_spans_the_colors_and_one_wild_press_is_no_larger_doubt():
    samples = linear_samples(3000)
    gradients = np.array(samples.gradients)
    gradients[1000:1200] += 40.0
    model = LookupModel.fit(replace(samples, gradients=gradients), positions=(1, 1))
    span = model.step * (model.table.shape[2] - 1) / 0.7
    assert span.min() > 0.99
    assert span.max() < 1.15
    assert model.table[..., 2].max() <= STEEPEST_GEL


SIZES = (2, 1, 5, 5, 5)
ZERO = (1, 2, 3)
LAW = np.array([[0.3, -0.1], [0.2, 0.4], [-0.2, 0.1]])


def samples(count=3000, seed=0):
    """Positions on the five axes, in nodes, and slopes that are linear in the last three."""
    rng = np.random.default_rng(seed)
    at = [rng.uniform(0, size - 1, count) for size in SIZES]
    return at, (np.stack(at[2:], axis=1) - ZERO) @ LAW


def test_corner_weights_are_multilinear():
    at, _ = samples()
    corners = corner_weights(at, SIZES)
    np.testing.assert_allclose(corners.sum(axis=1), 1)
    nodes = np.stack(np.unravel_index(np.arange(np.prod(SIZES)), SIZES), axis=1)
    np.testing.assert_allclose(corners @ nodes, np.stack(at, axis=1), atol=1e-12)
    places = [3, 0, -2, 9, 1], [1, 0, 0, 4, 1]  # beyond the grid the nearest face counts
    beyond, face = (corner_weights([np.array([v]) for v in at], SIZES) for at in places)
    np.testing.assert_array_equal(beyond.toarray(), face.toarray())


def test_residuals_are_those_of_samples_that_were_not_fitted():
    """Noise that is the same within a stretch: a fit that had seen it would follow it a little."""
    at, target = samples()
    noise = np.random.default_rng(1).normal(0, 0.05, target.shape)
    lattice, corners = Lattice(SIZES, ZERO, smoothness=0.02), corner_weights(at, SIZES)
    weight = np.ones(len(target))
    held_out = held_out_residuals(lattice, corners, target + noise, weight)
    seen = corners @ lattice.fitted(corners, target + noise, weight) - target - noise
    assert np.std(held_out) == pytest.approx(0.05, rel=0.15)
    assert np.std(held_out) > np.std(seen)


def test_nodes_without_samples_follow_the_others_and_outliers_count_little():
    """All samples lie on the upper row of nodes; the lower one has only its neighbors to go by."""
    at, target = samples()
    corners, lattice = corner_weights([0 * at[0], *at[1:]], SIZES), Lattice(SIZES, ZERO, smoothness=1e-2)
    plain = lattice.fitted(corners, target, np.ones(len(target))).reshape(*SIZES, 2)
    np.testing.assert_allclose(plain[1], plain[0], atol=0.03)
    wild = np.array(target)
    wild[::20] += 5.0
    robust = lattice.fitted(corners, wild, np.ones(len(target))).reshape(*SIZES, 2)
    assert np.sqrt(np.mean((robust - plain) ** 2)) < 0.1  # a mean would be moved by 0.25


MATRIX = np.array([[1.0, 0.2, -0.7], [0.1, 0.9, 0.8]])


@pytest.mark.linear_algebra
def test_a_line_is_exact():
    model = InterpolationModel.fit(ball_samples(lambda g, x, y: g @ MATRIX))
    unseen = ball_samples(lambda g, x, y: g @ MATRIX, seed=1, count=500)
    np.testing.assert_allclose(gradients_of(model, unseen), unseen.gradients, atol=2e-3)


@pytest.mark.linear_algebra
def test_far_from_the_samples_the_slope_is_doubted():
    model = InterpolationModel.fit(ball_samples(shading_change))
    seen = ball_samples(shading_change, seed=2, count=300)
    _, inside = model.gradients_and_sigma_at(seen.color_change, seen.x_px, seen.y_px)
    _, outside = model.gradients_and_sigma_at(5 * seen.color_change + 1, seen.x_px, seen.y_px)
    assert np.median(outside) > 10 * np.median(inside)
    assert inside.min() >= 0


@pytest.mark.linear_algebra
def test_gray_levels_of_another_size_give_the_same_slopes():
    """How near a sample is in color is judged by the samples' own range."""
    samples, unseen = ball_samples(shading_change), ball_samples(shading_change, seed=1, count=300)
    wider, wide = (replace(one, color_change=8 * one.color_change) for one in (samples, unseen))
    found = gradients_of(InterpolationModel.fit(wider, points=500), wide)
    np.testing.assert_allclose(
        found, gradients_of(InterpolationModel.fit(samples, points=500), unseen), atol=1e-6
    )


@pytest.mark.linear_algebra
def test_what_the_neighbors_do_not_say_is_taken_from_all():
    """All colors near one place along red: how slopes go with blue there, the others tell."""
    samples = ball_samples(lambda g, x, y: g @ MATRIX)
    model = InterpolationModel.fit(samples)
    blue = np.array([[0.0, 0.0, 0.3]] * 200)
    rng = np.random.default_rng(0)
    found = model.gradients_at(blue, rng.uniform(0, 63, 200), rng.uniform(0, 47, 200))
    np.testing.assert_allclose(found, blue @ model.line, atol=0.02)
