"""The membrane over an obstacle, and what spreads from it."""

import numpy as np
import pytest

from gelform.simulate import LAYOUTS, Coin, simulate_press
from gelform.simulate.gel import membrane
from gelform.simulate.gel.membrane import carried_along, membrane_over, spread
from kernel_agreement import usable_isas


def test_spreading_keeps_the_sum_and_obeys_its_equation():
    values = np.zeros((60, 80))
    values[20:30, 35:50] = 1.0
    smooth = spread(values, 6.0)
    laplacian = sum(np.roll(smooth, k, axis=a) for k in (1, -1) for a in (0, 1)) - 4 * smooth
    assert smooth.sum() == pytest.approx(values.sum(), rel=1e-9)
    np.testing.assert_allclose((smooth - 36 * laplacian)[2:-2, 2:-2], values[2:-2, 2:-2], atol=1e-9)


def test_what_is_fixed_stays_and_the_rest_falls_off():
    fixed = np.zeros((60, 60), dtype=bool)
    fixed[25:35, 25:35] = True
    carried = carried_along(np.where(fixed, 0.3, 0.0), fixed, 5.0)
    assert np.all(carried[fixed] == 0.3)
    assert 0.3 > carried[30, 40] > carried[30, 50] > 0
    laplacian = sum(np.roll(carried, k, axis=a) for k in (1, -1) for a in (0, 1)) - 4 * carried
    beside = ~fixed
    beside[[0, -1]] = beside[:, [0, -1]] = False
    np.testing.assert_allclose(25 * laplacian[beside], carried[beside], atol=5e-3)


@pytest.mark.slow
def test_a_coarse_guess_that_does_not_settle_stops_nothing():
    """A coin's relief on the grid of half the resolution lets two contacts take turns; the fine grid settles."""
    sensor = LAYOUTS["homemade"]
    press = simulate_press(sensor, Coin(), depth_mm=0.35, rng=np.random.default_rng(7))
    assert press.depth_mm.max() == pytest.approx(0.35, rel=1e-3)


def dense_membrane(obstacle, relaxation_px):
    """The same problem by projected relaxation on one grid, many times over."""
    u = np.maximum(obstacle, 0)
    spring = relaxation_px**-2
    color = np.add.outer(np.arange(u.shape[0]), np.arange(u.shape[1])) % 2
    for sweep in range(4000):
        padded = np.pad(u, 1, mode="edge")
        total = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
        u = np.where(color == sweep % 2, np.maximum(total / (4 + spring), obstacle), u)
    return u


@pytest.mark.parametrize("shape", [(37, 50), (8, 9), (40, 3)])
def test_the_cycles_end_where_relaxation_on_one_grid_does(shape):
    obstacle = np.maximum(np.random.default_rng(4).normal(size=shape) - 0.8, 0)
    found = membrane_over(obstacle, relaxation_px=5.0)[0]
    np.testing.assert_allclose(found, dense_membrane(obstacle, 5.0), atol=1e-4 * obstacle.max())


def test_all_instruction_sets_give_the_same_bits(monkeypatch):
    """Only the kernel is changed: a handle made by one library is not for another."""
    obstacle = np.maximum(np.random.default_rng(4).normal(size=(60, 70)) - 1, 0)
    found = []
    for isa in usable_isas():
        monkeypatch.setattr(membrane, "_membrane_cycles", membrane._membrane_cycles.on(isa))
        found.append(membrane_over(obstacle, relaxation_px=6.0, bulge=0.5, bulge_px=20.0))
    for other in found[1:]:
        np.testing.assert_array_equal(other, found[0])
