"""Calibration files: the same after a round trip, refused when damaged, altered or newer."""

import base64
import json
import re
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration_file import FORMAT_VERSION, KIND
from gelform.errors import CalibrationError
from gelform.foundations.files import write_npz
from made import small_gel

DATA = Path(__file__).parent / "data"


@pytest.fixture
def saved(calibration, tmp_path):
    path = tmp_path / "cal.npz"
    calibration.save(path)
    return path


def test_round_trip_gives_the_same_answers(calibration, saved, simulated):
    again = gelform.load_calibration(saved)
    assert again.digest == calibration.digest
    assert again.describe().keys() == calibration.describe().keys()
    assert again.held_out == calibration.held_out
    image = simulated.presses[0].image
    a, b = (gelform.Reconstructor(c)(image) for c in (calibration, again))
    np.testing.assert_array_equal(a.depth_mm, b.depth_mm)
    assert again.forward.step_sigma is not None
    for name in ("step_sigma", "residual_scale", "nodes", "covariance", "clipped"):
        np.testing.assert_array_equal(getattr(again.forward, name), getattr(calibration.forward, name))


def test_settings_have_types_and_keep_names_of_others(calibration, saved):
    """Programs name them by keys too."""
    loaded = gelform.load_calibration(saved).settings
    assert loaded == calibration.settings
    ratio = loaded.contact_radius_ratio
    assert ratio == loaded["contact_radius_ratio"] == dict(loaded)["contact_radius_ratio"]
    assert loaded.gel_thickness_mm is None
    assert "gel_thickness_mm" not in loaded
    other = replace(calibration, settings={"zone": 0.8, "camera": {"gain": 2.0}}).settings
    assert (other.camera, other["zone"], len(other)) == ({"gain": 2.0}, 0.8, 2)
    with pytest.raises(KeyError):
        other["lens"]


def test_no_pickles_and_readable_settings(saved):
    with np.load(saved, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
        assert (meta["format"], meta["format_version"]) == ("gelform calibration", 1)
        assert meta["mm_per_px"] == pytest.approx(0.1153)
        assert file["background"].dtype == np.float32


def test_what_cannot_be_read_or_written_is_a_calibration_error(calibration, saved, tmp_path):
    """How files are altered and cut: tests/foundations."""
    with pytest.raises(CalibrationError, match="already there"):
        calibration.save(saved)
    write_npz(tmp_path / "new.npz", {}, {}, kind=KIND, version=99)
    saved.write_bytes(saved.read_bytes()[:-100])
    for path, said in ((tmp_path / "new.npz", "up to version 1"), (saved, "truncated or damaged")):
        with pytest.raises(CalibrationError, match=said):
            gelform.load_calibration(path)


def test_a_result_is_no_calibration_and_a_response_wants_a_frame(calibration, simulated, tmp_path):
    path = tmp_path / "result.npz"
    gelform.save_result(gelform.Reconstructor(calibration)(simulated.presses[0].image), path)
    said = "Expected a gelform calibration, got a gelform result"
    with pytest.raises(gelform.CalibrationError, match=said):
        gelform.load_calibration(path)
    with pytest.raises(ValueError, match="Expected gradients of shape"):
        calibration.color_from_gradients(np.zeros((3, 3, 2)))


def test_the_first_format_is_read():
    """Of a gel that is known exactly, with a forward response that takes a step: its depth is still the truth."""
    first = gelform.load_calibration(DATA / "calibration-version-1.npz")
    assert (first.color_model.name, first.forward.step_sigma) == ("lambertian", (0.02, 0.05))
    touch = small_gel.Touch()
    result = gelform.Reconstructor(first)(small_gel.image_of(touch))
    assert small_gel.depth_error(result.depth_mm, touch) is None
    assert result.depth_mm.max() == pytest.approx(0.3985, abs=5e-4)

    # With a new format comes a file of the one before, written by the release that wrote it.
    kept = {int(path.stem.rsplit("-", 1)[1]) for path in DATA.glob("calibration-version-*.npz")}
    assert kept == set(range(1, FORMAT_VERSION + 1))


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("forward_nodes", np.zeros((9, 12, 16, 3)), "Expected forward nodes"),
        ("forward_covariance", -np.eye(3), "Expected forward nodes"),
        ("forward_covariance", None, "'covariance' is missing"),
        ("background_noise", np.ones((2, 3)), r"Expected background_noise of shape \(3,\)"),
        ("sensor_name", 3, "Expected sensor_name of another type, got int"),
        ("serial", 3, "Expected serial of another type"),
        ("held_out", [], "Expected held_out of another type"),
        ("training_digests", {}, "Expected training_digests of another type"),
        ("slope_sigma", [], "Expected slope_sigma of another type"),
        ("image_shape", [132], "Expected image_shape as two whole numbers"),
        ("image_shape", [132, -176], "Expected image_shape as two whole numbers"),
        ("color_model", "magic", "Expected a color model among lambertian, .*, got 'magic'"),
        ("mm_per_px", -1.0, "Expected mm_per_px > 0"),
        ("mm_per_px_sigma", -1.0, "Expected mm_per_px_sigma between"),
        ("untouched_change", -1.0, "Expected untouched_change between"),
        ("settings", {"place_error": 2.0}, "Expected place_error between"),
        ("settings", {"gel_thickness_mm": 99.0}, "Expected gel_thickness_mm between"),
        ("settings", {"starter": {"spread": 2.0}}, "Expected spread between"),
    ],
)
def test_what_does_not_fit_together_is_damage(calibration, tmp_path, name, value, said):
    arrays, meta = calibration.contents()
    (arrays if name in arrays else meta)[name] = value
    kept = {key: one for key, one in arrays.items() if one is not None}
    write_npz(tmp_path / "x.npz", kept, meta, kind=KIND, version=1)
    with pytest.raises(CalibrationError, match=f"is damaged: .*{said}"):
        gelform.load_calibration(tmp_path / "x.npz")


