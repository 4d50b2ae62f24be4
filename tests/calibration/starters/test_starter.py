"""The light of a make: smooth, thirty numbers, and what tells an uneven background from it.

Starters: depth of a unit that was never pressed, from its untouched image and what other units have shown.
"""

import re
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import gelform
from gelform.calibration.starters import (
    FOLDER,
    calibration_from_background,
    check_light,
    image_of_light,
    levels_from_light,
    light_from_background,
    load_starter,
    read_starter,
    starter_for,
    starter_from_calibration,
    starter_names,
    starter_of_source,
)
from gelform.calibration_file import load_calibration
from gelform.errors import CalibrationError, SensorError
from gelform.result.metrics import press_errors
from gelform.sensors.profiles import SENSORS
from gelform.simulate import LAYOUTS, Ball, Punch, simulate_background, simulate_press


def test_an_uneven_background_is_warned_of():
    make = load_starter("gelsight-mini")
    touched = make.calibration.background.copy()
    touched[40:200, 80:140] *= np.float32([1.3, 0.8, 1.2])
    names = {one.name for one in check_light(touched, make.light, make.make)}
    assert "background_touched" in names
    assert check_light(make.calibration.background, make.light, make.make) == ()


def test_a_dark_surround_is_named_with_the_crop_that_fits():
    make, other = load_starter("gelsight-mini"), load_starter("digit")
    image = make.calibration.background.copy()
    image[-20:] = 2
    found = {one.name: one for one in check_light(image, make.light, make.make)}
    assert found["dark_surround"].figure == pytest.approx(20 / len(image), abs=0.01)
    assert "crop the frames to 0,0,320,215" in found["dark_surround"].message
    with pytest.raises(CalibrationError, match=r"Is it another sensor.*crop the frames to 0,0,320,215"):
        check_light(image, other.light, other.make)


@pytest.mark.parametrize("shape", [(240, 320), (320, 240), (41, 60)])
def test_a_smooth_light_comes_back_from_its_image(shape):
    y, x = np.mgrid[: shape[0], : shape[1]] / np.array(shape).reshape(2, 1, 1)
    logs = np.stack([4 + 0.5 * x - x * y, 4.2 - y**3, 3.9 + 0.3 * x**2 * y], axis=-1)
    light = light_from_background(np.exp(logs) - 1)
    np.testing.assert_allclose(levels_from_light(light, x, y), np.exp(logs) - 1, rtol=0.05)


SIMULATED = "simulated-three-edges"
MAX_BYTES = 300_000


@pytest.fixture(scope="module")
def layout():
    return LAYOUTS["three-edges"]


@pytest.fixture(scope="module")
def background(layout):
    return simulate_background(layout, np.random.default_rng(5))


def test_every_starter_is_small_and_says_what_it_was_made_from():
    assert set(starter_names()) >= {"gelsight-mini", "digit", SIMULATED}
    for name in starter_names():
        starter = load_starter(name)
        assert (FOLDER / f"{name}.npz").stat().st_size <= MAX_BYTES
        assert starter.units
        assert 0.01 < starter.spread < 0.2
        assert starter.calibration.background.shape == (*starter.calibration.image_shape, 3)
        smooth = image_of_light(
            light_from_background(starter.calibration.background), starter.calibration.image_shape
        )
        np.testing.assert_allclose(
            smooth, starter.calibration.background, rtol=0.01, err_msg="an image lies in it"
        )


def test_a_unit_that_was_never_pressed_is_read(layout, background):
    calibration = calibration_from_background(background, SIMULATED, serial="S1")
    press = simulate_press(layout, Ball(2.5), depth_mm=0.4, rng=np.random.default_rng(6))
    result = gelform.Reconstructor(calibration)(press.image)
    height, width = layout.shape
    radius_px = np.sqrt(press.contact.sum() / np.pi)
    errors = press_errors(
        result.depth_mm, result.gradients, circle_px=((width - 1) / 2, (height - 1) / 2, radius_px),
        ball_radius_mm=2.5, mm_per_px=calibration.known_mm_per_px, contact_radius_ratio=0.85,
    )  # fmt: skip
    assert errors.normal_free_deg < 3
    assert abs(errors.radius_percent) < 10
    assert (calibration.serial, calibration.held_out) == ("S1", {})


