"""Calibration files: the same after a round trip, refused when damaged, altered or newer."""

import json
from pathlib import Path

import numpy as np
import pytest

import gelform
from gelform.calibration_file import KIND
from gelform.errors import CalibrationError
from gelform.npz_files import write_npz

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


def test_no_pickles_and_readable_settings(saved):
    with np.load(saved, allow_pickle=False) as file:
        meta = json.loads(str(file["meta"]))
        assert meta["format"] == "gelform calibration"
        assert meta["format_version"] == 2
        assert meta["mm_per_px"] == pytest.approx(0.1153)
        assert file["background"].dtype == np.float32


def test_existing_file_is_kept(calibration, saved):
    before = saved.read_bytes()
    with pytest.raises(gelform.CalibrationError, match="already there"):
        calibration.save(saved)
    assert saved.read_bytes() == before
    calibration.save(saved, overwrite=True)


@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.99])
def test_truncated_file_is_refused(saved, keep):
    content = saved.read_bytes()
    saved.write_bytes(content[: int(keep * len(content)) if isinstance(keep, float) else keep])
    with pytest.raises(gelform.CalibrationError, match="truncated or damaged"):
        gelform.load_calibration(saved)


def rewritten(path, **changes):
    """The file with some members exchanged and the digest left as it was."""
    with np.load(path) as file:
        members = dict(file)
    meta = json.loads(str(members["meta"]))
    meta.update({k: v for k, v in changes.items() if k in meta})
    members.update({k: v for k, v in changes.items() if k in members})
    members["meta"] = np.array(json.dumps(meta))
    np.savez(path, **members)


def test_altered_array_is_refused(saved):
    with np.load(saved) as file:
        background = file["background"] + 1
    rewritten(saved, background=background)
    with pytest.raises(gelform.CalibrationError, match="altered"):
        gelform.load_calibration(saved)


def test_altered_scale_is_refused(saved):
    rewritten(saved, mm_per_px=0.05)
    with pytest.raises(gelform.CalibrationError, match="altered"):
        gelform.load_calibration(saved)


def test_newer_format_names_the_version_to_install(saved):
    rewritten(saved, format_version=99, gelform_version="7.0.0")
    with pytest.raises(gelform.CalibrationError, match=r"7\.0\.0"):
        gelform.load_calibration(saved)


def test_a_result_is_no_calibration(calibration, simulated, tmp_path):
    path = tmp_path / "result.npz"
    gelform.save_result(gelform.Reconstructor(calibration)(simulated.presses[0].image), path)
    with pytest.raises(
        gelform.CalibrationError, match="Expected a gelform calibration, got a gelform result"
    ):
        gelform.load_calibration(path)


def test_missing_file(tmp_path):
    with pytest.raises(gelform.CalibrationError, match="No file"):
        gelform.load_calibration(tmp_path / "nothing.npz")


def test_forward_response_wants_a_frame(calibration):
    with pytest.raises(ValueError, match="Expected gradients of shape"):
        calibration.color_from_gradients(np.zeros((3, 3, 2)))


def test_calibrations_of_every_format_are_read():
    """Written by earlier releases; version 1 had no gamut."""
    first, second = (gelform.load_calibration(DATA / f"calibration-version-{k}.npz") for k in (1, 2))
    assert (first.color_model.name, second.color_model.name) == ("polynomial", "hierarchical")
    assert first.gamut is None
    assert second.gamut.slope_per_change == pytest.approx(0.8, rel=0.2)
    assert second.slope_sigma.place[0] == (1.0, 1.1, 0.9, 1.0)
    change = np.full((24, 32, 3), 0.1, dtype=np.float32)
    model = second.color_model.prepare(second.background, second.image_shape)
    gradients = model.gradients_from_color(change)[0][[3, 20], [5, 30]]
    expected = [[0.00278398, 0.02183242], [-0.00439062, 0.03180937]]  # by the release that wrote it
    np.testing.assert_allclose(gradients, expected, rtol=1e-5)
    for one in (first, second):
        assert gelform.Reconstructor(one)(one.background).shape == (24, 32)


def test_the_first_format_is_read_for_ever(calibration, simulated, tmp_path):
    """Version 1 had a law of two figures for sigma and no gamut."""
    arrays, meta = calibration._contents()
    arrays = {name: array for name, array in arrays.items() if not name.startswith("gamut")}
    del meta["gamut"]
    meta["slope_sigma"] = {"rest": 0.02, "growth": 0.1, "clean": 0.04, "correlation_px": 9.0}
    write_npz(tmp_path / "old.npz", arrays, meta, kind=KIND, version=1, error=CalibrationError)
    old = gelform.load_calibration(tmp_path / "old.npz")
    assert old.gamut is None
    assert old.slope_sigma.clean == 0.04
    image = simulated.presses[0].image
    fresh = gelform.Reconstructor(calibration, solver="dct")(image)
    np.testing.assert_array_equal(gelform.Reconstructor(old, solver="dct")(image).depth_mm, fresh.depth_mm)
