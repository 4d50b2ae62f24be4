"""The cosine solve: that of the solver `dct`, with exact derivatives."""

import numpy as np
import pytest

from gelform.solvers.dct import DctSolver

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")
from gelform.torch.poisson import PoissonDepth  # noqa: E402


def test_the_solve_has_exact_derivatives():
    gradients = torch.randn(2, 2, 5, 6, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    assert torch.autograd.gradcheck(PoissonDepth((5, 6), (0.1, 0.15)).double(), gradients.requires_grad_())


@pytest.mark.parametrize("pitch", [(0.1, 0.1), (0.1, 0.13)], ids=["square", "oblong"])
@pytest.mark.parametrize("shape", [(7, 9), (8, 6), (1, 5), (132, 176)])
def test_the_solve_is_that_of_the_dct_solver(shape, pitch):
    gradients = np.random.default_rng(0).standard_normal((*shape, 2)).astype(np.float32)
    expected = DctSolver(shape, pitch)(gradients).depth_mm
    found = PoissonDepth(shape, pitch)(torch.from_numpy(gradients).permute(2, 0, 1)[None])[0]
    np.testing.assert_allclose(found, expected, atol=2e-5 * np.ptp(expected))
