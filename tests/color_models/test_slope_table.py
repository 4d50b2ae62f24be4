"""The slope table: rendered as it says, inverted to the slopes that were rendered."""

import numpy as np
import pytest

import gelform
from gelform.color_models import SlopeTableModel, slope_table
from gelform.importers.tables import read_taxim
from kernel_agreement import assert_kernel_agrees
from made.taxim_tables import law, taxim_arrays

SHAPE = (24, 32)


@pytest.fixture
def model(tmp_path):
    np.savez(tmp_path / "polycalib.npz", **taxim_arrays())
    return read_taxim(tmp_path / "polycalib.npz", np.zeros((*SHAPE, 3), dtype=np.float32))


def scattered(count=2000, steepest=1.0, seed=0):
    rng = np.random.default_rng(seed)
    steep, turn = steepest * np.sqrt(rng.uniform(size=count)), rng.uniform(-np.pi, np.pi, count)
    gradients = np.stack([steep * np.cos(turn), steep * np.sin(turn)], axis=-1)
    return gradients, rng.uniform(0, SHAPE[1] - 1, count), rng.uniform(0, SHAPE[0] - 1, count)


def test_it_renders_the_law_and_inverts_what_it_renders(model):
    """Channels and places in order; the law itself where the table is not faded."""
    gradients, x, y = scattered(seed=1)
    colors = law(*gradients.T, (x + 0.5) / SHAPE[1], (y + 0.5) / SHAPE[0])
    rendered_ = model.color_from_gradients(gradients, x, y)
    np.testing.assert_allclose(rendered_, colors, atol=0.015)
    np.testing.assert_allclose(model.gradients_at(rendered_, x, y), gradients, atol=0.01)
    error = np.linalg.norm(model.gradients_at(colors, x, y) - gradients, axis=1)
    assert np.median(error) < 0.02
    assert np.quantile(error, 0.99) < 0.06


def test_no_change_no_slope_and_frames_equal_pixels(model):
    prepared = model.prepare(np.zeros((*SHAPE, 3)), SHAPE)
    assert np.abs(prepared.gradients_from_color(np.zeros((*SHAPE, 3), np.float32))[0]).max() == 0
    at_rest = model.color_from_gradients(np.zeros((4, 2)), np.arange(4), np.arange(4))
    np.testing.assert_allclose(at_rest, 0, atol=1e-6)
    change = np.random.default_rng(3).uniform(-0.2, 0.2, (*SHAPE, 3)).astype(np.float32)
    frame = prepared.gradients_from_color(change)[0]
    y, x = (axis.ravel() for axis in np.mgrid[: SHAPE[0], : SHAPE[1]])
    np.testing.assert_array_equal(frame.reshape(-1, 2), model.gradients_at(change.reshape(-1, 3), x, y))
    assert np.isfinite(frame).all()
    again = SlopeTableModel.from_arrays(*model.to_arrays())
    np.testing.assert_array_equal(again.prepare(None, SHAPE).gradients_from_color(change)[0], frame)
    with pytest.raises(ValueError, match="as imported, got 10x10"):
        model.prepare(np.zeros((10, 10, 3)), (10, 10))


@pytest.mark.parametrize(("name", "median_deg", "tenth"), [("digit", 0.3, 10.0), ("gelsight-r15", 0.3, 12.0)])
def test_real_tables_come_back_from_their_own_colors(data, name, median_deg, tenth):
    path = data / "peer-calibrations" / f"taxim-{name}-polycalib.npz"
    model = read_taxim(path, np.full((*SHAPE, 3), 100, dtype=np.float32))
    gradients, x, y = scattered(4000)
    found = model.gradients_at(model.color_from_gradients(gradients, x, y), x, y)
    a, b = (gelform.normals_from_gradients(g[None].astype(np.float32))[0] for g in (found, gradients))
    angle = np.rad2deg(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1)))
    assert np.median(angle) < median_deg
    assert np.quantile(angle, 0.9) < tenth


