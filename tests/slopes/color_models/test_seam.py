"""The seam, asked of every model in COLOR_MODELS: no change no slope, frames equal pixels, saved arrays, variants.
Polynomial: exact on its own law, follows lights that turn over the image. Regressions that color models share, and the
terms they are made of.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cache
from types import GenericAlias
from typing import Any, ClassVar, Literal

import numpy as np
import pytest
from numpy.typing import NDArray

from gelform.slopes.color_models import COLOR_MODELS, IMPORTED_MODELS, PolynomialModel, polynomial
from gelform.slopes.color_models.seam import (
    MAX_SAMPLES,
    NODE_PX,
    ORDER_GROWTH,
    PLACE_GROWTH,
    Stored,
    Term,
    VaryingRegression,
    at_pixels,
    check_image_shape,
    interpolation,
    light_at_nodes,
    monomial_products,
    monomials,
    node_positions,
    nodes_at_scale,
    polynomial_terms,
    position_powers,
    robust_ridge,
    term_count,
    terms_of_orders,
    unit_position,
)
from kernel_agreement import assert_kernel_agrees
from made.images import SHAPE, ball_samples, lambertian_change, shading_change


def fitted(name, samples, **settings):
    """A fitted model; where it takes torch to train, a test of it is skipped without."""
    if name == "mlp":
        pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
        settings = {"steps": 200, **settings}
    return COLOR_MODELS[name].fit(samples, **settings)


@cache
def model_of(name):
    """Fitted to lights that turn over the image; once for all tests."""
    return fitted(name, ball_samples(shading_change))


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_a_frame_equals_its_pixels_one_by_one_and_no_color_change_means_no_slope(name):
    model = model_of(name)
    change = np.random.default_rng(1).uniform(-0.3, 0.3, (*SHAPE, 3)).astype(np.float32)
    change[::5] = 0
    frame, _ = model.prepare(np.full((*SHAPE, 3), 100, np.float32), SHAPE).gradients_from_color(change)
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    pixels = model.gradients_at(change.reshape(-1, 3), x, y)
    np.testing.assert_allclose(frame.reshape(-1, 2), pixels, atol=2e-5)
    np.testing.assert_allclose(frame[::5], 0, atol=1e-6)


# RMS of the slopes of unseen pixels; without the place a cubic is off by 0.018 and a table by 0.014.
FOLLOWED = {"polynomial": 0.001, "hierarchical": 0.003, "interpolation": 0.012, "mlp": 0.025, "lookup": 0.005}


@pytest.mark.linear_algebra
@pytest.mark.parametrize("name", FOLLOWED)
def test_lights_that_turn_over_the_image_are_followed(name):
    unseen = ball_samples(shading_change, seed=4)
    found = model_of(name).gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
    assert np.sqrt(np.mean((found - unseen.gradients) ** 2)) < FOLLOWED[name]


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_saved_arrays_give_the_same_model(name):
    model = model_of(name)
    again = COLOR_MODELS[name].from_arrays(*model.to_arrays())
    samples = ball_samples(shading_change, seed=2)
    at = samples.color_change, samples.x_px, samples.y_px
    np.testing.assert_array_equal(again.gradients_at(*at), model.gradients_at(*at))


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_for_images_of_three_times_as_many_pixels_a_place_is_read_as_in_the_small_ones(name):
    model, samples = model_of(name), ball_samples(shading_change, seed=2)
    large = model.at_size((3 * SHAPE[0], 3 * SHAPE[1]), 1 / 3)
    x, y = 3 * samples.x_px + 1, 3 * samples.y_px + 1  # the middle of nine pixels
    expected = model.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    np.testing.assert_allclose(large.gradients_at(samples.color_change, x, y), expected, atol=2e-3)


@dataclass(frozen=True, eq=False)
class Record(Stored):
    nodes: NDArray[np.float64]
    shape: tuple[int, int]
    mask: NDArray[np.bool_] | None = None
    sigma: tuple[float, float] | None = None
    gain: Literal["none", "some"] = "none"

    name: ClassVar[str] = "record"


@pytest.mark.parametrize("more", [{}, {"mask": np.eye(2, dtype=bool), "sigma": (0.5, 2.0), "gain": "some"}])
def test_a_record_comes_back_from_a_file_with_its_types(more):
    record = Record(np.arange(3.0), (24, 32), **more)
    arrays, settings = record.to_arrays()
    assert arrays.keys() == {"nodes", *(["mask"] if more else [])}
    assert settings == {"shape": [24, 32], "sigma": (more and [0.5, 2.0]) or None, "gain": record.gain}
    again = Record.from_arrays(arrays, json.loads(json.dumps(settings)))
    assert (again.shape, again.sigma, again.gain) == (record.shape, record.sigma, record.gain)
    np.testing.assert_array_equal(again.nodes, record.nodes)
    np.testing.assert_array_equal(again.mask, record.mask)


def test_arrays_are_known_where_their_type_is_an_alias(monkeypatch):
    """As numpy has it from 2.5 on: `NDArray[...]` has an origin of its own, whose `__value__` is the array."""

    class Alias:
        __value__ = np.ndarray[Any, np.dtype[np.float64]]
        __class_getitem__ = classmethod(GenericAlias)

    monkeypatch.setitem(Record.__annotations__, "nodes", Alias[np.float64])
    monkeypatch.setitem(Record.__annotations__, "mask", Alias[np.bool_] | None)
    record = Record(np.arange(3.0), (24, 32), np.eye(2, dtype=bool))
    arrays, settings = record.to_arrays()
    assert arrays.keys() == {"nodes", "mask"}
    np.testing.assert_array_equal(
        Record.from_arrays(arrays, json.loads(json.dumps(settings))).nodes, record.nodes
    )


def test_a_file_may_lack_what_has_a_default_and_nothing_else():
    assert Record.from_arrays({"nodes": np.zeros(2)}, {"shape": [1, 2]}).gain == "none"
    with pytest.raises(KeyError, match="nodes"):
        Record.from_arrays({}, {"shape": [1, 2]})
    with pytest.raises(KeyError, match="shape"):
        Record.from_arrays({"nodes": np.zeros(2)}, {"gain": "some"})


@pytest.mark.parametrize("shape", [[24], [24, 32, 3], 24, "ab", None])
def test_a_tuple_of_another_length_or_kind_is_refused(shape):
    with pytest.raises(TypeError, match="shape"):
        Record.from_arrays({"nodes": np.zeros(2)}, {"shape": shape})


@pytest.mark.parametrize("name", COLOR_MODELS)
def test_variants_are_settings_of_its_fit(name):
    samples = ball_samples(shading_change)
    for presses in (2, 10, 20, 100):
        variants = COLOR_MODELS[name].variants(presses)
        assert variants
        assert all(variants.count(one) == 1 for one in variants)
    for variant in variants:
        fitted(name, samples, **variant)


def test_models_are_listed_under_their_own_names():
    for table in (COLOR_MODELS, IMPORTED_MODELS):
        assert all(model.name == name for name, model in table.items())
    assert not COLOR_MODELS.keys() & IMPORTED_MODELS.keys()


@pytest.mark.parametrize("name", [n for n in COLOR_MODELS if n != "lambertian"])  # one law everywhere
def test_images_of_another_size_are_refused(name):
    with pytest.raises(ValueError, match="as calibrated, got 10x10"):
        model_of(name).prepare(np.zeros((10, 10, 3)), (10, 10))
    check_image_shape((48, 64), (48, 64))
    with pytest.raises(ValueError, match="Expected images of 48x64 px, as imported, got 64x48"):
        check_image_shape((64, 48), (48, 64), made="imported")


@pytest.mark.linear_algebra
def test_it_recovers_a_polynomial_exactly():
    rng = np.random.default_rng(5)
    degrees = (5, 3, 1)
    truth = PolynomialModel(rng.normal(size=(term_count(3, degrees), 2)), degrees, SHAPE)
    samples = ball_samples(lambertian_change, count=3000)
    at = samples.color_change, samples.x_px, samples.y_px
    samples = replace(samples, gradients=truth.gradients_at(*at))
    model = PolynomialModel.fit(samples, position_degrees=degrees, ridge=1e-13)
    np.testing.assert_allclose(model.gradients_at(*at), samples.gradients, rtol=1e-4, atol=1e-4)
    with pytest.raises(ValueError, match="position degrees"):
        PolynomialModel.fit(samples, position_degrees=(9,))


@pytest.mark.linear_algebra
@pytest.mark.parametrize(
    ("presses", "largest"),
    [(5, (1,)), (6, (2, 1)), (8, (2, 1)), (9, (3, 2, 0)), (17, (3, 2, 0)), (29, (4, 3, 1)), (30, (5, 4, 3))],
)
def test_more_presses_carry_more_terms(presses, largest):
    variants, samples = PolynomialModel.variants(presses), ball_samples(lambertian_change)
    assert variants[0] == {"position_degrees": (1,)}
    assert variants[-1] == {"position_degrees": largest}
    sizes = [len(PolynomialModel.fit(samples, **one).coefficients) for one in variants]
    assert sizes == sorted(set(sizes)), "the simplest first"


@pytest.mark.linear_algebra
@pytest.mark.parametrize("shape", [(1, 1), (5, 16), (21, 50)])
@pytest.mark.parametrize("degrees", [(0,), (2, 1), (4, 3, 1)])
def test_the_kernel_agrees_with_numpy(shape, degrees):
    rng = np.random.default_rng(0)
    model = PolynomialModel(rng.normal(size=(term_count(3, degrees), 2)), degrees, shape)
    ready = model.prepare(np.zeros((*shape, 3)), shape)
    change = rng.normal(0, 0.3, (*shape, 3)).astype(np.float32)
    y, x = (axis.ravel() for axis in np.mgrid[: shape[0], : shape[1]])
    expected = model.gradients_at(change.reshape(-1, 3), x, y).reshape(*shape, 2)
    assert_kernel_agrees(
        polynomial._polynomial_gradients,
        lambda *_: expected,
        change, ready._x, ready._table, ready._degrees, ready._parents,
        np.empty(6 * (shape[1] + 16), np.float32), np.empty((*shape, 2), np.float32),
    )  # fmt: skip


@pytest.mark.linear_algebra
def test_the_coefficients_at_a_place_give_its_gradients():
    rng = np.random.default_rng(2)
    model = PolynomialModel(rng.normal(size=(term_count(3, (3, 2, 1)), 2)), (3, 2, 1), SHAPE)
    change, x, y = rng.normal(size=(20, 3)), rng.uniform(0, 63, 20), rng.uniform(0, 47, 20)
    products = np.stack(monomial_products(change.T, monomials(3, model.degree)))
    found = np.einsum("tn,ntk->nk", products, model.coefficients_at(x, y))
    np.testing.assert_allclose(found, model.gradients_at(change, x, y))


def test_monomials_are_complete_and_ordered():
    assert monomials(2, 2) == [(0,), (1,), (0, 0), (0, 1), (1, 1)]
    assert len(monomials(3, 3)) == 3 + 6 + 10
    x, y = unit_position(np.array([0.0, 63.0]), np.array([23.5, 23.5]), SHAPE)
    np.testing.assert_allclose([x, y], [[-31.5 / 32, 31.5 / 32], [0, 0]])
    terms = polynomial_terms(np.array([[2.0, 3.0]]), np.array([0.5]), np.array([0.25]), (1, 0))
    np.testing.assert_allclose(terms, [[2, 1, 0.5, 3, 1.5, 0.75, 4, 6, 9]])
    assert terms.shape[1] == term_count(2, (1, 0)) == 9
    assert len(position_powers(3)) == 10


def test_its_answer_makes_hubers_loss_stationary():
    """Weights, a tenth of outliers, two outputs: the derivative by every coefficient is 0; one round is plain."""
    rng = np.random.default_rng(3)
    design, weight = rng.normal(size=(400, 3)), rng.uniform(0.2, 3, 400)
    target = design @ rng.normal(size=(3, 2)) + 0.05 * rng.normal(size=(400, 2))
    target[::10] += rng.normal(size=(40, 2))
    for order in ("C", "F"):
        given = np.asarray(design, order=order)
        found = robust_ridge(given, target, weight, ridge=1e-12, huber=0.1, rounds=60)
        residual = given @ found - target
        share = weight * np.minimum(1, 0.1 / np.linalg.norm(residual, axis=1))
        assert np.abs(given.T @ (share[:, None] * residual)).max() < 1e-4
        plain = robust_ridge(given, target, weight, ridge=1e-12, huber=0.1, rounds=1)
        root = np.sqrt(weight)[:, None]
        np.testing.assert_allclose(plain, np.linalg.lstsq(root * given, root * target)[0], atol=1e-8)


def test_the_light_is_smoothed_alike_in_both_directions():
    background = np.random.default_rng(0).uniform(20, 200, (65, 65, 3)).astype(np.float32)
    turned = light_at_nodes(background.transpose(1, 0, 2))
    np.testing.assert_allclose(turned, light_at_nodes(background).transpose(0, 2, 1), atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (16, 17), (48, 64), (49, 65)])
def test_nodes_reach_beyond_every_pixel(shape):
    """Every 16 px; values that are linear in the place come back at every pixel."""
    rows, columns = node_positions(shape)
    assert rows[-1] >= shape[0] - 1
    assert columns[-1] >= shape[1] - 1
    assert len(rows) > 1 < len(columns)
    assert {*np.diff(rows), *np.diff(columns)} == {NODE_PX}
    y, x = (axis.ravel() for axis in np.mgrid[: shape[0], : shape[1]])
    plane = (2 * rows[:, None] - 3 * columns[None, :] + 5)[..., None].astype(float)
    found = at_pixels(plane, *interpolation(x, y, shape))[:, 0]
    np.testing.assert_allclose(found, 2 * y - 3 * x + 5, atol=1e-9)


def test_terms_of_higher_order_are_stiffer_and_only_the_first_two_vary_with_the_light():
    terms = terms_of_orders([np.ones(3)] * 4, [1, 1, 2, 3], (5, 4, 2))
    assert [term.place_degree for term in terms] == [5, 5, 4, 2]
    assert [term.ridge for term in terms] == [1, 1, ORDER_GROWTH, ORDER_GROWTH**2]
    assert [term.varies_with_light for term in terms] == [True, True, True, False]


@pytest.fixture(scope="module")
def samples():
    return ball_samples(lambertian_change, count=6000)


def law(samples):
    """Two values, of which the second's coefficients change over the image, linearly and squarely; three outputs."""
    x, y = 2 * samples.x_px / (SHAPE[1] - 1) - 1, 2 * samples.y_px / (SHAPE[0] - 1) - 1
    p, q = samples.gradients.T
    return np.stack([p, q * x, q * (0.5 - y) + p], axis=1)


