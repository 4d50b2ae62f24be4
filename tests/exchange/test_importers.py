"""Taxim's tables and look-up tables: their values, and refusals.

Imported networks give their own packages' answers, with gelform's signs; what they do not state stays unknown.
"""

import pickle
import sys
import zipfile
from collections import OrderedDict
from importlib.util import find_spec
from itertools import pairwise

import cv2
import numpy as np
import pytest
import scipy

import gelform
from gelform.errors import DataError
from gelform.exchange.importers import (
    STEEPEST,
    UNTOUCHED_CHANGE,
    TaximLook,
    TaximTables,
    is_taxim_forward,
    read_gs_sdk,
    read_gsrobotics,
    read_gsrobotics_web,
    read_lut,
    read_taxim_forward,
)
from gelform.image.view import image_from_frame
from gelform.sensors.profiles import PROFILES
from gelform.simulate import Ball, Pose
from gelform.simulate.press import Twin
from gelform.slopes.color_models.networks import Layers
from gelform.slopes.color_models.tables import LookupModel
from hostile.files import odd_archives
from made.files import in_numpy, network_arrays, torch_file, web_file
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


def test_a_table_s_steep_slopes_are_cut_and_said(tmp_path):
    """5 % of the angles of a laboratory's table were over 70 degrees; of a ball it made 3 mm, with holes of 1-3 mm."""
    gentle = matlab_file(tmp_path / "gentle.mat")
    made = gelform.import_calibration(gentle, "lut", background=FLAT)
    assert made.findings == ()
    assert made.settings.others["steepest_slope"] == pytest.approx(np.hypot(6, 4) * 0.128, rel=0.05)
    steep = np.full((40, 40, 40), 0.1)
    steep[20:22] = np.arctan(8.0)
    path = matlab_file(tmp_path / "steep.mat", GradMag=steep, GradDir=0 * steep)
    made = gelform.import_calibration(path, "lut", background=FLAT)
    assert np.linalg.norm(made.color_model.table[..., :2], axis=-1).max() == pytest.approx(STEEPEST, abs=1e-5)
    made.save(tmp_path / "made.npz")
    reconstruct = gelform.Reconstructor(gelform.load_calibration(tmp_path / "made.npz"))
    (finding,) = [
        one for one in reconstruct.from_image(FLAT.astype(np.uint8)).health if one.name == "steep_table"
    ]
    assert finding.figure == pytest.approx(8)
    assert "slopes of up to 8 (83°), 5 % of them over 1.57 (58°)" in finding.message


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
        (np.array([object()]), "pickled Python objects"),
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
    small = {name: np.zeros((8, 8, 6)) for name in ("grad_r", "grad_g", "grad_b")}
    whole = save(tmp_path / "whole.npz", bins=8, **small).read_bytes()
    (tmp_path / "large.npz").write_bytes(odd_archives(whole)[0])
    (tmp_path / "cut.npz").write_bytes(whole[:-100])
    for name in ("text.npz", "array.npy", "cut.npz", "large.npz"):
        assert name == "large.npz" or not is_taxim_forward(tmp_path / name)
        with pytest.raises(DataError, match="damaged"):
            read_taxim_forward(tmp_path / name)
    monkeypatch.setattr("gelform.exchange.importers.MAX_ARRAY_BYTES", 5_000)
    with pytest.raises(DataError, match=r"of at most 0\.005 MB, got .*whole\.npz of 0\.0\d+ MB"):
        read_taxim_forward(tmp_path / "whole.npz")


@pytest.mark.parametrize("name", ["taxim-digit-polycalib.npz", "taxim-gelsight-r15-polycalib.npz"])
def test_published_tables_make_a_picture(data, name):
    tables = read_taxim_forward(data / "peer-calibrations" / name)
    look = TaximLook(tables, np.full((240, 320, 3), 110, np.float32), 0.05, np.ones(3))
    press = Twin(look).press(Ball(3), Pose(0.6), rng=None)
    change = press.image[press.contact].astype(float) - 110
    assert np.all(change.std(axis=0) > 10)


CALIBRATED = (48, 64)
BACKGROUND = np.random.default_rng(0).integers(60, 160, (*CALIBRATED, 3)).astype(np.float32)
HOW = {"package": "gsrobotics-web", "position": "true"}
WEB = {**HOW, "background": BACKGROUND}
GENTLE = {name: 0.6 * array for name, array in network_arrays((5, 64, 64, 64, 2)).items()}


