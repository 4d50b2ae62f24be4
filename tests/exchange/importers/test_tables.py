"""Taxim's tables and look-up tables: their values, and refusals."""

import io

import cv2
import numpy as np
import pytest
import scipy

import gelform
from gelform.errors import DataError
from gelform.exchange.importers.tables import (
    TaximLook,
    TaximTables,
    is_taxim_forward,
    read_lut,
    read_taxim_forward,
)
from gelform.simulate import Ball, Pose
from gelform.simulate.twin import Twin
from gelform.slopes.color_models.tables import LookupModel
from hostile.files import odd_archives
from made.files import taxim_arrays
from made.images import SHAPE

FLAT = np.full((*SHAPE, 3), 100, dtype=np.float32)


def lut_file(path, bins=90, ranges=((-90, 90),) * 3):
    """A table as its package writes it: linear in the differences, at the bins' centers, indexed b, g, r."""
    at = [low + (np.arange(bins) + 0.5) * (high - low) / bins for low, high in ranges]
    blue, green, red = np.meshgrid(*at, indexing="ij")
    table = np.stack([0.004 * red - 0.002 * blue + 0.1, 0.003 * green + 0.001 * blue - 0.2], axis=-1)
    np.save(path, table)
    return path


def test_an_imported_table_answers_with_its_own_gain(tmp_path):
    rng = np.random.default_rng(0)
    background = rng.uniform(60, 160, (*SHAPE, 3)).astype(np.float32)
    image = np.clip(background + rng.uniform(-20, 20, background.shape), 0, 255).astype(np.float32)
    change = (image - background) / np.float32(255)
    path = lut_file(tmp_path / "table_smooth.npy", bins=30)
    model = read_lut(path, background)
    found, sigma = model.prepare(background, SHAPE).gradients_from_color(change)
    gain = 1 + 2 * ((background + 1).mean() / (background + 1) - 1)
    red, green, blue = np.moveaxis((image - background) * gain, -1, 0)
    wanted = np.stack([0.004 * red - 0.002 * blue, 0.003 * green + 0.001 * blue], axis=-1)
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    assert sigma is None
    flipped = read_lut(path, background, depth_sign=-1)
    turned, _ = flipped.prepare(background, SHAPE).gradients_from_color(change)
    np.testing.assert_allclose(turned, -found, atol=1e-5)
    rows, columns = np.array([3, 20]), np.array([50, 1])
    scattered = model.gradients_at(change[rows, columns], columns, rows)
    np.testing.assert_allclose(scattered, found[rows, columns], atol=1e-5)
    again = LookupModel.from_arrays(*model.to_arrays())
    np.testing.assert_array_equal(again.prepare(background, SHAPE).gradients_from_color(change)[0], found)


def answer(model, red=20.0, green=10.0, blue=-15.0):
    """Gradients (2,) for a difference of color in gray levels on a uniform background."""
    change = np.broadcast_to(np.array([red, green, blue]) / 255, FLAT.shape).astype(np.float32)
    return model.prepare(FLAT, SHAPE).gradients_from_color(change)[0][5, 5]


@pytest.mark.parametrize(
    "given", [(-256.0, 256.0), (-55.0, 95.0, -30.0, 30.0, -80.0, 40.0)], ids=["wide", "of each channel"]
)
def test_a_table_over_another_range_reads_the_same_slopes(tmp_path, given):
    ranges = np.broadcast_to(np.reshape(given, (-1, 2)), (3, 2))
    model = read_lut(lut_file(tmp_path / "t.npy", 60, ranges), FLAT, range_levels=given)
    np.testing.assert_allclose(answer(model), [0.004 * 20 + 0.002 * 15, 0.003 * 10 - 0.001 * 15], atol=1e-4)
    for wrong in ((0.0, 90.0), (90.0, -90.0), (-1.0, 2.0, 3.0), (-1e9, 1e9), (-90.0, float("nan"))):
        with pytest.raises(ValueError, match="range_levels"):
            read_lut(tmp_path / "t.npy", FLAT, range_levels=wrong)


def matlab_file(path, bins=40, zero=-128.0, scale=256.0, **changed):
    """MATLAB's table of slopes that are linear in the differences, indexed r, g, b; bin k begins at k/(bins - 1)."""
    at = zero + (np.arange(bins) + 0.5) * scale / (bins - 1)
    red, green, blue = np.meshgrid(at, at, at, indexing="ij")
    x, y = 0.004 * red - 0.002 * blue, 0.003 * green + 0.001 * blue
    fields = {"bins": bins, "GradMag": np.arctan(np.hypot(x, y)), "GradDir": np.arctan2(y, x)}
    fields |= {"Zeropoint": zero, "Scale": scale, "Pixmm": 0.05}
    fields |= {"FrameSize": [SHAPE[0] + 60, SHAPE[1] + 60, 3]}
    fields = {name: value for name, value in (fields | changed).items() if value is not None}
    scipy.io.savemat(path, {"LookupTable": fields}, do_compression=True)
    return path


