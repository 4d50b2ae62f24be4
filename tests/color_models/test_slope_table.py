"""Taxim's forward table: rendered as it says, inverted to the slopes that were rendered."""

import io
import zipfile

import numpy as np
import pytest

import gelform
from gelform.color_models import SlopeTableModel
from gelform.importers.taxim import read_taxim

SHAPE = (24, 32)
LIGHTS = np.array([[0.5, 0.1], [-0.3, 0.4], [-0.2, -0.5]])  # of the channels R, G, B


def law(p, q, u, v):
    """A smooth forward law (N, 3): each channel lit from its side, more so to the right and below."""
    slope = np.stack([p, q], axis=-1)
    return slope @ LIGHTS.T / np.sqrt(1 + p**2 + q**2)[:, None] * (0.6 + 0.3 * u + 0.2 * v * v)[:, None]


def taxim_arrays(bins=90, shape=(480, 640)):
    """The law as Taxim writes it: in grey levels, over pixel positions, blue first."""
    angle = (np.arange(bins) + 0.5) * np.pi / 2 / (bins - 1)
    turn = (np.arange(bins) + 0.5) * 2 * np.pi / (bins - 1) - np.pi
    steep = np.tan(np.minimum(angle, 1.5))[:, None]
    p, q = steep * np.cos(turn), steep * np.sin(turn)
    tables = []
    for light in LIGHTS:
        value = 255 * (light[0] * p + light[1] * q) / np.sqrt(1 + p**2 + q**2)
        powers = np.zeros(6)
        powers[1], powers[3], powers[5] = 0.2 / shape[0] ** 2, 0.3 / shape[1], 0.6
        tables.append(value[..., None] * powers)
    return {"bins": np.array(bins), "grad_r": tables[2], "grad_g": tables[1], "grad_b": tables[0]}


@pytest.fixture
def model(tmp_path):
    np.savez(tmp_path / "polycalib.npz", **taxim_arrays())
    return read_taxim(tmp_path / "polycalib.npz", np.zeros((*SHAPE, 3), dtype=np.float32))


def scattered(count=2000, steepest=1.0, seed=0):
    rng = np.random.default_rng(seed)
    steep, turn = steepest * np.sqrt(rng.uniform(size=count)), rng.uniform(-np.pi, np.pi, count)
    gradients = np.stack([steep * np.cos(turn), steep * np.sin(turn)], axis=-1)
    return gradients, rng.uniform(0, SHAPE[1] - 1, count), rng.uniform(0, SHAPE[0] - 1, count)


def test_it_renders_the_law_channels_and_places_in_order(model):
    gradients, x, y = scattered()
    u, v = (x + 0.5) / SHAPE[1], (y + 0.5) / SHAPE[0]
    found = model.color_from_gradients(gradients, x, y)
    np.testing.assert_allclose(found, law(*gradients.T, u, v), atol=0.015)


def test_it_inverts_what_it_renders(model):
    gradients, x, y = scattered(seed=1)
    found = model.gradients_at(model.color_from_gradients(gradients, x, y), x, y)
    np.testing.assert_allclose(found, gradients, atol=0.01)


def test_it_inverts_the_law_itself_where_the_table_is_not_faded(model):
    gradients, x, y = scattered(seed=2)
    u, v = (x + 0.5) / SHAPE[1], (y + 0.5) / SHAPE[0]
    error = np.linalg.norm(model.gradients_at(law(*gradients.T, u, v), x, y) - gradients, axis=1)
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


def test_other_files_are_refused(tmp_path):
    background, path = np.zeros((*SHAPE, 3), dtype=np.float32), tmp_path / "polycalib.npz"
    with pytest.raises(gelform.DataError, match="No file"):
        read_taxim(path, background)
    good = taxim_arrays(bins=20)
    for spoilt, why in (
        ({k: v for k, v in good.items() if k != "bins"}, "Expected bins, grad_r"),
        ({**good, "grad_r": good["grad_r"][:-1]}, "three tables"),
        ({**good, "bins": np.array(21)}, "three tables"),
        ({**good, "grad_g": good["grad_g"] * np.nan}, "finite"),
        ({**good, "bins": np.array([object()])}, "damaged"),
    ):
        np.savez(path, **spoilt)
        with pytest.raises(gelform.DataError, match=why):
            read_taxim(path, background)
    np.savez(path, **good)
    with pytest.raises(gelform.DataError, match="proportions"):
        read_taxim(path, np.zeros((32, 24, 3), dtype=np.float32))
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(gelform.DataError, match="damaged"):
        read_taxim(path, background)
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (2**27,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("bins.npy", "w") as member:
        member.write(header.getvalue())
        for _ in range(257):
            member.write(bytes(2**20))
    with pytest.raises(gelform.DataError, match="declares 269 MB"):
        read_taxim(path, background)


@pytest.mark.parametrize(("name", "median_deg", "tenth"), [("digit", 0.3, 10.0), ("gelsight-r15", 0.3, 12.0)])
def test_real_tables_come_back_from_their_own_colours(data, name, median_deg, tenth):
    path = data / "peer-calibrations" / f"taxim-{name}-polycalib.npz"
    model = read_taxim(path, np.full((*SHAPE, 3), 100, dtype=np.float32))
    gradients, x, y = scattered(4000)
    found = model.gradients_at(model.color_from_gradients(gradients, x, y), x, y)
    a, b = (gelform.normals_from_gradients(g[None].astype(np.float32))[0] for g in (found, gradients))
    angle = np.rad2deg(np.arccos(np.clip(np.sum(a * b, axis=-1), -1, 1)))
    assert np.median(angle) < median_deg
    assert np.quantile(angle, 0.9) < tenth
