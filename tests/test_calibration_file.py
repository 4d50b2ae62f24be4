"""Calibration files: the same after a round trip, refused when damaged, altered or newer."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform.calibration_file import FORMAT_VERSION, KIND
from gelform.color_models._shared.least_squares import polynomial_terms, unit_position
from gelform.errors import CalibrationError
from gelform.foundations.npz_files import write_npz
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
    """Files and programs of earlier releases name them by keys."""
    loaded = gelform.load_calibration(saved).settings
    assert loaded == calibration.settings
    assert (
        loaded.contact_radius_ratio == loaded["contact_radius_ratio"] == dict(loaded)["contact_radius_ratio"]
    )
    assert loaded.gel_thickness_mm is None
    assert "gel_thickness_mm" not in loaded
    older = replace(calibration, settings={"zone": 0.8, "camera": {"gain": 2.0}}).settings
    assert (older.camera, older["zone"], len(older)) == ({"gain": 2.0}, 0.8, 2)
    with pytest.raises(KeyError):
        older["lens"]


def test_no_pickles_and_readable_settings(saved):
    with np.load(saved, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
        assert (meta["format"], meta["format_version"]) == ("gelform calibration", 3)
        assert meta["mm_per_px"] == pytest.approx(0.1153)
        assert file["background"].dtype == np.float32


def test_what_cannot_be_read_or_written_is_a_calibration_error(calibration, saved, tmp_path):
    """How files are altered, cut and of newer formats: test_npz_files."""
    with pytest.raises(CalibrationError, match="already there"):
        calibration.save(saved)
    with np.load(saved) as file:
        members = dict(file)
    meta = json.loads(str(members["meta"]))
    for change, said in (({"mm_per_px": 0.05}, "altered"), ({"format_version": 99}, "up to version 3")):
        altered = np.array(json.dumps(meta | change))
        np.savez(tmp_path / "altered.npz", **{**members, "meta": altered})
        with pytest.raises(CalibrationError, match=said):
            gelform.load_calibration(tmp_path / "altered.npz")
    saved.write_bytes(saved.read_bytes()[:-100])
    with pytest.raises(CalibrationError, match="truncated or damaged"):
        gelform.load_calibration(saved)
    with pytest.raises(CalibrationError, match="No file"):
        gelform.load_calibration(tmp_path / "nothing.npz")


def test_a_result_is_no_calibration_and_a_response_wants_a_frame(calibration, simulated, tmp_path):
    path = tmp_path / "result.npz"
    gelform.save_result(gelform.Reconstructor(calibration)(simulated.presses[0].image), path)
    said = "Expected a gelform calibration, got a gelform result"
    with pytest.raises(gelform.CalibrationError, match=said):
        gelform.load_calibration(path)
    with pytest.raises(ValueError, match="Expected gradients of shape"):
        calibration.color_from_gradients(np.zeros((3, 3, 2)))


def test_calibrations_of_the_first_formats_are_read():
    """Written by earlier releases; their forward responses, polynomials of the slopes, are translated, and take no step."""
    first, second = (gelform.load_calibration(DATA / f"calibration-version-{k}.npz") for k in (1, 2))
    assert (first.color_model.name, second.color_model.name) == ("polynomial", "hierarchical")
    assert second.slope_sigma.place[0] == (1.0, 1.1, 0.9, 1.0)
    change = np.full((24, 32, 3), 0.1, dtype=np.float32)
    model = second.color_model.prepare(second.background, second.image_shape)
    gradients = model.gradients_from_color(change)[0][[3, 20], [5, 30]]
    expected = [[0.00278398, 0.02183242], [-0.00439062, 0.03180937]]  # by the release that wrote it
    np.testing.assert_allclose(gradients, expected, rtol=1e-5)
    y, x = (axis.ravel() for axis in np.mgrid[:24, :32])
    for k, one in enumerate((first, second), 1):
        assert one.forward.step_sigma is None
        assert 0.2 < one.forward.slope_per_change < 5
        assert gelform.Reconstructor(one)(one.background).shape == (24, 32)
        with np.load(DATA / f"calibration-version-{k}.npz") as file:
            known = file["forward_coefficients"]
        slopes = np.random.default_rng(k).uniform(-0.4, 0.4, (24 * 32, 2))
        expected = polynomial_terms(slopes, *unit_position(x, y, (24, 32)), (1, 0)) @ known
        found = one.color_from_gradients(slopes.reshape(24, 32, 2)).reshape(-1, 3)
        np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())


def test_the_third_format_is_read():
    """Of a gel that is known exactly, with a forward response that takes a step: its depth is still the truth."""
    third = gelform.load_calibration(DATA / "calibration-version-3.npz")
    assert (third.color_model.name, third.forward.step_sigma) == ("lambertian", (0.02, 0.05))
    touch = small_gel.Touch()
    result = gelform.Reconstructor(third, solver="dct")(small_gel.image_of(touch))
    assert small_gel.depth_error(result.depth_mm, touch) is None
    assert result.depth_mm.max() == pytest.approx(0.3985, abs=5e-4)


def test_a_file_of_every_format_is_kept():
    """With a new format comes a file of the one before, written by the release that wrote it."""
    kept = {int(path.stem.rsplit("-", 1)[1]) for path in DATA.glob("calibration-version-*.npz")}
    assert kept == set(range(1, FORMAT_VERSION + 1))


def older(calibration, knows_depth, **more):
    """Arrays and settings as format 2 had them: of the forward response, of the gamut, of two rules of the slope sigma."""
    arrays, meta = calibration.contents()
    arrays = {name: array for name, array in arrays.items() if not name.startswith("forward")}
    rng = np.random.default_rng(0)
    coefficients = rng.normal(0, 0.05, (110 if knows_depth else 50, 3))
    first = [0, 10] if not knows_depth else [0, 10, 50, 60]
    coefficients[first] = np.resize([[0.3, -0.2, -0.1], [0.0, 0.2, -0.3]], (len(first), 3))
    arrays |= {"forward_coefficients": coefficients, "forward_noise": np.array([0.013, 0.010, 0.012])}
    arrays |= {"gamut_distance": np.zeros((24, 24, 24), np.float32), "gamut_low": np.full(3, -1.0)}
    meta["gamut"] = {"cell": 0.076, "slope_per_change": 0.96}
    meta["forward_settings"] = {"position_degrees": [3, 2, 1], "held_out_noise": 0.027, "shadow_noise": None}
    steepest = [[0.45] * 8] * 6
    meta["slope_sigma"] = {**meta["slope_sigma"], "surround_sigma": 0.034, "steepest": steepest}
    settings = {name: one for name, one in meta["settings"].items() if name != "contact_radius_ratio"}
    meta["settings"] = {**settings, "zone": 0.8}
    return arrays, {**meta, **more}


@pytest.mark.parametrize("knows_depth", [False, True])
def test_the_second_format_is_read_for_ever(calibration, simulated, tmp_path, knows_depth):
    """Its color model reads what it read; what is an outlier is told by the noise that it knew."""
    arrays, meta = older(calibration, knows_depth)
    write_npz(tmp_path / "old.npz", arrays, meta, kind=KIND, version=2, error=CalibrationError)
    old = gelform.load_calibration(tmp_path / "old.npz")
    assert old.forward.step_sigma is None
    noise = arrays["forward_noise"]
    assert old.forward.residual_scale == pytest.approx(0.027**2 / np.mean(noise**2))
    np.testing.assert_allclose(np.diag(old.forward.covariance), noise**2)
    assert (np.abs(old.forward.nodes[:, :, -3]).max() > 0) == knows_depth
    image = simulated.presses[0].image
    plain = replace(calibration, forward=replace(calibration.forward, step_sigma=None))
    fresh, found = (gelform.Reconstructor(one, solver="dct")(image) for one in (plain, old))
    np.testing.assert_array_equal(found.depth_mm, fresh.depth_mm)
    assert found.gradients_sigma is not None
    assert gelform.Reconstructor(old).explain(image).shares["law"] > 0.3
    old.save(tmp_path / "again.npz")
    again = gelform.load_calibration(tmp_path / "again.npz")
    assert again.digest == old.digest
    np.testing.assert_array_equal(again.forward.nodes, old.forward.nodes)


def test_the_first_format_is_read_for_ever(calibration, simulated, tmp_path):
    """Version 1 had a law of two figures for sigma, and no gamut."""
    arrays, meta = older(calibration, knows_depth=False)
    arrays = {name: array for name, array in arrays.items() if not name.startswith("gamut")}
    del meta["gamut"]
    meta["forward_settings"] = {"position_degrees": [3, 2, 1]}
    meta["slope_sigma"] = {"rest": 0.02, "growth": 0.1, "clean": 0.04, "correlation_px": 9.0}
    write_npz(tmp_path / "old.npz", arrays, meta, kind=KIND, version=1, error=CalibrationError)
    old = gelform.load_calibration(tmp_path / "old.npz")
    assert old.forward.residual_scale == 1
    assert old.slope_sigma.clean == 0.04
    image = simulated.presses[0].image
    plain = replace(calibration, forward=None)
    fresh = gelform.Reconstructor(plain, solver="dct")(image)
    np.testing.assert_array_equal(gelform.Reconstructor(old, solver="dct")(image).depth_mm, fresh.depth_mm)


@pytest.mark.parametrize("name", ["depth_aware", "depth_by_lights"])
def test_color_models_that_are_no_more_name_the_release_that_reads_them(calibration, tmp_path, name):
    arrays, meta = older(calibration, knows_depth=True, color_model=name)
    write_npz(tmp_path / "old.npz", arrays, meta, kind=KIND, version=2, error=CalibrationError)
    with pytest.raises(
        CalibrationError, match=rf"color model is {name}, .*Calibrate again.* gelform 0\.1\.0"
    ):
        gelform.load_calibration(tmp_path / "old.npz")


def test_a_response_that_does_not_fit_together_is_damage(calibration, tmp_path):
    arrays, meta = calibration.contents()
    nodes, covariance = arrays["forward_nodes"], arrays["forward_covariance"]
    less = {name: one for name, one in arrays.items() if name != "forward_covariance"}
    for k, (damaged, said) in enumerate(
        (
            ({**arrays, "forward_nodes": nodes[:, :, :16]}, "Expected forward nodes"),
            ({**arrays, "forward_covariance": -covariance}, "Expected forward nodes"),
            (less, "'covariance' is missing"),
        )
    ):
        write_npz(tmp_path / f"{k}.npz", damaged, meta, kind=KIND, version=3, error=CalibrationError)
        with pytest.raises(CalibrationError, match=f"is damaged: {said}"):
            gelform.load_calibration(tmp_path / f"{k}.npz")
