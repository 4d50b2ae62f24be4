"""Medians over chosen pixels equal those of the kernel."""

import numpy as np
import pytest

from gelform.depth.solvers.dct import DctSolver
from gelform.foundations.filters import medians_where as by_kernel

torch = pytest.importorskip("torch", reason="needs the extra 'torch'")

from gelform.torch.maps import PoissonDepth, block_shares, medians_where  # noqa: E402


@pytest.mark.parametrize("share", [None, 0.5, 0.03, 0.0])
def test_medians_are_the_kernels(share):
    rng = np.random.default_rng(2)
    maps = rng.normal(size=(3, 14, 15, 2)).astype(np.float32)
    chosen = None if share is None else rng.random((3, 14, 15)) < share
    given = None if chosen is None else torch.from_numpy(chosen)[:, None]
    found = medians_where(torch.from_numpy(maps).permute(0, 3, 1, 2), given)
    assert found.shape == (3, 2, 1, 1)
    for k, one in enumerate(maps):
        expected, _ = by_kernel(one, None if chosen is None else chosen[k])
        np.testing.assert_allclose(found[k, :, 0, 0], expected, rtol=1e-6)


def test_shares_of_blocks_are_means():
    found = block_shares(7, 2)
    np.testing.assert_allclose(found[0], np.array([1, 1, 1, 0.5, 0, 0, 0]) / 3.5, atol=1e-6)
    np.testing.assert_allclose(found.sum(1), 1, atol=1e-6)


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