def test_it_is_shown_in_a_line_and_in_a_notebook_with_its_background(calibration):
    line = repr(calibration)
    assert len(line) < 300
    for part in ("sensor: simulated", "132x176 px", "mm per pixel", f"model: {calibration.color_model.name}"):
        assert part in line
    assert f"off by {calibration.held_out['normal_free_deg']:.2g} degrees" in line
    named = replace(calibration, sensor_name="<b>mine</b>", mm_per_px=None)
    assert "scale: unknown" in repr(named)
    shown = named._repr_html_()
    assert "&lt;b&gt;mine" in shown
    picture = re.search(r"base64,([^']+)'", shown)[1]
    pixels = cv2.imdecode(np.frombuffer(base64.b64decode(picture), np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
    assert pixels.shape == (180, 240, 3)
    middle = calibration.background.mean(axis=(0, 1))
    np.testing.assert_allclose(pixels.mean(axis=(0, 1)), middle, atol=1.5)


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp", ".tif", ".webp"])
def test_a_picture_in_the_place_of_a_calibration_names_its_reader(ending, tmp_path):
    path = tmp_path / f"frame{ending}"
    cv2.imwrite(str(path), np.full((8, 8, 3), 100, np.uint8))
    for call in (gelform.Reconstructor, gelform.load_calibration):
        with pytest.raises(CalibrationError, match=r"got the picture .*gelform\.read_image\(path\)"):
            call(path)


def test_a_picture_s_path_in_the_place_of_an_image_names_its_reader(polynomial_calibration):
    reconstruct = gelform.Reconstructor(polynomial_calibration)
    with_background = partial(gelform.Reconstructor, polynomial_calibration)
    for call in (reconstruct, reconstruct.from_image, with_background):
        with pytest.raises(TypeError, match=r"gelform\.read_image\(path\)"):
            call("frame.png")


def test_the_digest_is_of_the_content_not_of_the_names_of_unit_and_gel(polynomial_calibration, tmp_path):
    named = replace(polynomial_calibration, serial="S7", gel_id="g")
    assert named.digest == polynomial_calibration.digest
    named.save(tmp_path / "named.npz")
    assert gelform.load_calibration(tmp_path / "named.npz").digest == polynomial_calibration.digest
    assert replace(polynomial_calibration, mm_per_px=0.5).digest != polynomial_calibration.digest