def image_and_change(seed=1, background=BACKGROUND):
    image = np.random.default_rng(seed).integers(1, 255, (*CALIBRATED, 3)).astype(np.float32)
    return image, (image - background) / np.float32(255)


def slopes_of(model, change, background=BACKGROUND):
    return model.prepare(background, background.shape[:2]).gradients_from_color(change)[0]


def answered(arrays, image, position):
    """The network in plain numpy: B, G, R and two positions in, two numbers out."""
    y, x = np.mgrid[: CALIBRATED[0], : CALIBRATED[1]]
    places = {
        "xy": (x / CALIBRATED[1], y / CALIBRATED[0]),
        "yx": (y / CALIBRATED[0], x / CALIBRATED[1]),
        "zeros": (0 * x, 0 * y),
    }
    values = np.stack([*np.moveaxis(image[..., ::-1] / 255, -1, 0), *places[position]], -1)
    return in_numpy(Layers(tuple(arrays.values())[::2], tuple(arrays.values())[1::2]), values)


def test_gs_sdk_angles_go_down_where_pressed(tmp_path):
    arrays, (image, change) = network_arrays((5, 32, 32, 32, 2)), image_and_change()
    found = slopes_of(read_gs_sdk(torch_file(tmp_path / "nnmodel.pth", arrays), BACKGROUND), change)
    theirs, rest = (np.tan(answered(arrays, one, "xy")) for one in (image, BACKGROUND))
    np.testing.assert_allclose(found, rest - theirs, atol=2e-5)


@pytest.mark.parametrize(("position", "place"), [("zeros", "zeros"), ("true", "yx")])
def test_the_browser_port_of_gsrobotics(tmp_path, position, place):
    """Its network's normals in plain numpy become gradients."""
    path, (image, change) = web_file(tmp_path / "weights.bin", GENTLE), image_and_change()
    found = slopes_of(read_gsrobotics_web(path, BACKGROUND, position=position), change)
    normals = (answered(GENTLE, one, place) for one in (image, BACKGROUND))
    theirs, rest = (-n / np.sqrt(1 - np.sum(n**2, axis=-1, keepdims=True)) for n in normals)
    np.testing.assert_allclose(found, theirs - rest, atol=2e-5)
    path.write_bytes(path.read_bytes()[:-4])
    with pytest.raises(gelform.DataError, match="Expected 35336 bytes"):
        read_gsrobotics_web(path, BACKGROUND, position="true")


@pytest.mark.parametrize("nested", [True, False])
def test_gsrobotics_is_its_browser_ports_network(tmp_path, nested):
    a = read_gsrobotics_web(web_file(tmp_path / "weights.bin", GENTLE), BACKGROUND, position="true")
    b = read_gsrobotics(torch_file(tmp_path / "n.pt", GENTLE, nested=nested), BACKGROUND, position="true")
    change = image_and_change()[1]
    np.testing.assert_array_equal(slopes_of(a, change), slopes_of(b, change))


def test_another_background_is_rest_too(tmp_path):
    model = read_gsrobotics_web(web_file(tmp_path / "w.bin", GENTLE), BACKGROUND, position="true")
    today, differences = BACKGROUND + 3, []
    assert np.abs(slopes_of(model, np.zeros_like(today), today)).max() == 0
    for seed in (1, 7):  # the same image, so only the answer at rest differs
        now = slopes_of(model, image_and_change(seed, today)[1], today)
        differences.append(now - slopes_of(model, image_and_change(seed)[1]))
    np.testing.assert_allclose(*differences, atol=1e-5)


def test_normals_that_are_too_long_stay_finite(tmp_path):
    arrays = network_arrays((5, 64, 64, 64, 2))
    arrays["fc4.bias"] = np.array([2.0, 0.0], dtype=np.float32)
    model = read_gsrobotics_web(web_file(tmp_path / "w.bin", arrays), BACKGROUND, position="true")
    found = slopes_of(model, image_and_change()[1])
    assert np.isfinite(found).all()
    assert np.abs(found).max() <= 10.0 + 1e-5