def test_every_result_says_that_it_is_a_starter_s_and_how_far_off_it_may_be(background):
    calibration = calibration_from_background(background, SIMULATED)
    result = gelform.Reconstructor(calibration)(background.round().astype(np.uint8))
    finding = next(one for one in result.health if one.name == "starter")
    assert finding.figure == calibration.unit_spread == load_starter(SIMULATED).spread
    assert f"{100 * calibration.unit_spread:.0f} %" in finding.message


def test_the_spread_between_units_is_in_the_stated_deviations(layout, background):
    calibration = calibration_from_background(background, SIMULATED)
    alike = {**calibration.settings.starter, "spread": 0.0}
    known = replace(
        calibration,
        settings=replace(calibration.settings, starter=alike),
        slope_sigma=load_starter(SIMULATED).calibration.slope_sigma,
    )
    image = simulate_press(layout, Punch(3.0), depth_mm=0.3, rng=np.random.default_rng(7)).image
    wide, narrow = (gelform.Reconstructor(one)(image) for one in (calibration, known))
    np.testing.assert_array_equal(wide.depth_mm, narrow.depth_mm)
    slope = np.linalg.norm(narrow.gradients, axis=-1)
    expected = np.hypot(narrow.gradients_sigma[..., 0], calibration.unit_spread * slope)
    np.testing.assert_allclose(wide.gradients_sigma[..., 0], expected, rtol=0.1)  # by slopes as read
    deep = narrow.depth_mm > 0.2
    added = np.sqrt(np.maximum(wide.depth_sigma_mm**2 - narrow.depth_sigma_mm**2, 0))[deep]
    ratio = added / (calibration.unit_spread * np.abs(narrow.depth_mm[deep]))
    assert 0.8 < ratio.min() < ratio.max() < 3, "with what steep faces miss it adds up before it is squared"


@pytest.mark.parametrize("make", ["gelsight-mini", "digit"])
def test_the_response_of_another_unit_is_known_less_well(make):
    """A step follows the colors of this unit less: they scatter more about the response of others than about its own."""
    starter = load_starter(make)
    assert starter.color_variance > 2
    made = starter.calibration
    own, unit = made.forward.covariance, starter.for_unit(made.background).forward.covariance
    assert np.trace(np.linalg.solve(own, unit)) / 3 == pytest.approx(starter.color_variance, rel=0.2)


def test_brightness_and_white_balance_are_free(layout, background):
    """A unit half as bright, its white balance another: the same gel and lamps are read alike."""
    gain = np.float32([0.5, 0.8, 0.65])
    image = simulate_press(layout, Ball(2.5), depth_mm=0.4, rng=np.random.default_rng(8)).image
    usual, other = (
        gelform.Reconstructor(calibration_from_background(background * g, SIMULATED))
        .from_image(image.astype(np.float32) * g)
        .observed_gradients
        for g in (np.float32(1), gain)
    )
    steep = np.linalg.norm(usual, axis=-1) > 0.3
    ratio = np.sum(usual[steep] * other[steep]) / np.sum(usual[steep] ** 2)
    assert abs(ratio - 1) < 0.01


def test_a_starter_s_calibration_is_a_calibration_like_any_other(background, tmp_path):
    calibration = calibration_from_background(background, SIMULATED, gel_id="g")
    calibration.save(tmp_path / "unit.npz")
    back = load_calibration(tmp_path / "unit.npz")
    assert (
        back.digest
        == calibration.digest
        == calibration_from_background(background, SIMULATED, gel_id="g").digest
    )
    assert back.findings == calibration.findings
    assert back.unit_spread == calibration.unit_spread


