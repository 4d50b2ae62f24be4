"""Each file holds the surface: axes, signs, units; a reader written after the standard finds it in an X3P in meters.

Taxim's formula, written out here, reproduces the forward response and new presses from the exported tables.
"""

import hashlib
import io
import zipfile
from dataclasses import replace
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import gelform
from gelform import CalibrationError, DataError, Reconstruction
from gelform.exchange.exporters.surface import (
    BINS,
    RENDERERS,
    SURFACES,
    depth_from_levels,
    levels_from_depth,
    points_from_result,
    save_surface,
    save_taxim,
    taxim_table,
    x3p_bytes,
)
from gelform.exchange.importers import read_taxim_forward
from gelform.image.background import image_from_color_change
from gelform.result.metrics import ball_gradients
from gelform.simulate import Ball, simulate_press
from made.files import web_file

SHAPE, PITCH = (30, 40), 0.1


@pytest.fixture
def result():
    """A bump, above and left of the middle; the last row is not known."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    depth = np.maximum(0, 1 - ((x - 10) ** 2 + (y - 8) ** 2) / 36).astype(np.float32)
    known = np.ones(SHAPE, dtype=bool)
    known[-1] = False
    gradients = np.zeros((*SHAPE, 2), dtype=np.float32)
    return Reconstruction(
        depth, None, gradients, None, np.ones(SHAPE, np.float32), depth > 0, known, mm_per_px=PITCH
    )


def read(content):
    """Heights (SizeY, SizeX) and pitches, m; every checksum looked at."""
    with zipfile.ZipFile(io.BytesIO(content)) as file:
        main = file.read("main.xml")
        digest, name = file.read("md5checksum.hex").decode().split()
        assert (digest, name) == (hashlib.md5(main).hexdigest(), "*main.xml")
        root = ElementTree.fromstring(main)
        assert root.tag == "{http://www.opengps.eu/2008/ISO5436_2}ISO5436_2"
        data = file.read(root.findtext("Record3/DataLink/PointDataLink"))
        assert hashlib.md5(data).hexdigest() == root.findtext("Record3/DataLink/MD5ChecksumPointData")
    assert root.findtext("Record1/FeatureType") == "SUR"
    assert root.findtext("Record1/Axes/CZ/DataType") == "D"
    size = [int(root.findtext(f"Record3/MatrixDimension/Size{axis}")) for axis in "XYZ"]
    pitch = [float(root.findtext(f"Record1/Axes/C{axis}/Increment")) for axis in "XYZ"]
    return np.frombuffer(data, "<f8").reshape(size[2], size[1], size[0])[0] * pitch[2], pitch[:2]


def test_the_surface_in_meters_also_by_its_ending(result, tmp_path):
    heights, pitch = read(x3p_bytes(result))
    assert pitch == pytest.approx([PITCH * 1e-3] * 2)
    assert heights.shape == SHAPE
    upright = heights[::-1]  # y up
    np.testing.assert_allclose(upright[result.known] * 1e3, result.depth_mm[result.known], rtol=1e-12)
    assert np.isnan(upright[~result.known]).all()
    assert save_surface(result, tmp_path / "a.x3p").read_bytes() == x3p_bytes(result)


def test_points_are_of_the_optical_frame(result):
    x, y, z = points_from_result(result)[8 * SHAPE[1] + 10]
    assert (x, y, z) == pytest.approx(((10 - 19.5) * PITCH, (8 - 14.5) * PITCH, -1))


@pytest.mark.parametrize("ending", [".ply", ".stl"])
def test_meshes_come_back(result, tmp_path, ending):
    trimesh = pytest.importorskip("trimesh", reason="needs the extra 'mesh'")
    mesh = trimesh.load(save_surface(result, tmp_path / f"bump{ending}"), force="mesh")
    assert mesh.bounds[0, 2] == pytest.approx(-1)  # the deepest point is nearest to the camera
    assert mesh.bounds[:, 0] == pytest.approx([-1.95, 1.95])
    middle = mesh.face_normals[np.argmin(np.linalg.norm(mesh.triangles_center - [-0.95, -0.65, -1], axis=1))]
    assert middle[2] < -0.9  # toward the camera
    assert mesh.is_watertight == (ending == ".stl")
    if ending == ".stl":
        base = 3.9 * 2.9 * 0.39  # a tenth of the width thick
        assert mesh.volume == pytest.approx(base + float(result.depth.sum()) * PITCH**2, rel=0.01)


def test_tiff_is_the_depth_and_png_in_16_bits(result, tmp_path):
    path = save_surface(result, tmp_path / "deep" / "bump.tiff")
    np.testing.assert_array_equal(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), result.depth_mm)
    levels = cv2.imread(str(save_surface(result, tmp_path / "bump.png")), cv2.IMREAD_UNCHANGED)
    depth, known = depth_from_levels(levels)
    np.testing.assert_array_equal(known, result.known)
    np.testing.assert_allclose(depth[known], result.depth_mm[known], atol=0.51e-4)


def test_what_cannot_be_written_is_said(result, tmp_path):
    (tmp_path / "there.tiff").write_bytes(b"mine")
    for one, name, error, said in (
        (result, "bump.obj", ValueError, r"\.obj"),
        (replace(result, mm_per_px=None), "bump.tiff", DataError, "mm_per_px"),
        (replace(result, depth=result.depth * 10), "bump.png", DataError, "16 bits"),
        (result, "there.tiff", DataError, "is already there"),
    ):
        with pytest.raises(error, match=said):
            save_surface(one, tmp_path / name)
    assert (tmp_path / "there.tiff").read_bytes() == b"mine"
    assert list(tmp_path.iterdir()) == [tmp_path / "there.tiff"]
    assert set(SURFACES) == {".ply", ".stl", ".tif", ".tiff", ".png", ".x3p"}


DEPTHS = arrays(np.float64, (3, 4), elements=st.floats(-3.2766, 3.2766))


@given(DEPTHS, arrays(bool, (3, 4)))
def test_depth_comes_back(depth, known):
    back, back_known = depth_from_levels(levels_from_depth(depth, known))
    np.testing.assert_array_equal(back_known, known)
    np.testing.assert_allclose(back[known], depth[known], atol=0.5e-4 + 1e-6)
    assert not back[~known].any()


def test_a_level_is_a_tenth_of_a_micrometer_and_out_of_range_is_refused():
    np.testing.assert_array_equal(levels_from_depth([[0.0, 1e-4, -1.0]]), [[32768, 32769, 22768]])
    for depth in [3.3, -3.2769, 1e9]:
        with pytest.raises(DataError, match="16 bits"):
            levels_from_depth([[depth]])
        assert levels_from_depth([[depth]], [[False]]) == 0
    with pytest.raises(TypeError, match="uint16"):
        depth_from_levels(np.zeros((2, 2), dtype=np.uint8))


def rendered(folder, height_px, order):
    """An image (H, W, 3) of a height map in pixels, higher where pressed, as Taxim's and Isaac Lab's sources do it.

    `order` is how the renderer reads bg.jpg: "bgr" as OpenCV gives it, or "rgb" turned round.
    """
    background = cv2.imread(str(folder / "bg.jpg")).astype(float)
    background = background if order == "bgr" else background[..., ::-1]
    tables = np.load(folder / "polycalib.npz", allow_pickle=False)
    bins = int(tables["bins"])
    along_rows, along_columns = np.gradient(height_px)
    steepness = np.arctan(np.hypot(along_rows, along_columns))
    direction = np.arctan2(along_rows, along_columns)
    i = np.floor(steepness / (np.pi / 2 / (bins - 1))).astype(int)
    j = np.floor((direction + np.pi) / (2 * np.pi / (bins - 1))).astype(int)
    x, y = np.meshgrid(np.arange(height_px.shape[1]), np.arange(height_px.shape[0]))
    place = np.stack([x * x, y * y, x * y, x, y, np.ones(x.shape)], axis=-1)
    change = np.stack([(place * tables[f"grad_{c}"][i, j]).sum(-1) for c in "rgb"], axis=-1)
    image = np.clip(background + change, 0, 255)
    return image if order == "rgb" else image[..., ::-1]


def sphere_px(press, mm_per_px):
    """Height in pixels of the ball of a press inside its contact, flat outside."""
    height, width = press.contact.shape
    radius = press.ball_diameter_mm / 2 / mm_per_px
    y, x = np.mgrid[:height, :width]
    square = (x - press.center_px[0]) ** 2 + (y - press.center_px[1]) ** 2
    rim = press.contact_radius_px
    return np.sqrt(radius**2 - np.minimum(square, rim**2)) - np.sqrt(radius**2 - rim**2)


@pytest.fixture(scope="module")
def exported(calibration, tmp_path_factory):
    """The folder by renderer; the table, which takes seconds, is made once."""
    base, table = tmp_path_factory.mktemp("taxim"), taxim_table(calibration)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gelform.exchange.exporters.surface.taxim_table", lambda _: table)
        return {name: save_taxim(calibration, base / name, renderer=name) for name in RENDERERS}


@pytest.fixture(scope="module")
def new_presses(simulated):
    rng = np.random.default_rng(8)
    return [
        simulate_press(simulated.sensor, Ball(radius), depth_mm=0.5, center_mm=center, rng=rng)
        for radius, center in ((3.0, (1.0, 1.0)), (2.8, (-3.0, -1.5)), (3.5, (2.5, -2.0)))
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("renderer", "order"), [("taxim", "bgr"), ("isaaclab", "rgb")])
def test_new_presses_are_rendered_as_well_as_the_forward_response_does(
    calibration, new_presses, exported, renderer, order
):
    folder, ours, theirs = exported[renderer], [], []
    for press in new_presses:
        rows, cols = np.nonzero(press.contact)
        from_middle = np.hypot(cols - press.center_px[0], rows - press.center_px[1])
        inside = from_middle < 0.75 * press.contact_radius_px
        rows, cols = rows[inside], cols[inside]
        image = rendered(folder, sphere_px(press, calibration.mm_per_px), order)
        slopes = np.zeros((*press.contact.shape, 2))
        radius_px = press.ball_diameter_mm / 2 / calibration.mm_per_px
        slopes[rows, cols] = ball_gradients(cols, rows, press.center_px, radius_px)
        forward = image_from_color_change(
            calibration.color_from_gradients(slopes), calibration.background, calibration.change
        )
        for errors, shown in ((ours, forward), (theirs, image)):
            errors.append(np.abs(shown[rows, cols] - press.image[rows, cols].astype(float)).mean())
    assert np.mean(theirs) < 1.2 * np.mean(ours)
    assert np.mean(ours) < 8


@pytest.mark.slow
def test_a_level_gel_is_the_background_and_the_importer_reads_it(calibration, exported):
    exported = exported["taxim"]
    flat = rendered(exported, np.zeros(calibration.image_shape), "bgr")
    np.testing.assert_allclose(flat, calibration.background, atol=4)  # JPEG
    real = np.load(exported / "real_bg.npy")
    np.testing.assert_array_equal(real[..., ::-1], calibration.background)
    assert f"numBins = {BINS}" in (exported / "settings.txt").read_text()
    tables = read_taxim_forward(exported / "polycalib.npz")
    assert tables.table.shape == (BINS, BINS, 3, 6)


def test_what_cannot_be_written_is_said_of_taxim(calibration, tmp_path):
    with pytest.raises(ValueError, match="isaaclab"):
        save_taxim(calibration, tmp_path / "t", renderer="unity")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("x")
    with pytest.raises(DataError, match="holds something"):
        save_taxim(calibration, tmp_path / "full")
    network = web_file(tmp_path / "weights.bin")
    rest = np.rint(calibration.background).astype(np.uint8)
    blind = gelform.import_calibration(
        network, "gsrobotics-web", background=rest, mm_per_px=0.1, position="true"
    )
    with pytest.raises(CalibrationError, match=r"without a forward response.*Calibrate on presses of a ball"):
        save_taxim(blind, tmp_path / "t")
    with pytest.raises(CalibrationError, match="gelform scale"):
        save_taxim(replace(calibration, mm_per_px=None), tmp_path / "t")
    assert not (tmp_path / "t").exists()