def older_network(torch, kind):
    """gs_sdk's older network, in its 1x1 convolutions or in the form that it trains, after some training data."""
    torch.manual_seed(0)
    layer, norm = {
        "conv": (lambda n_in, n_out: torch.nn.Conv2d(n_in, n_out, 1), torch.nn.BatchNorm2d),
        "fc": (torch.nn.Linear, torch.nn.BatchNorm1d),
    }[kind]
    parts = {}
    for k, (n_in, n_out) in enumerate(pairwise((5, 128, 32, 32, 2)), start=1):
        parts[f"{kind}{k}"] = layer(n_in, n_out)
        if k < 4:
            parts[f"bn{k}"], parts[f"relu{k}"] = norm(n_out), torch.nn.ReLU()
            torch.nn.init.uniform_(parts[f"bn{k}"].weight, 0.5, 2)
            torch.nn.init.uniform_(parts[f"bn{k}"].bias, -0.5, 0.5)
    network = torch.nn.Sequential(OrderedDict(parts))
    for seed in range(20):
        values = torch.rand((64, 5), generator=torch.Generator().manual_seed(seed))
        network(values[..., None, None] if kind == "conv" else values)
    return network.eval()


@pytest.mark.parametrize("kind", ["conv", "fc"])
def test_older_networks_of_gs_sdk_give_what_torch_gives(tmp_path, kind):
    torch = pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    network = older_network(torch, kind)
    torch.save(network.state_dict(), tmp_path / "nnmodel.pth")
    model = read_gs_sdk(tmp_path / "nnmodel.pth", BACKGROUND)
    assert [weight.shape[0] for weight in model.layers.weights] == [128, 32, 32, 2]

    def slopes(image):
        y, x = np.mgrid[: CALIBRATED[0], : CALIBRATED[1]]
        values = np.concatenate(
            [image[..., ::-1] / 255, (x / CALIBRATED[1])[..., None], (y / CALIBRATED[0])[..., None]], -1
        )
        values = torch.from_numpy(values.reshape(-1, 5).astype(np.float32))
        with torch.no_grad():
            angles = network(values[..., None, None] if kind == "conv" else values)
        return -np.tan(angles.numpy().reshape(*CALIBRATED, 2))

    image, change = image_and_change()
    np.testing.assert_allclose(slopes_of(model, change), slopes(image) - slopes(BACKGROUND), atol=2e-5)


def test_networks_of_another_kind_are_refused(tmp_path):
    touchnet = {f"conv{k}.{part}": np.zeros((32, 5, 3, 3)[: 4 if part == "weight" else 1], np.float32)
                for k in range(1, 5) for part in ("weight", "bias")}  # fmt: skip
    spoilt = network_arrays((5, 32, 8, 8, 2))
    spoilt["fc2.weight"][0, 0] = np.nan
    halved = network_arrays((5, 32, 32, 32, 2)) | {"bn1.running_var": np.ones(32, np.float32)}
    for arrays, said in (
        (touchnet, "looks at neighbors"),
        (network_arrays((5, 32, 2)), "Expected the layers fc1 to fc4"),
        (network_arrays((3, 32, 8, 8, 2)), "5 inputs and 2 outputs"),
        (network_arrays((5, 64, 64, 64, 2)), r"32 or 128 units .* is it gsrobotics's\?"),
        (spoilt, "finite"),
        (halved, r"lacks bn1\.weight"),
    ):
        with pytest.raises(gelform.DataError, match=said):
            read_gs_sdk(torch_file(tmp_path / "net.pth", arrays), BACKGROUND)


class Bomb:
    def __init__(self, made):
        self.made = made

    def __reduce__(self):
        return open, (str(self.made), "w")


def test_no_code_of_a_file_runs(tmp_path):
    torch = pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    made, path, layer = tmp_path / "made", tmp_path / "net.pth", torch.nn.Linear(5, 32)

    def zipped(**members):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in {"data.pkl": b"\x80\x02}.", **members}.items():
                archive.writestr(f"a/{name}", content)

    for write, said in (
        (lambda: torch.save({"fc1.weight": Bomb(made)}, path), "could run code"),
        (lambda: torch.save(layer, path), "could run code"),
        (
            lambda: torch.save(layer.state_dict(), path, _use_new_zipfile_serialization=False),
            r"before version 1\.6.*save it again",
        ),
        (lambda: path.write_bytes(pickle.dumps(Bomb(made))), "could run code"),
        (
            lambda: zipped(**{"constants.pkl": b"\x80\x02)."}),
            r"Expected weights of torch\.save",
        ),  # TorchScript
        (lambda: zipped(**{"data/0": bytes(5 * 2**20)}), r"declares 5\.243 MB"),
    ):
        write()
        with pytest.raises(gelform.DataError, match=said):
            read_gs_sdk(path, BACKGROUND)
    assert not made.exists()