def test_matlab_s_table_states_its_range_and_scale(tmp_path):
    path = matlab_file(tmp_path / "table.mat")
    wanted = [0.004 * 20 + 0.002 * 15, 0.003 * 10 - 0.001 * 15]
    np.testing.assert_allclose(answer(read_lut(path, FLAT)), wanted, atol=2e-3)
    np.testing.assert_allclose(answer(read_lut(path, FLAT, depth_sign=-1)), np.negative(wanted), atol=2e-3)
    made = gelform.import_calibration(path, "lut", background=FLAT)
    assert made.mm_per_px == 0.05
    assert gelform.import_calibration(path, "lut", background=FLAT, mm_per_px=0.06).mm_per_px == 0.06
    with pytest.raises(ValueError, match="states its own"):
        read_lut(path, FLAT, range_levels=(-90, 90))
    other = matlab_file(tmp_path / "other.mat", FrameSize=[480, 640, 3])
    with pytest.raises(DataError, match=r"0.05 mm per pixel of frames of 480x640 px, and the background is"):
        gelform.import_calibration(other, "lut", background=FLAT)


def test_other_files_of_matlab_are_refused(tmp_path):
    path = tmp_path / "table.mat"
    for changed, why in (
        ({"Zeropoint": -1e-3, "Scale": 5e-3}, "in gray levels, such as -90 and 180"),
        ({"GradDir": None}, "got no GradDir"),
        ({"GradMag": np.zeros((40, 40, 39))}, "shape"),
        ({"GradMag": 0.1, "GradDir": 0.2}, r"shape \(bins, bins, bins\) in .*, got \(\)"),
        ({"GradMag": np.full((40, 40, 40), np.nan)}, "shape"),
        ({"GradMag": np.full((40, 40, 40), 2.0)}, "angles under pi/2"),
    ):
        with pytest.raises(DataError, match=why):
            read_lut(matlab_file(path, **changed), FLAT)
    whole = matlab_file(path).read_bytes()
    scipy.io.savemat(path, {"other": 1})
    for content, why in (
        (path.read_bytes(), "Expected a struct LookupTable"),
        (b"MATLAB 7.3 MAT-file" + bytes(600), "-v7"),
        (whole[:5000], "damaged"),
        (b"", "damaged"),
    ):
        path.write_bytes(content)
        with pytest.raises(DataError, match=why):
            read_lut(path, FLAT)
    scipy.io.savemat(path, {"LookupTable": {"bins": np.zeros(40_000_000)}}, do_compression=True)
    assert path.stat().st_size < 2e6
    with pytest.raises(DataError, match="more than 256 MB"):
        read_lut(path, FLAT)


def test_the_blur_of_imported_tables_is_as_wide_as_theirs(tmp_path):
    calibration = gelform.import_calibration(
        lut_file(tmp_path / "table.npy", bins=8), "lut", background=np.full((*SHAPE, 3), 100, np.uint8)
    )
    spot = np.zeros(SHAPE, dtype=np.float32)
    spot[20, 30] = 1
    theirs = cv2.GaussianBlur(spot, (3, 3), 0)
    ours = cv2.GaussianBlur(spot, (0, 0), calibration.change.blur_px)
    x = np.arange(SHAPE[1]) - 30.0
    assert np.sum(ours * x**2) == pytest.approx(np.sum(theirs * x**2), rel=0.06)


def test_other_tables_are_refused(tmp_path):
    path = tmp_path / "table.npy"
    with pytest.raises(gelform.DataError, match="No file"):
        read_lut(path, FLAT)
    for array, why in (
        (np.zeros((5, 5, 5, 3)), "shape"),
        (np.zeros((5, 5, 6, 2)), "shape"),
        (np.full((5, 5, 5, 2), np.nan), "finite"),
        (np.array([object()]), "no array file"),
    ):
        np.save(path, array)
        with pytest.raises(gelform.DataError, match=why):
            read_lut(path, FLAT)
    with pytest.raises(ValueError, match="depth_sign"):
        read_lut(path, FLAT, depth_sign=2)


BINS = 181  # angles of half a degree, directions of two


def tables():
    """Red follows the slope angle, green the direction, blue the place: x/1000 + y/100."""
    table = np.zeros((BINS, BINS, 3, 6))
    table[..., 0, 5] = 0.5 * np.arange(BINS)[:, None]
    table[..., 1, 5] = 2 * np.arange(BINS)[None, :] - 180
    table[..., 2, 3], table[..., 2, 4] = 1e-3, 1e-2
    return table


def save(path, **changes):
    table = tables()
    members = {"bins": BINS, "grad_b": table[:, :, 0], "grad_g": table[:, :, 1], "grad_r": table[:, :, 2]}
    np.savez(path, **{k: v for k, v in (members | changes).items() if v is not None})
    return path