def bilinear_terms(table, slopes):
    """Coefficients (N, 3, 6) of the place at slopes, in double precision."""
    angles, directions = table.shape[0], table.shape[1] - 1
    steep = np.clip(np.arctan(np.hypot(*slopes.T)) * (angles - 1) / (np.pi / 2), 0, angles - 1.001)
    turn = (np.arctan2(slopes[:, 1], slopes[:, 0]) + np.pi) * directions / (2 * np.pi) - 0.5
    i, j = steep.astype(int), np.floor(turn).astype(int)
    s, t = ((value - whole)[:, None, None] for value, whole in ((steep, i), (turn, j)))
    near, far = ((1 - t) * table[k, j % directions] + t * table[k, (j + 1) % directions] for k in (i, i + 1))
    return (1 - s) * near + s * far


def rendered(table, u, v, gradients):
    place = np.stack([u * u, v * v, u * v, u, v, np.ones_like(u)]).astype(np.float64)
    return np.einsum(
        "ncp,pn->nc", bilinear_terms(table.astype(np.float64), gradients.astype(np.float64)), place
    )


def test_the_forward_kernel_is_bilinear_between_the_bins(model):
    gradients, x, y = scattered(1000, steepest=3.0, seed=5)
    gradients[0], gradients[1], gradients[2] = 0, (-0.5, 0), (0, -1e-9)
    u, v = model._place(x, y)
    change = np.empty((1000, 3), np.float32)
    assert_kernel_agrees(
        slope_table._slope_table_color,
        lambda table, u, v, gradients, change: rendered(table, u, v, gradients),
        model._faded(),
        u,
        v,
        gradients.astype(np.float32),
        change,
    )


def test_the_inverse_kernel_finds_what_was_rendered(model):
    """Where colors have one cause the nearest slope is exact: what was rendered, wherever the search began."""
    gradients, x, y = (part.astype(np.float32) for part in scattered(500, steepest=0.8, seed=6))
    prepared = model.prepare(None, SHAPE)
    exact = bilinear_terms(model._faded().astype(float), prepared._starts.astype(float))
    np.testing.assert_allclose(np.moveaxis(prepared._terms, -1, 0), exact, atol=1e-5)
    u, v = model._place(x, y)
    change = rendered(model._faded(), u, v, gradients).astype(np.float32)
    assert_kernel_agrees(
        slope_table._slope_table_gradients,
        lambda *given: gradients,
        model._faded(),
        u,
        v,
        change,
        prepared._starts,
        prepared._terms,
        np.empty((500, 2), np.float32),
        tolerance=1e-4,
    )


def test_the_search_starts_near_every_slope(model):
    """Up to 60 degrees: half a step away in angle, half in direction."""
    starts = model.prepare(None, SHAPE)._starts
    gradients, _, _ = scattered(500, steepest=np.tan(np.deg2rad(58)), seed=9)
    a, b = (np.concatenate([-g, np.ones((len(g), 1))], axis=1) for g in (gradients, starts))
    a, b = (n / np.linalg.norm(n, axis=1)[:, None] for n in (a, b))
    assert np.rad2deg(np.arccos(np.clip(a @ b.T, -1, 1)).min(axis=1)).max() < 7.0


def test_the_tables_own_answer_at_rest_is_taken_off_up_to_ten_degrees():
    """Of 31 angles every third degree, and half as many directions, an offset at all of them."""
    table = np.full((31, 16, 3, 6), 0.0, dtype=np.float32)
    table[..., 5] = 0.2
    table[..., 5] += np.linspace(0, 0.5, 31, dtype=np.float32)[:, None, None]
    model = SlopeTableModel(table, SHAPE)
    steep = np.tan(np.deg2rad([0.0, 20.0, 45.0]))
    found = model.color_from_gradients(np.stack([steep, 0 * steep], axis=1), np.full(3, 5.0), np.full(3, 5.0))
    np.testing.assert_allclose(found[:, 0], [0, 0.2 + 0.5 * 20 / 90, 0.2 + 0.25], atol=1e-3)