@pytest.mark.parametrize("keep", [0, 10, 300, -30])
def test_truncated_files_are_refused(tmp_path, keep):
    path = torch_file(tmp_path / "net.pth", network_arrays((5, 32, 32, 32, 2)))
    path.write_bytes(path.read_bytes()[:keep])
    with pytest.raises(gelform.DataError, match="truncated or damaged"):
        read_gs_sdk(path, BACKGROUND)


def read_rgb(path):
    return cv2.imread(str(path))[..., ::-1].astype(np.float32)


@pytest.mark.parametrize("name", ["bead", "key", "seed"])
def test_real_gs_sdk_answers_as_published(data, name):
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    reference = np.load(data / "peer-calibrations" / "reference_outputs.npz")[f"gs_sdk_{name}_gradients"]
    background = read_rgb(data / "mini-objects" / "background.png")
    change = (read_rgb(data / "mini-objects" / f"{name}.png") - background) / np.float32(255)
    model = read_gs_sdk(data / "peer-calibrations" / "gs_sdk-mini-c-nnmodel.pth", background)
    np.testing.assert_allclose(slopes_of(model, change, background), -reference, atol=2e-5)


@pytest.mark.parametrize("position", ["zeros", "true"])
def test_real_gsrobotics_answers_as_published(data, position):
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    peers = data / "peer-calibrations"
    normals = np.load(peers / "reference_outputs.npz")[f"gsrobotics_key_normals_xy_{position}"].astype(float)
    background, image = (read_rgb(data / f"mini-objects/{name}.png") for name in ("background", "key"))
    model = read_gsrobotics(peers / "gsrobotics-nnmini.pt", background, position=position)
    prepared = model.prepare(np.zeros_like(background), background.shape[:2])
    rest = prepared._rest.reshape((*image.shape[:2], 2))
    found = prepared.gradients_from_color(image / np.float32(255))[0] + rest
    theirs = -normals / np.sqrt(1 - np.sum(normals**2, axis=-1, keepdims=True))
    np.testing.assert_allclose(found, theirs, atol=1e-4, rtol=1e-4)


def stored(count, key=b"0"):
    """A tensor of a storage that says so many numbers, as torch pickles it."""
    storage = (
        b"(X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\0" + key + b"X\x03\0\0\0cpu" + count + b"tQ"
    )
    rest = b"K\x00K\x04\x85K\x01\x85\x89ccollections\nOrderedDict\n)RtR"
    return b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage + rest


def in_zip(path, pickled):
    """A file of the form of `torch.save` around a dict whose only value is pickled so."""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("net/data.pkl", b"\x80\x02}X\x01\0\0\0a" + pickled + b"s.")
        archive.writestr("net/data/0", bytes(16))
        archive.writestr("net/version", "3\n")  # newer ones of torch ask for it
    return path


