"""The cosine solve: that of the solver `dct`, with exact derivatives."""

import numpy as np
import pytest

import gelform

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")
from gelform.torch.poisson import PoissonDepth  # noqa: E402


def test_the_solve_has_exact_derivatives():
    gradients = torch.randn(2, 2, 5, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    assert torch.autograd.gradcheck(PoissonDepth((5, 6), 0.1).double(), gradients.requires_grad_())


@pytest.mark.parametrize("shape", [(7, 9), (8, 6), (1, 5), (132, 176)])
def test_the_solve_is_that_of_the_dct_solver(shape):
    gradients = np.random.default_rng(0).standard_normal((*shape, 2)).astype(np.float32)
    expected = gelform.depth_from_gradients(gradients, mm_per_px=0.1, solver="dct")
    found = PoissonDepth(shape, 0.1)(torch.from_numpy(gradients).permute(2, 0, 1)[None])[0]
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.ptp(expected))
