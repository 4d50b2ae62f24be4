"""Polynomial: exact on its own law, follows lights that turn over the image."""

import numpy as np
import pytest

from gelform.slopes.color_models import PolynomialModel, Samples, polynomial
from gelform.slopes.color_models._shared.least_squares import monomial_products, monomials, term_count
from kernel_agreement import assert_kernel_agrees
from made.color_samples import SHAPE, ball_samples, lambertian_change, shading_change

pytestmark = pytest.mark.linear_algebra


def test_it_follows_lights_that_turn_over_the_image():
    unseen = ball_samples(shading_change, seed=4)
    errors = {}
    for degrees in ((0,), (4, 3, 1)):
        model = PolynomialModel.fit(ball_samples(shading_change), position_degrees=degrees)
        found = model.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
        errors[degrees] = np.sqrt(np.mean((found - unseen.gradients) ** 2))
    assert errors[(4, 3, 1)] < 0.03
    assert errors[(4, 3, 1)] < 0.3 * errors[(0,)]


def test_it_recovers_a_polynomial_exactly():
    rng = np.random.default_rng(5)
    degrees = (5, 3, 1)
    truth = PolynomialModel(rng.normal(size=(term_count(3, degrees), 2)), degrees, SHAPE)
    samples = ball_samples(lambertian_change, count=3000)
    gradients = truth.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    samples = Samples(samples.color_change, samples.x_px, samples.y_px, gradients, samples.weight, SHAPE)
    model = PolynomialModel.fit(samples, position_degrees=degrees, ridge=1e-13)
    np.testing.assert_allclose(
        model.gradients_at(samples.color_change, samples.x_px, samples.y_px), gradients, rtol=1e-4, atol=1e-4
    )


def test_bad_settings_are_refused():
    with pytest.raises(ValueError, match="position degrees"):
        PolynomialModel.fit(ball_samples(lambertian_change), position_degrees=(9,))


@pytest.mark.parametrize(
    ("presses", "largest"),
    [
        *[(2, (1,)), (5, (1,)), (6, (2, 1)), (8, (2, 1)), (9, (3, 2, 0)), (17, (3, 2, 0))],
        *[(18, (4, 3, 1)), (29, (4, 3, 1)), (30, (5, 4, 3))],
    ],
)
def test_more_presses_carry_more_terms(presses, largest):
    variants = PolynomialModel.variants(presses)
    assert variants[0] == {"position_degrees": (1,)}
    assert variants[-1] == {"position_degrees": largest}
    sizes = [
        len(PolynomialModel.fit(ball_samples(lambertian_change), **one).coefficients) for one in variants
    ]
    assert sizes == sorted(set(sizes)), "the simplest first"


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


def test_the_coefficients_at_a_place_give_its_gradients():
    rng = np.random.default_rng(2)
    model = PolynomialModel(rng.normal(size=(term_count(3, (3, 2, 1)), 2)), (3, 2, 1), SHAPE)
    change, x, y = rng.normal(size=(20, 3)), rng.uniform(0, 63, 20), rng.uniform(0, 47, 20)
    products = np.stack(monomial_products(change.T, monomials(3, model.degree)))
    found = np.einsum("tn,ntk->nk", products, model.coefficients_at(x, y))
    np.testing.assert_allclose(found, model.gradients_at(change, x, y))