def test_the_bins_are_those_of_angle_direction_uphill_and_place():
    """Right of a ball's middle the slope is negative in x: Taxim's atan2(-y, -x) is 180 degrees there."""
    gradients = np.zeros((4, 5, 2))
    gradients[1, 3] = np.tan(np.deg2rad(30.2)) * np.array([np.cos(1.0), np.sin(1.0)])
    change = TaximTables(tables()).level_change(gradients)
    assert change[1, 3, 0] == pytest.approx(30.0)
    assert change[1, 3, 1] == pytest.approx(np.rad2deg(1.0), abs=2.0)
    x, y = 3.5 * 640 / 5 - 0.5, 1.5 * 480 / 4 - 0.5
    assert change[1, 3, 2] == pytest.approx(1e-3 * x + 1e-2 * y)
    assert np.all(change[0, :, 0] == 0)
    right, below = (np.broadcast_to(slope, (3, 4, 2)) for slope in ((-0.5, 0), (0, -0.5)))
    assert abs(TaximTables(tables()).level_change(right)[0, 0, 1]) == pytest.approx(180, abs=2)
    assert TaximTables(tables()).level_change(below)[0, 0, 1] == pytest.approx(-90, abs=2)


def test_tables_are_read_blue_first_and_bad_ones_refused(tmp_path):
    path = save(tmp_path / "polycalib.npz")
    np.testing.assert_array_equal(read_taxim_forward(path).table, tables())
    assert is_taxim_forward(path)
    for changes, message in (
        ({"grad_g": None}, "lacks grad_g"),
        ({"bins": 7}, r"shape \(bins, bins, 6\)"),
        ({"grad_r": np.zeros((BINS, BINS, 5))}, r"shape \(bins, bins, 6\)"),
        ({"grad_r": np.full((BINS, BINS, 6), np.nan)}, "finite tables"),
        ({"bins": np.array("many")}, "damaged"),
    ):
        with pytest.raises(DataError, match=message):
            read_taxim_forward(save(tmp_path / "bad.npz", **changes))


def test_an_untouched_look_is_its_background_and_a_pressed_one_is_the_tables(tmp_path):
    rng = np.random.default_rng(0)
    background = rng.integers(60, 120, (48, 64, 3)).astype(np.float32)
    look = TaximLook(TaximTables(tables()), background, 0.2, np.zeros(3))
    twin = Twin(look)
    np.testing.assert_array_equal(twin.press(Ball(3), Pose(0.0), rng=None).image, background)
    press = twin.press(Ball(3), Pose(0.8), rng=None)
    deep = press.depth_mm > 0.1
    expected = np.clip(background + look.tables.level_change(press.gradients), 0, 255)
    np.testing.assert_allclose(press.image[deep], expected[deep], atol=0.5 + 1e-3)
    far = np.zeros_like(deep)
    far[:4, :4] = True
    assert np.abs(press.image.astype(float) - background)[far].mean() < 2.5
    for shape, mm_per_px, said in (
        ((64, 48), 0.1, "Turn an upright one by 90 degrees clockwise"),
        ((48, 64), 0.0, "mm_per_px"),
    ):
        with pytest.raises(ValueError, match=said):
            TaximLook(TaximTables(tables()), np.zeros((*shape, 3), np.float32), mm_per_px, np.zeros(3))


def test_what_is_no_table_is_said(tmp_path, monkeypatch):
    """Text, an array, tables that are cut, and some that declare more than any memory."""
    (tmp_path / "text.npz").write_text("hello")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(DataError, match="No file"):
        read_taxim_forward(tmp_path / "none.npz")
    whole = io.BytesIO()
    np.savez(whole, **taxim_arrays(8))
    (tmp_path / "large.npz").write_bytes(odd_archives(whole.getvalue())[0])
    (tmp_path / "cut.npz").write_bytes(whole.getvalue()[:-100])
    for name in ("text.npz", "array.npy", "cut.npz", "large.npz"):
        assert name == "large.npz" or not is_taxim_forward(tmp_path / name)
        with pytest.raises(DataError, match="damaged"):
            read_taxim_forward(tmp_path / name)
    monkeypatch.setattr("gelform.exchange.importers.tables.MAX_ARRAY_BYTES", 5_000)
    (tmp_path / "whole.npz").write_bytes(whole.getvalue())
    with pytest.raises(DataError, match=r"of at most 0\.005 MB, got .*whole\.npz of 0\.0\d+ MB"):
        read_taxim_forward(tmp_path / "whole.npz")


@pytest.mark.parametrize("name", ["taxim-digit-polycalib.npz", "taxim-gelsight-r15-polycalib.npz"])
def test_published_tables_make_a_picture(data, name):
    tables = read_taxim_forward(data / "peer-calibrations" / name)
    look = TaximLook(tables, np.full((240, 320, 3), 110, np.float32), 0.05, np.ones(3))
    press = Twin(look).press(Ball(3), Pose(0.6), rng=None)
    change = press.image[press.contact].astype(float) - 110
    assert np.all(change.std(axis=0) > 10)
