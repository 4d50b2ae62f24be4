"""Calibrations that undo the camera's response, its lens and its crosstalk are better for it."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.calibration.geometry.crosstalk import Crosstalk
from gelform.calibration.geometry.scale import Scale
from gelform.calibration.presses.adjust import with_crosstalk, with_scale, with_view
from gelform.errors import DataError
from gelform.lens import Lens
from gelform.metrics import press_errors
from gelform.simulate import LAYOUTS, Optics, exposed, simulate_ball_presses
from gelform.view import View, image_px_from_frame_px

GAMMA = 2.2


def presses_of(sensor, tmp_path, count=10):
    made = simulate_ball_presses(
        sensor, ball_diameters_mm=[5.0, 8.0], count=count, rng=np.random.default_rng(6), oversample=1
    )
    gelform.save_simulated_presses(tmp_path / "presses", made)
    return made, gelform.read_presses(tmp_path / "presses")


def test_a_known_response_is_undone(tmp_path):
    """Far lights, a camera of gamma 2.2: told, `lambertian` sees linear light; not told, it finds that out."""
    far = replace(LAYOUTS["ring-120"], shape=(120, 160), mm_per_px=0.1268)
    coded = exposed(replace(far, optics=Optics(response_gamma=GAMMA)), 110)
    _, presses = presses_of(coded, tmp_path)
    known = replace(presses, response=1 / GAMMA)
    plain, linear = (gelform.calibrate(one, color_model="lambertian") for one in (presses, known))
    assert linear.change.response == pytest.approx(1 / GAMMA)
    assert linear.color_model.response == pytest.approx(1, abs=0.15)
    assert plain.color_model.response == pytest.approx(1 / GAMMA, abs=0.2)
    assert linear.held_out["normal_free_deg"] < 1.2 * plain.held_out["normal_free_deg"] < 3.5
    assert any("is undone before the color model" in note for note in linear.report.notes)
    linear.save(tmp_path / "cal.npz")
    again = gelform.load_calibration(tmp_path / "cal.npz")
    assert again.change == linear.change
    image = presses.presses[0].image
    np.testing.assert_array_equal(
        gelform.Reconstructor(again)(image).depth_mm, gelform.Reconstructor(linear)(image).depth_mm
    )


def lens_of(sensor):
    """The simulator's distortion as a lens: its unit is half the diagonal."""
    height, width = sensor.shape
    half = np.hypot(height, width) / 2
    return Lens((half, half, (width - 1) / 2, (height - 1) / 2), sensor.optics.distortion)


def test_undoing_the_lens_is_better(sensor, tmp_path):
    """A barrel of 12 % in the corners: without the lens, places and slopes are off; with it the errors fall."""
    bent = replace(sensor, optics=Optics(distortion=(-0.12, 0.0)))
    made, presses = presses_of(bent, tmp_path, count=9)
    straight = with_view(presses, View(sensor.shape, lens=lens_of(bent)), "a known lens")
    errors = {}
    for name, one in (("with", straight), ("without", presses)):
        calibration = gelform.calibrate(one, color_model="polynomial")
        reconstruct = gelform.Reconstructor(calibration)
        assert calibration.settings.get("lens", "") == ("a known lens" if name == "with" else "")
        radius = []
        for press in made.presses:
            result = reconstruct(press.image if name == "without" else frame_of(press, straight.view))
            ball = (*place_of(press, calibration.view), press.contact_radius_px)
            radius.append(
                press_errors(
                    result.depth_mm,
                    result.gradients,
                    circle_px=ball,
                    ball_radius_mm=press.ball_diameter_mm / 2,
                    mm_per_px=sensor.mm_per_px,
                )
            )
        errors[name] = {
            key: float(np.mean([getattr(error, key) for error in radius])) for key in ("normal_deg", "cap_um")
        }
    assert errors["with"]["normal_deg"] < 0.9 * errors["without"]["normal_deg"]


def frame_of(press, view):
    """The frame as the Reconstructor would get it; the view's frames and images have one size here."""
    assert press.image.shape[:2] == view.frame_shape
    return press.image


def place_of(press, view):
    return image_px_from_frame_px([press.center_px], view)[0]


def test_labels_move_with_their_pixels(sensor, tmp_path):
    bent = replace(sensor, optics=Optics(distortion=(-0.12, 0.0)))
    made, presses = presses_of(bent, tmp_path, count=4)
    straight = with_view(presses, View(sensor.shape, lens=lens_of(bent)), "a known lens")
    for press, truth in zip(straight.presses, made.presses):
        x = truth.center_mm[0] / sensor.mm_per_px + (sensor.shape[1] - 1) / 2
        y = truth.center_mm[1] / sensor.mm_per_px + (sensor.shape[0] - 1) / 2
        assert press.label[:2] == pytest.approx((x, y), abs=0.05)
        assert press.digest not in {one.digest for one in presses.presses}
    with pytest.raises(DataError, match="without a view"):
        with_view(straight, straight.view, "again")
    with pytest.raises(DataError, match="size of the grid's images"):
        with_view(presses, View((240, 320), lens=Lens((300, 300, 160, 120))), "other")


def test_scale_and_crosstalk_are_recorded(presses):
    crosstalk = Crosstalk(((1, 0.1, 0), (0, 1, 0.2), (0, 0, 1)), ((0, 0.01, 0),) * 3)
    seen = with_crosstalk(with_scale(presses, Scale(0.11, 0.001, "two points")), crosstalk)
    assert (seen.mm_per_px, seen.mm_per_px_sigma) == (0.11, 0.001)
    assert seen.geometry.settings()["scale_source"] == "two points"
    notes = " ".join(seen.geometry.notes(1.0, seen.mm_per_px_sigma))
    assert "Scale from two points; its standard deviation is 0.001 mm/px" in notes
    assert "Crosstalk is undone before the color model: crosstalk up to 20.0 %" in notes
    assert "absorbed" in " ".join(presses.geometry.notes(1.0, None))


def test_a_path_is_read_and_nothing_else_is_taken(folder):
    assert with_scale(str(folder), Scale(0.1, 0.001, "x")).mm_per_px == 0.1
    with pytest.raises(TypeError, match="Expected presses"):
        with_scale(None, Scale(0.1, 0.001, "x"))
    with pytest.raises(TypeError, match="Expected presses"):
        with_crosstalk([1], Crosstalk(((1.0,) * 3,) * 3, ((0.0,) * 3,) * 3))
    with pytest.raises(TypeError, match="Expected presses"):
        with_view(3, View(), "x")
