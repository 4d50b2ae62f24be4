"""Taxim's formula, written out here, reproduces the forward response and new presses from the exported tables."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError, DataError
from gelform.exchange.exporters.taxim import BINS, save_taxim, taxim_table
from gelform.exchange.importers.tables import read_taxim_forward
from gelform.image.background.change import image_from_color_change
from gelform.result.metrics.ball import ball_gradients
from gelform.simulate import Ball, simulate_press
from made.networks import web_file


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
        patch.setattr("gelform.exchange.exporters.taxim.taxim_table", lambda _: table)
        return {
            renderer: save_taxim(calibration, base / renderer, renderer=renderer)
            for renderer in ("taxim", "isaaclab")
        }


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
        inside = (
            np.hypot(cols - press.center_px[0], rows - press.center_px[1]) < 0.75 * press.contact_radius_px
        )
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


def test_what_cannot_be_written_is_said(calibration, tmp_path):
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