def test_a_frame_of_the_camera_goes_through_the_make_s_view_and_an_image_begins_that_view_too():
    light, mini = load_starter("gelsight-mini").calibration.background, SENSORS["gelsight-mini"]
    frame = np.zeros((336, 448, 3), np.float32)
    frame[48:288, 64:384] = light
    calibration = calibration_from_background(frame, "gelsight-mini")
    assert calibration.view.frame_shape == (336, 448)
    assert calibration.image_shape == light.shape[:2]
    np.testing.assert_allclose(calibration.background, light, atol=1.5)
    by_image = calibration_from_background(light, "gelsight-mini")
    assert by_image.view == mini.profile.view(mini.camera.frame_shape)
    assert calibration_from_background(light, "gelsight-mini", mm_per_px=0.05).view.is_identity


def test_frames_of_a_digit_s_camera_lie_and_are_turned_upright():
    """Its camera gives 240 rows of 320 pixels; the other way round the colors are of no DIGIT."""
    light = load_starter("digit").calibration.background
    lying = np.ascontiguousarray(np.rot90(light, -1))
    calibration = calibration_from_background(lying, "digit")
    assert (calibration.view.frame_shape, calibration.view.turn) == ((240, 320), "left")
    np.testing.assert_array_equal(calibration.background, light)
    result = gelform.Reconstructor(calibration)(lying.round().astype(np.uint8))
    assert result.depth_mm.shape == (320, 240)


def test_another_make_a_mirrored_image_and_bgr_are_refused():
    mini, digit = (load_starter(name).calibration.background for name in ("gelsight-mini", "digit"))
    with pytest.raises(
        CalibrationError, match="background of a GelSight Mini: the colors over its gel correlate"
    ):
        calibration_from_background(np.ascontiguousarray(digit.transpose(1, 0, 2)), "gelsight-mini")
    for spoilt, make, said in (
        (
            mini[..., ::-1],
            "gelsight-mini",
            r"is BGR, or mirrored left to right and BGR: .*red and blue exchanged \(--bgr",
        ),
        (digit[:, ::-1], "digit", r"is mirrored left to right: .*the view.s flip"),
        (digit[:, ::-1, ::-1], "digit", "is mirrored left to right and BGR: "),
        (digit[::-1, ::-1], "digit", "is turned by 180 degrees: "),
    ):
        with pytest.raises(CalibrationError, match=said):
            calibration_from_background(np.ascontiguousarray(spoilt), make)
    with pytest.raises(SensorError, match=r"got 320x240\. Turn them"):
        calibration_from_background(np.rot90(mini), "gelsight-mini")
    with pytest.raises(SensorError, match="with a starter, digit, gelsight-mini"):
        calibration_from_background(mini, "gelslim")


def test_which_starter_a_sensor_has():
    assert starter_for("gelsight-mini", (240, 320)).sensor == "gelsight-mini"
    assert starter_for("gelsight-mini", (480, 640)) is None
    assert starter_for(SIMULATED, (240, 320)) is None, (
        "simulated sensors are calibrated by their own presses alone"
    )
    assert starter_for(None, (240, 320)) is None


def test_a_starter_of_a_unit_comes_back_from_its_file(calibration, tmp_path):
    starter = starter_from_calibration(
        calibration, "mine", spread=0.05, units=("one unit",), color_variance=3.0
    )
    starter.save(tmp_path / "mine.npz")
    back = read_starter(tmp_path / "mine.npz")
    np.testing.assert_allclose(back.calibration.color_model.nodes, calibration.color_model.nodes, rtol=1e-5)
    assert (back.spread, back.units, back.make, back.color_variance) == (0.05, ("one unit",), "mine", 3.0)
    with pytest.raises(CalibrationError, match="already there"):
        starter.save(tmp_path / "mine.npz")
    spoilt = tmp_path / "spoilt.npz"
    spoilt.write_bytes((tmp_path / "mine.npz").read_bytes()[:-2000])
    with pytest.raises(CalibrationError):
        read_starter(spoilt)