LARGE = b"J\xff\xff\xff\x7f"
BOMBS = {
    "a storage of 8 GB": stored(LARGE),
    "its size from the memory": LARGE + b"q\x050" + stored(b"h\x05"),
    "its size before another": stored(LARGE + b"0K\x04" + b"0" + LARGE),
    "a negative one beside it": b"(" + stored(b"J\0\0\0\x80") + stored(LARGE) + b"t",
    "a thousand large ones": b"("
    + b"".join(stored(b"J\0\0\x10\0", b"%d" % (k % 10)) for k in range(1000))
    + b"t",
    "doubled tuples": b"K\x01\x85" + b"q\x00h\x00\x86" * 40,
    "an array of bytes": b"cbuiltins\nbytearray\n" + LARGE + b"\x85R",
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_cannot_take_the_memory_or_for_ever(tmp_path, name):
    with pytest.raises(gelform.DataError, match="holds more than tensors in dicts"):
        read_gs_sdk(in_zip(tmp_path / "net.pth", BOMBS[name]), BACKGROUND)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("others", [["data.pkl"] * 2, ["constants.pkl"]], ids=["a name often", "TorchScript"])
def test_other_archives_are_refused_before_anything_is_read(tmp_path, monkeypatch, others):
    """By its name, each entry of a name would be the last one, which may be far larger than the others declare."""
    with zipfile.ZipFile(tmp_path / "net.pth", "w") as archive:
        for name in (*others, "data.pkl"):
            archive.writestr(f"net/{name}", b"\x80\x02}.")
    monkeypatch.delattr("zipfile.ZipFile.read")
    with pytest.raises(gelform.DataError, match=r"Expected weights of torch\.save"):
        read_gs_sdk(tmp_path / "net.pth", BACKGROUND)


def test_what_torch_writes_is_no_bomb_and_without_torch_the_extra_is_named(tmp_path, data, monkeypatch):
    with monkeypatch.context() as without:
        without.setitem(sys.modules, "torch", None)
        with pytest.raises(
            gelform.DataError, match=r"needs the extra torch: pip install \"gelform\[torch\]\""
        ):
            read_gs_sdk(in_zip(tmp_path / "net.pth", stored(b"K\x04")), BACKGROUND)
    for path in (data / "peer-calibrations").glob("gs_sdk*.pth"):
        if find_spec("torch"):
            assert read_gs_sdk(path, BACKGROUND).layers.inputs == 5
        else:
            with pytest.raises(gelform.DataError, match="needs the extra torch"):
                read_gs_sdk(path, BACKGROUND)


@pytest.fixture
def network(tmp_path):
    return web_file(tmp_path / "weights.bin")


def pressed():
    y, x = np.mgrid[: CALIBRATED[0], : CALIBRATED[1]]
    bump = 40 * np.exp(-((x - 30) ** 2 + (y - 20) ** 2) / 30)
    return np.clip(BACKGROUND + bump[..., None] * np.array([1, -0.5, 0.3]), 1, 254).astype(np.uint8)


def test_unknown_stays_unknown_and_with_a_scale_depth_is_in_mm(network, tmp_path):
    calibration = gelform.import_calibration(network, **WEB)
    assert (calibration.mm_per_px, calibration.forward, calibration.slope_sigma) == (None, None, None)
    assert calibration.settings == {"imported_from": "gsrobotics-web", "position": "true"}
    assert calibration.sensor_name == "weights"
    calibration.save(tmp_path / "cal.npz")
    again = gelform.load_calibration(tmp_path / "cal.npz")
    a, b = (gelform.Reconstructor(one)(pressed()) for one in (calibration, again))
    np.testing.assert_array_equal(a.gradients, b.gradients)
    np.testing.assert_array_equal(a.depth_px, b.depth_px)
    assert a.gradients_sigma is None
    calibration = gelform.import_calibration(network, **WEB, mm_per_px=0.05)
    result = gelform.Reconstructor(calibration)(pressed())
    np.testing.assert_allclose(result.depth_px * 0.05, result.depth_mm, rtol=1e-5)


def test_the_image_is_recovered_from_the_change(network):
    """Through the color change comes what the network says of the image itself, less what it says at rest."""
    calibration = gelform.import_calibration(network, **WEB)
    model, image, black = calibration.color_model, pressed(), np.zeros((*CALIBRATED, 3))
    said = [slopes_of(model, one.astype(np.float32) / np.float32(255), black) for one in (image, BACKGROUND)]
    change = gelform.color_change_from_image(image, BACKGROUND, calibration.change)
    np.testing.assert_allclose(slopes_of(model, change), said[0] - said[1], atol=5e-6)


def test_options_belong_to_packages(network, tmp_path):
    for package, options, why in (
        ("digit-depth", {}, "Expected a package among gs_sdk"),
        ("gs_sdk", {"position": "true"}, "Expected position"),
        ("gsrobotics", {}, "Expected position"),
        ("gsrobotics", {"position": "maybe"}, "Expected position"),
        ("gs_sdk", {"flip_depth": True}, "flip_depth for lut only"),
        ("gs_sdk", {"mm_per_px": -1}, "mm_per_px > 0"),
    ):
        with pytest.raises(ValueError, match=why):
            gelform.import_calibration(network, package, background=BACKGROUND, **options)


def test_untouched_pixels_of_a_real_sensor_are_called_untouched(data):
    """Far from the object, 8 gray levels hold 97 % and more of the pixels; in contact they do not."""
    folder = data / "mini-objects"
    background = gelform.read_image(folder / "background.png").astype(np.float32)
    change = np.abs(gelform.read_image(folder / "key.png").astype(np.float32) - background) / 255
    size = np.linalg.norm(change, axis=-1)
    assert np.mean(size[:, :100] < UNTOUCHED_CHANGE) > 0.97
    assert np.mean(size[110:150, 190:230] < UNTOUCHED_CHANGE) < 0.2


@pytest.mark.parametrize("package", ["gs_sdk", "gsrobotics"])
def test_a_real_press_stands_up(data, package):
    pytest.importorskip("torch", reason="torch, the extra `torch`, is not installed")
    peers = data / "peer-calibrations"
    file = peers / ("gs_sdk-mini-c-nnmodel.pth" if package == "gs_sdk" else "gsrobotics-nnmini.pt")
    calibration = gelform.import_calibration(
        file,
        package,
        background=gelform.read_image(data / "mini-objects" / "background.png"),
        mm_per_px=0.0634,
        position=None if package == "gs_sdk" else "zeros",
    )
    result = gelform.Reconstructor(calibration)(gelform.read_image(data / "mini-objects" / "key.png"))
    assert 0.8 < result.peak_mm < 2.5
    assert result.contact[130:140, 205:225].mean() > 0.6  # its relief is hollow in places
    assert not result.contact[:, :100].any()


def smooth(shape):
    """A background without texture, equal at equal places of the gel whatever its size."""
    y, x = ((np.arange(count) + 0.5) / count for count in shape)
    ramp = 80 + 60 * x[None] + 40 * y[:, None]
    return np.stack([ramp, 230 - ramp, ramp / 2 + 60], axis=-1)


def test_a_frame_of_the_camera_is_cropped_as_the_package_crops(network):
    """One gel, given as the camera's frame and as the package's image: one calibration, and one answer to both."""
    how = {**HOW, "mm_per_px": 0.0634}
    frame = smooth((2464, 3280))
    image = image_from_frame(frame, PROFILES["gelsight-mini"].view((2464, 3280)))
    by_frame = gelform.import_calibration(network, background=frame, **how)
    by_image = gelform.import_calibration(network, background=image, **how)
    assert by_frame.image_shape == by_image.image_shape == (240, 320)
    assert by_frame.view == by_image.view
    np.testing.assert_allclose(by_frame.background, by_image.background, atol=1e-3)
    frame[1200:1300, 1600:1750] += [20, -10, 5]
    seen = image_from_frame(frame, by_frame.view)
    a, b = gelform.Reconstructor(by_image)(frame), gelform.Reconstructor(by_frame)(seen)
    assert a.peak_mm == pytest.approx(b.peak_mm, rel=1e-3)
    halved = gelform.import_calibration(network, background=smooth((480, 640)), **how)
    assert (halved.view.frame_shape, halved.image_shape) == ((480, 640), (240, 320))


def test_a_frame_of_another_sensor_stays_as_it_is(network):
    for shape, pitch in (((480, 640), 0.03), ((480, 640), None), ((240, 320), None), ((300, 427), 0.0634)):
        made = gelform.import_calibration(network, background=smooth(shape), mm_per_px=pitch, **HOW)
        assert made.view.is_identity
        assert made.image_shape == shape


def test_a_gel_that_no_sensor_has_and_the_scale_of_a_frame_are_refused(network):
    for shape, pitch, said in (
        ((2000, 3282), 0.0634, "between 3 and 150 mm wide, got 3282 px of 0.0634 mm: 208 mm"),
        ((240, 320), 0.00634, "got 320 px of 0.00634 mm: 2.03 mm"),
        ((2464, 3280), 0.009, "images of 240x320 px, .*about 0.0634, got 0.009"),
    ):
        with pytest.raises(ValueError, match=said):
            gelform.import_calibration(network, background=smooth(shape), mm_per_px=pitch, **HOW)
