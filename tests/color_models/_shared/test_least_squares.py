"""Regressions that color models share, and the terms they are made of."""

import numpy as np

from gelform.color_models._shared.least_squares import (
    monomials,
    penalised_huber,
    polynomial_terms,
    position_powers,
    robust_ridge,
    term_count,
    unit_position,
)
from made.color_samples import SHAPE


def test_robust_ridge_is_least_squares_without_outliers():
    rng = np.random.default_rng(7)
    design, truth = rng.normal(size=(200, 4)), rng.normal(size=(4, 2))
    found = robust_ridge(design, design @ truth, np.ones(200), ridge=1e-12, huber=1.0)
    np.testing.assert_allclose(found, truth, rtol=1e-8)


def test_penalised_huber_is_robust_ridge_with_equal_penalties():
    rng = np.random.default_rng(7)
    design = rng.normal(size=(300, 4))
    design /= np.sqrt(np.mean(design**2, axis=0))
    target = design @ rng.normal(size=(4, 2)) + 0.1 * rng.normal(size=(300, 2))
    equal = penalised_huber(design, target, np.ones(300), np.full(4, 0.1), huber=0.1)
    np.testing.assert_allclose(
        equal, robust_ridge(design, target, np.ones(300), ridge=0.1, huber=0.1), rtol=1e-5
    )
    unequal = penalised_huber(design, target, np.ones(300), np.array([0, 0, 0, 1e9]), huber=0.1)
    assert np.abs(unequal[3]).max() < 1e-6 < np.abs(unequal[:3]).min()


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
