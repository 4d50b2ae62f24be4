"""The forward response in cells: nearly that of every pixel by itself."""

import numpy as np
import pytest

from gelform.color_models._shared.forward import ForwardResponse
from gelform.confidence.forward_cells import coefficients_of_cells, explained_change


@pytest.mark.parametrize("shape", [(240, 320), (61, 43)])
@pytest.mark.parametrize("degrees", [(3, 2, 1), (1,), (2, 0)])
def test_cells_and_pixels_agree(shape, degrees):
    rng = np.random.default_rng(4)
    places = {3: 10, 2: 6, 1: 3, 0: 1}
    count = sum(places[d] * n for d, n in zip(degrees, (2, 3, 4)))
    forward = ForwardResponse(rng.normal(0, 0.3, (count, 3)), degrees, shape, np.full(3, 0.02))
    gradients = rng.uniform(-0.5, 0.5, (*shape, 2)).astype(np.float32)
    y, x = (axis.ravel() for axis in np.mgrid[: shape[0], : shape[1]])
    exact = forward.color_from_gradients(gradients.reshape(-1, 2), x, y).reshape(*shape, 3)
    found = explained_change(coefficients_of_cells(forward), gradients)
    assert np.sqrt(np.mean((found - exact) ** 2)) < (0.1 if shape[1] == 320 else 0.35) * exact.std()


def test_a_response_that_is_the_same_everywhere_is_exact():
    forward = ForwardResponse(np.arange(27.0).reshape(9, 3) / 10, (0, 0, 0), (20, 40), np.full(3, 0.02))
    gradients = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 40, 2)).astype(np.float32)
    y, x = (axis.ravel() for axis in np.mgrid[:20, :40])
    exact = forward.color_from_gradients(gradients.reshape(-1, 2), x, y).reshape(20, 40, 3)
    np.testing.assert_allclose(explained_change(coefficients_of_cells(forward), gradients), exact, atol=1e-5)


def test_over_a_cell_a_response_that_is_linear_in_the_place_is_exact_in_the_mean():
    """Its coefficients are those at the cell's middle."""
    forward = ForwardResponse(np.random.default_rng(1).normal(0, 1, (6, 3)), (1,), (24, 48), np.full(3, 0.02))
    gradients = np.full((24, 48, 2), 0.3, dtype=np.float32)
    y, x = (axis.ravel() for axis in np.mgrid[:24, :48])
    exact = forward.color_from_gradients(gradients.reshape(-1, 2), x, y)
    found = explained_change(coefficients_of_cells(forward), gradients)
    means = [values.reshape(3, 8, 3, 16, 3).mean(axis=(1, 3)) for values in (found, exact)]
    np.testing.assert_allclose(means[0], means[1], atol=1e-5)