def regression(samples, target, **light):
    terms = [Term(values, 1, 1.0, **light) for values in samples.gradients.T]
    return VaryingRegression.of(terms, target, samples)


def test_a_law_of_its_own_form_comes_back(samples):
    found = regression(samples, law(samples))
    coefficients = found.coefficients(1e-9)
    assert np.abs(found.residual(coefficients)).max() < 1e-4
    nodes = found.nodes(coefficients)
    assert nodes.shape == (*(len(axis) for axis in node_positions(SHAPE)), 2, 3)
    other = ball_samples(lambertian_change, seed=5)
    there = at_pixels(nodes, *interpolation(other.x_px, other.y_px, SHAPE))
    np.testing.assert_allclose(np.einsum("nt,ntk->nk", other.gradients, there), law(other), atol=1e-4)


def test_a_ridge_keeps_simple_what_is_not_shown(samples):
    """What changes over the image goes first, then all of it."""
    found = regression(samples, law(samples))
    free, stiff, still = (found.coefficients(ridge).reshape(2, 3, 3) for ridge in (1e-9, 0.3, 1e3))
    same_everywhere = np.abs(stiff[:, 0]).sum() / np.abs(free[:, 0]).sum()
    varying = np.abs(stiff[:, 1:]).sum() / np.abs(free[:, 1:]).sum()
    assert varying < 0.5 * same_everywhere < 0.5
    assert np.abs(still).max() < 0.01


