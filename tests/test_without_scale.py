"""Calibrations without a scale, a forward response or a deviation, as importers make them; and old files."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.simulate.twin import Twin


@pytest.fixture
def bare(calibration):
    """The calibration with everything taken away that an importer may not know."""
    return replace(calibration, mm_per_px=None, mm_per_px_sigma=None, forward=None, slope_sigma=None)


@pytest.fixture
def image(simulated):
    return simulated.presses[1].image


def test_depth_in_pixels_and_none_in_mm(bare, image):
    result = gelform.Reconstructor(bare)(image)
    for name in ("depth_mm", "peak_mm"):
        with pytest.raises(gelform.GelformError, match=r"scale .* unknown.*depth_px.*--mm-per-px"):
            getattr(result, name)
    assert result.mm_per_px is None
    scaled = gelform.Reconstructor(replace(bare, mm_per_px=0.1153))(image)
    np.testing.assert_array_equal(result.observed_gradients, scaled.observed_gradients)
    np.testing.assert_allclose(result.gradients, scaled.gradients, atol=2e-3)
    np.testing.assert_array_equal(scaled.depth_px, scaled.depth_mm / np.float32(0.1153))
    assert np.abs(result.depth_px - scaled.depth_px).max() < 0.02 * scaled.depth_px.max()
    assert scaled.depth_px.max() > 3
    assert scaled.contact.any()
    of_usual_width = gelform.Reconstructor(replace(bare, mm_per_px=20 / bare.image_shape[1]))(image)
    np.testing.assert_array_equal(result.contact, of_usual_width.contact)


def test_depth_in_pixels_is_the_least_squares_surface_of_the_slopes(bare, image):
    result = gelform.Reconstructor(bare, solver="dct")(image)
    wanted = gelform.depth_from_gradients(result.observed_gradients, mm_per_px=1.0, solver="dct")
    found = result.depth_px - result.depth_px.mean()
    np.testing.assert_allclose(found, wanted - wanted.mean(), atol=2e-4 * np.ptp(wanted))


def test_no_claim_of_confidence_but_for_clipped_pixels(bare, image):
    clipped = image.copy()
    clipped[10:14, 20:25, 1] = 255
    clipped[30, 40, 2] = 0
    result = gelform.Reconstructor(bare)(clipped)
    assert result.gradients_sigma is None
    there = ((clipped <= 2) | (clipped >= 254)).any(axis=-1)
    assert 0 < np.count_nonzero(there) < 1000
    assert result.confidence[there].max() < 1e-5
    reached = cv2.dilate(there.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    assert (result.confidence[~reached] == 1).all()


def test_the_file_of_a_bare_calibration(bare, image, tmp_path):
    bare.save(tmp_path / "bare.npz")
    again = gelform.load_calibration(tmp_path / "bare.npz")
    assert again.digest == bare.digest
    assert (again.mm_per_px, again.forward, again.slope_sigma) == (None, None, None)
    a, b = (gelform.Reconstructor(one)(image).depth_px for one in (bare, again))
    np.testing.assert_array_equal(a, b)


def test_the_file_of_a_result_in_pixels_and_of_one_in_mm(bare, calibration, image, tmp_path):
    path = tmp_path / "result.npz"
    for known, there, absent in (
        (bare, "depth_px", {"depth_mm", "mm_per_px"}),
        (calibration, "depth_mm", {"depth_px"}),
    ):
        result = gelform.Reconstructor(known)(image)
        gelform.save_result(result, path, overwrite=True)
        with np.load(path) as file:
            assert not absent & set(file.files)
            np.testing.assert_array_equal(file[there], getattr(result, there))
            assert json.loads(str(file["meta"]))["format_version"] == 1
        again = gelform.load_result(path)
        np.testing.assert_array_equal(again.depth_px, result.depth_px)
        assert again.mm_per_px == known.mm_per_px
        if known is bare:
            with pytest.raises(gelform.GelformError, match="scale"):
                again.depth_mm  # noqa: B018
    with pytest.raises(gelform.GelformError, match="square pixels"):
        replace(result, mm_per_px=(0.1, 0.2)).depth_px  # noqa: B018


def test_shown_in_pixels(bare, image):
    result = gelform.Reconstructor(bare)(image)
    assert "scale unknown" in repr(result)
    assert " mm" not in repr(result)
    assert "scale unknown" in result._repr_html_()
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    assert gelform.picture(result, image).shape[2] == 3


def test_what_needs_more_says_so(bare, presses):
    with pytest.raises(gelform.CalibrationError, match="without a forward response"):
        bare.color_from_gradients(np.zeros((*bare.image_shape, 2)))
    with pytest.raises(gelform.CalibrationError, match=r"scale .* unknown"):
        Twin(bare)
    with pytest.raises(gelform.GelformError, match=r"scale .* unknown"):
        gelform.evaluate(bare, presses)
