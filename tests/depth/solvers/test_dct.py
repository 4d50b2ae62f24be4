"""The uniform solver: exact on quadratics, the least-squares minimizer, free at the border."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy.fft import dct as scipy_dct
from scipy.fft import dctn, idct, idctn

from gelform.depth.solvers import dct
from gelform.depth.solvers.dct import Dct4Solver, DctSolver
from gelform.depth.solvers.seam import differences, divergence, edges_from_gradients
from kernel_agreement import assert_kernel_agrees
from scenes import gaussian, polynomial, rmse_um, scene

SHAPES = [(1, 1), (1, 2), (2, 1), (1, 37), (37, 1), (2, 2), (3, 2), (5, 7), (31, 53), (64, 256), (97, 40)]
PITCHES = [(0.0634, 0.0634), (0.05, 0.08), (0.2, 0.03)]
SOLVER = {2: DctSolver, 4: Dct4Solver}


def spectral_answer(gradients, pitch):
    """The same minimizer by the plain two-dimensional transform in float64."""
    height, width = gradients.shape[:2]
    eigen_x = (2 * np.sin(np.pi * np.arange(width) / (2 * width)) / pitch[0]) ** 2
    eigen_y = (2 * np.sin(np.pi * np.arange(height) / (2 * height)) / pitch[1]) ** 2
    eigen = eigen_y[:, None] + eigen_x
    eigen[0, 0] = np.inf
    right = divergence(edges_from_gradients(gradients), pitch)
    return idctn(dctn(right, norm="ortho") / eigen, norm="ortho")


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", SHAPES)
def test_is_the_minimiser_on_any_slopes(shape, pitch):
    gradients = np.random.default_rng(1).standard_normal((*shape, 2))
    expected = spectral_answer(gradients, pitch)
    depth = DctSolver(shape, pitch)(gradients.astype(np.float32)).depth_mm
    assert depth.dtype == np.float32
    assert np.max(np.abs(depth - expected)) <= 1e-5 * max(np.ptp(expected), 1e-3)


def test_order_four_is_exact_on_quartics_where_order_two_is_not():
    surface = polynomial({(4, 0): 0.01, (1, 3): 0.02, (2, 2): -0.01, (3, 0): 0.05})
    truth, gradients, pitch = scene(surface, (40, 50), (0.05, 0.08))
    errors = [rmse_um(SOLVER[order]((40, 50), pitch)(gradients).depth_mm, truth) for order in (2, 4)]
    assert errors[0] > 0.02
    assert errors[1] < 1e-3


@pytest.mark.parametrize(("order", "observed"), [(2, 2.0), (4, 4.0)])
def test_converges_with_its_order(order, observed):
    errors = []
    for n in (1, 2, 4):
        shape, pitch = (24 * n, 32 * n), (0.4 / n, 0.4 / n)
        truth, gradients, _ = scene(gaussian(1.0, 2.0), shape, pitch)
        errors.append(rmse_um(SOLVER[order](shape, pitch)(gradients).depth_mm, truth))
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert rates == pytest.approx(observed, abs=0.35)


@pytest.mark.parametrize("pitch", PITCHES)
def test_difference_and_divergence_are_adjoint(pitch):
    rng = np.random.default_rng(2)
    depth, ex, ey = rng.standard_normal((9, 13)), rng.standard_normal((9, 12)), rng.standard_normal((8, 13))
    dx, dy = differences(depth, pitch)
    left = np.sum(dx * ex) + np.sum(dy * ey)
    assert left == pytest.approx(np.sum(depth * divergence((ex, ey), pitch)), rel=1e-12)


def test_mean_is_zero_also_for_large_frames():
    gradients = 0.05 + 0.05 * np.random.default_rng(5).standard_normal((300, 512, 2))
    depth = DctSolver((300, 512), (0.0634, 0.0634))(gradients).depth_mm
    assert abs(float(depth.mean(dtype=np.float64))) < 1e-6 * np.ptp(depth)


def right_side(gradients, right, scale_x, scale_y):
    """In numpy: slopes of both neighbors, those beyond the border mirrored with their sign turned."""
    p, q = np.float32(scale_x) * gradients[..., 0], np.float32(scale_y) * gradients[..., 1]
    p, q = np.pad(p, ((0, 0), (1, 1)), "edge"), np.pad(q, ((1, 1), (0, 0)), "edge")
    p[:, [0, -1]] *= -1
    q[[0, -1]] *= -1
    out = right.copy()
    out[:, : gradients.shape[1]] = p[:, :-2] - p[:, 2:] + q[:-2] - q[2:]
    return out


def swept(spectrum, pivots, splits, end):
    """In numpy, float64: forward and backward through the rows, column 0 on its own."""
    v = spectrum[:, : pivots.shape[1]].astype(np.float64)
    first = -np.concatenate([[0], np.cumsum(np.cumsum(v[:-1, 0]))])
    column = np.arange(pivots.shape[1])
    mine = [np.where(column < split, row, pivots[-1]) for split, row in zip(splits, pivots)]
    mine[-1] = end
    for i in range(len(v)):
        v[i] = (v[i] + (v[i - 1] if i else 0)) * mine[i]
    for i in range(len(v) - 2, -1, -1):
        v[i] += v[i + 1] * mine[i]
    v[:, 0] = first - first.mean()
    out = spectrum.copy()
    out[:, : pivots.shape[1]] = v
    return out


def transformed_rows(rows, width, back):
    out = rows.copy()
    out[:, :width] = (idct if back else scipy_dct)(rows[:, :width].astype(np.float64), axis=-1)
    return out


@pytest.mark.parametrize("shape", [(1, 1), (1, 6), (6, 1), (2, 2), (9, 40), (33, 47)])
def test_kernels_agree_with_numpy(shape):
    assert_kernel_agrees(dct._right_side, right_side)
    work = np.random.default_rng(6).standard_normal((shape[0], shape[1] + 5)).astype(np.float32)
    for back, table in enumerate(dct._cosines(shape[1])):
        assert_kernel_agrees(
            dct._product, lambda rows, t, k=back: transformed_rows(rows, len(t), k), work, table
        )
    assert_kernel_agrees(dct._sweep, swept, work, *dct._elimination(shape, (0.05, 0.08)))


@pytest.mark.parametrize("pad", [0, 5])
@pytest.mark.parametrize("shape", [(1, 2), (4, 4), (5, 12), (16, 20), (19, 42), (33, 90), (7, 98), (40, 320)])
def test_rows_of_smooth_widths_are_transformed_as_scipy_does(shape, pad):
    """Of all radices, of numbers of rows that fill registers and that do not."""
    work = np.random.default_rng(7).standard_normal((shape[0], shape[1] + pad)).astype(np.float32)
    scratch = np.empty((3 * shape[1] + 1) * dct.ROWS, dtype=np.float32)
    for back in (0, 1):
        expected = transformed_rows(work, shape[1], back)
        assert_kernel_agrees(
            dct._cosine_rows, lambda *_, out=expected: out, work, *dct._turns(shape[1]), scratch, back
        )


@pytest.mark.parametrize("shape", [(1, 4), (5, 12), (33, 90)])
def test_the_passes_in_one_call_are_those_one_by_one(shape):
    work = np.random.default_rng(8).standard_normal((shape[0], shape[1] + 5)).astype(np.float32)
    scratch, elimination = (
        np.empty((3 * shape[1] + 1) * dct.ROWS, np.float32),
        dct._elimination(shape, (0.05, 0.08)),
    )

    def one_by_one(spectrum, gradients, *rest):
        if gradients is not None:
            spectrum = right_side(gradients, spectrum, *rest[-2:])
        whole = transformed_rows(spectrum, shape[1], 0)
        return transformed_rows(swept(whole, *elimination), shape[1], 1)

    tables = *dct._turns(shape[1]), *elimination, scratch
    for gradients in (None, np.random.default_rng(9).standard_normal((*shape, 2)).astype(np.float32)):
        assert_kernel_agrees(dct._passes, one_by_one, work, gradients, *tables, 0.7, 0.4)


@pytest.mark.parametrize("shape", [(2, 4), (12, 16), (30, 20)])
def test_a_filter_multiplies_modes_as_scipy_does(shape):
    """In one call where both sides are smooth, and in several where one is not."""
    rng, (height, width) = np.random.default_rng(9), shape
    maps, gains = rng.standard_normal((2, 3, *shape)).astype(np.float32)
    turned = np.ascontiguousarray(np.swapaxes(gains, 1, 2))
    wanted = idctn(dctn(maps, axes=(1, 2)) * gains, axes=(1, 2))
    work = np.empty(height * width + (3 * max(shape) + 1) * dct.ROWS, np.float32)
    turns = *dct._turns(width), *dct._turns(height)
    assert_kernel_agrees(dct._cosine_filter, lambda *_: wanted, maps, turned, *turns, work)
    np.testing.assert_allclose(dct.CosineFilter(gains)(maps), wanted, atol=1e-5)
    odd = maps[:, :, : width - 1], gains[:, :, : width - 1]
    wanted = idctn(dctn(odd[0], axes=(1, 2)) * odd[1], axes=(1, 2))
    np.testing.assert_allclose(dct.CosineFilter(odd[1])(odd[0]), wanted, atol=1e-5)


def test_widths_that_the_kernel_cannot_transform_are_refused():
    assert [w for w in range(1, 50) if not dct._is_smooth(w) and w % 2 == 0] == [22, 26, 34, 38, 44, 46]
    for width in (22, 26):
        rows, work = np.zeros((1, width), np.float32), np.empty(4000, np.float32)
        with pytest.raises(ValueError, match="do not fit"):
            dct._cosine_rows(rows, *dct._turns(width), work, 0)
    with pytest.raises(ValueError, match="do not fit"):  # wider than its work array
        dct._product(np.zeros((2, 200), np.float32), np.zeros((200, 200), np.float32))


def test_few_columns_and_smooth_widths_take_no_transform_of_scipy():
    """Importing it would take half of a first frame's time."""
    code = (
        "import numpy, sys; from gelform.depth.solvers.dct import DctSolver;"
        "DctSolver((60, 80), (1.0, 1.0))(numpy.ones((60, 80, 2)));"
        "DctSolver((60, 79), (1.0, 1.0))(numpy.ones((60, 79, 2)));"
        "DctSolver((240, 320), (1.0, 1.0))(numpy.ones((240, 320, 2)));"
        "sys.exit('scipy.fft' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