def test_coefficients_minimize_the_weighted_squares_and_the_penalties(samples):
    """The derivative by every coefficient is 0; a penalty counts as often as the samples do."""
    weighted = replace(samples, weight=np.linspace(0.2, 3, len(samples.x_px)))
    found = regression(weighted, law(weighted) + np.random.default_rng(3).normal(size=(6000, 3)))
    coefficients = found.coefficients(0.01)
    pull = found.columns.T @ (found.weight[:, None] * found.residual(coefficients))
    penalty = 0.01 * found.weight.sum() * found.penalties[:, None] * coefficients
    np.testing.assert_allclose(pull, penalty, atol=1e-4 * np.abs(penalty).max())


def test_columns_are_penalised_by_their_degree_in_place(samples):
    """1, x, y, x^2 ... times 4 per degree; the light's logarithm by its own figure, where it is known."""
    one = VaryingRegression.of([Term(np.ones(6000), 2, 3.0)], law(samples), samples)
    assert sorted(one.penalties) == sorted(3 * PLACE_GROWTH ** np.array([0, 1, 1, 2, 2, 2]))
    background = np.random.default_rng(0).uniform(20, 200, (*SHAPE, 3)).astype(np.float32)
    lit = replace(samples, background=background)
    two = VaryingRegression.of([Term(np.ones(6000), 0, 3.0, True)] * 2, law(samples), lit)
    assert two.penalties.tolist() == [3, *[3 * PLACE_GROWTH] * 3] * 2
    assert two.ends.tolist() == [4, 8]
    flat = replace(samples, shape=(1, SHAPE[1]), y_px=0 * samples.y_px)
    assert np.isfinite(regression(flat, law(flat)).columns).all(), "of a single row"
    unlit = regression(samples, law(samples), varies_with_light=True)
    assert unlit.columns.shape[1] == 6, "of no light nothing varies"


def test_neighbors_are_left_out_where_they_are_many():
    """About 20,000 tell as much."""
    many = ball_samples(lambertian_change, count=3 * MAX_SAMPLES + 5)
    many = replace(many, weight=np.linspace(0.2, 1, len(many.x_px)))
    found = regression(many, law(many))
    assert len(found.columns) == len(found.target) == len(found.weight) == MAX_SAMPLES + 2
    np.testing.assert_array_equal(found.target, law(many)[::3])
    np.testing.assert_array_equal(found.weight, many.weight[::3])
    assert np.abs(found.residual(found.coefficients(1e-9))).max() < 1e-4


@pytest.mark.parametrize("wider", [1.0, 1.25, 0.8])
def test_nodes_at_another_scale_are_read_at_the_same_distance_from_the_middle(wider):
    """Exact where nodes are linear in place, and on the first image's border beyond it."""
    shape = (81, 113)
    rows, columns = node_positions(shape)
    nodes = np.stack(np.meshgrid(columns, rows), axis=-1).astype(float)
    found = nodes_at_scale(nodes, shape, wider)
    middle = np.array([56, 40])
    np.testing.assert_allclose(found, np.clip(middle + wider * (nodes - middle), 0, nodes[-1, -1]), atol=1e-9)