def test_the_starter_of_a_source_is_known_by_its_camera_or_its_name():
    def source(name, kind=None):
        return SimpleNamespace(name=name, camera=SimpleNamespace(kind=kind) if kind else None)

    assert starter_of_source(source("GelSight Mini R0B 2BKR", "gelsight-mini")) == "gelsight-mini"
    assert starter_of_source(source("a digit by its USB id", "digit")) == "digit"
    assert starter_of_source(source("DIGIT D20123")) == "digit"
    assert starter_of_source(source("simulated three-edges")) is None, "it moves all the time: name it"
    assert starter_of_source(source("press.mp4")) is None
    assert starter_of_source(source("DIGIT", "gelslim")) is None


def findings_of(image, sensor):
    return {one.name: one for one in calibration_from_background(image, sensor).findings}


def test_a_calibration_of_a_pressed_gel_says_so_and_so_does_each_of_its_results(layout, background):
    press = simulate_press(layout, Ball(2.5), depth_mm=0.4, center_mm=(2, 1), rng=np.random.default_rng(3))
    found = findings_of(press.image, SIMULATED)["background_touched"]
    place = [int(n) for n in re.search(r"\((\d+), (\d+)\) px", found.message).groups()]
    assert np.hypot(*np.subtract(place, press.center_px)) < press.contact_radius_px
    result = gelform.Reconstructor(calibration_from_background(press.image, SIMULATED))(press.image)
    assert "background_touched" in {one.name for one in result.health}
    assert "background_touched" not in findings_of(background, SIMULATED)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "make"), [("mini-ball", "gelsight-mini"), ("digit-ball", "digit")])
def test_half_of_a_real_press_is_a_touch_and_a_real_gel_at_rest_is_none(data, name, make):
    presses = gelform.read_presses(data / name)
    assert "background_touched" not in findings_of(presses.background, make)
    found = [
        "background_touched" in findings_of((presses.background + press.image) / 2, make)
        for press in presses.presses[::4]
    ]
    assert np.mean(found) > 0.9


@pytest.mark.slow
def test_dust_and_a_rim_in_sight_are_no_touch_and_beside_dots_it_is_unknown(data):
    for one in ("mini-edge", "mini-d", "mini-objects"):
        rest = gelform.read_image(data / one / "background.png")
        assert not {"background_touched", "background_unchecked"} & set(findings_of(rest, "gelsight-mini"))
    with gelform.open_source(data / "mini-markers-video" / "mini_example.avi") as video:
        dots = next(iter(video)).image
    image = cv2.resize(dots, (320, 240), interpolation=cv2.INTER_AREA)
    found = findings_of(image, "gelsight-mini")
    assert "background_unchecked" in found
    assert "background_touched" not in found


def test_arguments_that_no_unit_has_are_named(background):
    starter = load_starter("gelsight-mini")
    own = starter.calibration.background
    for name, expected in (("view", "View"), ("serial", "str"), ("gel_id", "str")):
        with pytest.raises(TypeError, match=f"Expected {name} as {expected}"):
            starter.for_unit(own, **{name: 3})
    for sensor in (background, ["digit"], None):
        with pytest.raises(TypeError, match=r"Expected sensor as a name.* the background comes first"):
            gelform.calibration_from_background("digit", sensor)
    for pitch in (0.634, 0.00634):
        named = rf"gel of a GelSight Mini between 10.1 and 40.6 mm wide, got 320 px of {pitch:g} mm"
        with pytest.raises(ValueError, match=named):
            starter.for_unit(own, mm_per_px=pitch)
    assert starter.for_unit(own, mm_per_px=0.08).mm_per_px == 0.08
