"""evaluate: says what was seen, uses labels where there are any, and measures through the whole path."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.evaluate import face_height_mm
from gelform.calibration.presses.press_set import FlatPress
from gelform.image.view import View
from gelform.simulate import Punch, simulate_press


def test_seen_presses_are_counted(calibration, presses):
    evaluation = gelform.evaluate(calibration, presses)
    assert evaluation.seen == len(calibration.training_digests)
    other = replace(presses.presses[0], digest="new")
    assert gelform.evaluate(calibration, replace(presses, presses=(other,))).seen == 0


def test_labels_are_used(calibration, presses, simulated):
    truth = simulated.presses[0]
    label = (*truth.center_px, truth.contact_radius_px)
    labeled = replace(presses, presses=(replace(presses.presses[0], label=label),))
    evaluation = gelform.evaluate(calibration, labeled)
    assert evaluation.rows[0]["circle_px"] == label
    assert evaluation.summary["normal_deg"] < 6


def test_flat_punches_are_read_beside_the_balls(calibration, presses, sensor):
    def pressed(center_mm):
        rng = np.random.default_rng(0)
        image = simulate_press(sensor, Punch(4.0), depth_mm=0.25, center_mm=center_mm, rng=rng).image
        flat = FlatPress("flat", image, 0.25, "digest")
        assert repr(flat) == "FlatPress(flat, 0.25 mm high)"
        return flat

    flats = pressed((0.0, 0.0)), pressed((9.0, 0.0))
    evaluation = gelform.evaluate(calibration, replace(presses.subset([0]), flats=flats))
    whole, cut = evaluation.to_dict()["flats"]
    assert whole["read_mm"] == pytest.approx(0.25, rel=0.15)
    assert cut == {"name": "flat", "height_mm": 0.25, "read_mm": None}


def tilted_disc(center, radius, height, tilt, around=6.0):
    """Depth (90, 120) of a disc whose face is tilted along x, and of gel that comes down beside it."""
    y, x = np.mgrid[:90, :120].astype(float)
    distance = np.hypot(x - center[0], y - center[1])
    face = height + tilt * np.clip(x - center[0], -radius, radius)
    return (face * np.exp(-np.maximum(distance - radius, 0) / around)).astype(np.float32)


@pytest.mark.parametrize("tilt", [0.0, 0.002])
@pytest.mark.parametrize("around", [0.5, 3.0, 6.0])
def test_the_middle_of_a_face_is_read_whatever_its_tilt_and_its_surroundings(tilt, around):
    """One that the border cuts has no height."""
    assert face_height_mm(tilted_disc((70, 40), 20, 0.3, tilt, around)) == pytest.approx(0.3, rel=0.02)
    for none in (tilted_disc((10, 40), 20, 0.3, 0), np.zeros((90, 120), np.float32)):
        assert np.isnan(face_height_mm(none))


def test_errors_are_counted_inside_the_edge_of_the_calibrations_contacts(calibration, presses):
    """An imported calibration does not know it: then up to the visible rim."""
    few = presses.subset([0, 3, 5])
    ratio = calibration.settings["contact_radius_ratio"]
    known = gelform.evaluate(calibration, few)
    assert known.where["contact_radius_ratio"] == ratio
    assert known.summary["normal_free_deg"] < known.summary["normal_rim_deg"]
    settings = {name: one for name, one in calibration.settings.items() if name != "contact_radius_ratio"}
    without = gelform.evaluate(replace(calibration, settings=settings), few)
    assert without.where["contact_radius_ratio"] == 1
    assert without.summary["normal_free_deg"] == without.summary["normal_rim_deg"]
    assert without.where["contact"]["normal_deg"] == without.where["rim"]["normal_deg"]


def test_untouched_images_cannot_be_evaluated(calibration, presses):
    rest = replace(presses.presses[0], image=np.round(presses.background).astype(np.uint8))
    with pytest.raises(gelform.DataError, match="could be evaluated"):
        gelform.evaluate(calibration, replace(presses, presses=(rest,)))


def test_paths_are_read(calibration, folder, presses, tmp_path):
    calibration.save(tmp_path / "cal.npz")
    assert gelform.evaluate(str(tmp_path / "cal.npz"), folder) == gelform.evaluate(calibration, presses)
    with pytest.raises(TypeError, match="Expected a Calibration or the path of one, got int"):
        gelform.evaluate(3, presses)
    with pytest.raises(TypeError, match="Expected presses"):
        gelform.evaluate(calibration, 3)


def test_frames_are_seen_through_the_calibrations_view(calibration, presses, simulated):
    """Presses without a view of their own, of the size of the view's frames: also where a flip alone changes them."""
    view = View(presses.image_shape, flip="x")
    label = (*simulated.presses[0].center_px, simulated.presses[0].contact_radius_px)
    turned = tuple(
        replace(press, image=np.ascontiguousarray(press.image[:, ::-1]), label=None)
        for press in presses.presses[:2]
    )
    width = presses.image_shape[1]
    turned = (replace(turned[0], label=(width - 1 - label[0], *label[1:])), turned[1])
    frames = replace(presses, presses=turned, background=np.ascontiguousarray(presses.background[:, ::-1]))
    straight = replace(presses, presses=(replace(presses.presses[0], label=label), presses.presses[1]))
    found = gelform.evaluate(replace(calibration, view=view), frames)
    assert found.rows[0]["circle_px"] == pytest.approx(label)
    assert found.summary == pytest.approx(gelform.evaluate(calibration, straight).summary)
    assert found.seen == 2
