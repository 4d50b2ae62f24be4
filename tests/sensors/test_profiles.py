"""Profiles crop the same part of the gel from frames of any size, with square pixels; which widths a gel may have.

Simulated sensors from settings and from TOML, and as a source: pace, noise, the program, presses on request.
"""

import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from gelform.errors import SensorError
from gelform.image.view import View, image_from_frame
from gelform.sensors.profiles import (
    PROFILES,
    SENSORS,
    KnownSensor,
    check_gel_width,
    light_order_of,
    make_of,
    profile_named,
    view_from_camera,
)
from gelform.sensors.simulated import (
    REST_IMAGES,
    SimulatedSource,
    program,
    read_simulated_sensor,
    sensor_from_settings,
    simulated_sensor_named,
)
from gelform.simulate import LAYOUTS, simulate_background, simulate_pose
from live_waiting import until
from made.sources import SMALL


def test_every_profile_gives_its_image_from_frames_of_any_size_by_a_cut():
    for profile in PROFILES.values():
        for factor in (1, 2, 3.5):
            shape = tuple(int(side * factor) for side in profile.image_shape)
            image = image_from_frame(np.zeros((*shape, 3), dtype=np.uint8), profile.view(shape))
            assert image.shape == (*profile.image_shape, 3)
    view = profile_named("gelsight-mini").view((2464, 3280))
    left, top, width, height = view.crop
    assert np.allclose((left, top), (3280 / 7, 352))
    assert np.allclose((width / 320) / (height / 240), 1, atol=0.002)
    frame = np.zeros((2464, 3280, 3), dtype=np.uint8)
    frame[355:-355, 472:-472] = 200  # what is left after the cut, 3 px less on each side
    image = image_from_frame(frame, view)
    assert image[2:-2, 2:-2].min() == 200
    assert image[0].max() < 160


def test_frames_of_the_image_size_turned_and_of_another_aspect():
    mini, digit = (profile_named(name) for name in ("gelsight-mini", "digit"))
    assert mini.view((240, 320)) == View()
    assert mini.view((3280, 2464)).shape == (320, 240)
    assert digit.view((480, 640)).shape == (240, 320)
    with pytest.raises(SensorError, match=r"aspect of 240x320 px .*got 1080x1920"):
        mini.view((1080, 1920))


def test_scales_carry_their_doubt_and_lights_an_order_and_unknown_profiles_name_the_known_ones():
    assert profile_named("gelsight-mini").mm_per_px == 0.0634
    assert all(0 < profile.mm_per_px_sigma < profile.mm_per_px / 10 for profile in PROFILES.values())
    with pytest.raises(SensorError, match="gelsight-mini, digit, got 'gelsight'"):
        profile_named("gelsight")
    assert light_order_of(make_of("GelSight Mini, unit A")) == "clockwise"
    assert light_order_of(make_of("DIGIT 7")) == "counter-clockwise"
    assert light_order_of(make_of("digit")) is None


def test_sensors_are_simulated_under_their_name_and_scale():
    for name, known in SENSORS.items():
        sensor = known.simulated()
        assert sensor.name == name
        if known.profile is not None:
            assert sensor.shape == known.profile.image_shape
            assert sensor.mm_per_px == known.profile.mm_per_px
    with pytest.raises(SensorError, match="There is no simulation of this sensor"):
        KnownSensor(PROFILES["digit"]).simulated()
    assert not LAYOUTS.keys() & SENSORS.keys()
    assert all(sensor.name == name for name, sensor in LAYOUTS.items())


def test_a_make_s_images_know_the_way_from_its_camera():
    """The scale tells images of the usual crop from those of the whole frame; a camera that lies is turned."""
    mini = PROFILES["gelsight-mini"]
    assert view_from_camera("gelsight-mini", (240, 320), 0.0634) == mini.view((2464, 3280))
    whole = View((2464, 3280), image_shape=(240, 320))
    assert view_from_camera("gelsight-mini", (240, 320), 0.0634 * 7 / 5) == whole
    lying = view_from_camera("digit", (320, 240), 0.05107)
    assert (lying.frame_shape, lying.shape, lying.turn) == ((240, 320), (320, 240), "left")
    for make, shape, scale in (
        ("gelsight-mini", (240, 320), 0.078),
        ("gelsight-mini", (240, 320), None),
        ("gelsight-mini", (480, 640), 0.0634),
        (None, (240, 320), 0.0634),
        ("gelslim", (240, 320), 0.0634),
    ):
        assert view_from_camera(make, shape, scale) == View()


def test_a_scale_that_no_gel_has_is_refused_and_an_unusual_one_noted():
    assert check_gel_width((240, 320), 0.0634) is None
    assert check_gel_width((240, 320), 0.0634, "gelsight-mini") is None
    assert "this one would be 640 px of 0.00634 mm: 4.06 mm" in check_gel_width((480, 640), 0.00634)
    assert "80 mm" in check_gel_width((480, 640), 0.125)
    with pytest.raises(ValueError, match=r"between 3 and 150 mm wide, got 320 px of 0.00634 mm: 2.03 mm"):
        check_gel_width((240, 320), 0.00634)
    for make, width in (("gelsight-mini", "between 10.1 and 40.6"), ("digit", "between 8.17 and 32.7")):
        for pitch in (0.02, 0.14):
            with pytest.raises(ValueError, match=f"the gel of a {PROFILES[make].name} {width} mm wide"):
                check_gel_width((320, 240), pitch, make)


def test_the_names_of_sensors_cost_no_numpy():
    """The command line's help lists them."""
    code = "import sys; from gelform.sensors.profiles import SENSORS; print(*sys.modules)"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert not {"numpy", "scipy", "cv2"} & set(loaded.split())


TOML = """
base = "gelsight-mini"
name = "mine"
noise_sd = 0.5
exposed_levels = [90, 95, 100]

[[leds]]
position_mm = [-15, 0, 8]
color = [900, 20, 0]

[[leds]]
position_mm = [15, 0, 8]
peak_nm = 525
power = 800
beam_power = 1

[[leds]]
position_mm = [0, 15, 8]
peak_nm = 465
power = 800

[gel]
thickness_mm = 2.5
bulge = 0.6

[coating]
marker_pitch_mm = 2.0
"""


def test_a_toml_file_starts_from_a_base_and_changes_it(tmp_path):
    path = tmp_path / "sensor.toml"
    path.write_text(TOML)
    sensor = read_simulated_sensor(path)
    assert (sensor.name, sensor.noise_sd, sensor.gel.bulge) == ("mine", 0.5, 0.6)
    assert len(sensor.leds) == 3
    assert sensor.leds[1].beam_power == 1
    assert np.argmax(sensor.leds[2].color) == 2
    assert sensor.coating.marker_pitch_mm == 2.0
    assert sensor.coating.seed == SENSORS["gelsight-mini"].simulated().coating.seed
    means = simulate_background(sensor, None, quantise=False).mean((0, 1))
    np.testing.assert_allclose(means, (90, 95, 100), rtol=0.03)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("noise_sd", "noise_ds"), "Did you mean 'noise_sd'"),
        (("bulge", "buldge"), r"\[gel\]. Did you mean 'bulge'"),
        (("beam_power", "beam_powr"), r"\[\[leds\]\]. Did you mean 'beam_power'"),
        (("marker_pitch_mm", "marker_pich_mm"), "Did you mean 'marker_pitch_mm'"),
        (('"gelsight-mini"', '"gelsigt-mini"'), "Did you mean 'gelsight-mini'"),
        (("[-15, 0, 8]", "[1, 0, 1]"), "outside the gel"),
        (("[-15, 0, 8]", "[1, 0, -1]"), "camera's side"),
        (("noise_sd = 0.5", "noise_gain = -0.5"), "noise_gain >= 0"),
        (("noise_sd = 0.5", 'noise_sd = "low"'), "noise_sd"),
        (("[gel]", "gel = 3\n[other]"), "gel"),
        (("[[leds]]", "[[leds]"), "no TOML"),
        (("peak_nm = 525", "peak_nm = 52"), "peak_nm in 380-750"),
    ],
)
def test_bad_toml_is_refused_with_the_reason(tmp_path, change, message):
    path = tmp_path / "sensor.toml"
    path.write_text(TOML.replace(*change, 1))
    with pytest.raises(SensorError, match=message):
        read_simulated_sensor(path)


def test_without_a_base_leds_are_needed_and_without_a_known_name_the_nearest_is_told(tmp_path):
    with pytest.raises(SensorError, match="No file"):
        read_simulated_sensor(tmp_path / "none.toml")
    with pytest.raises(ValueError, match="got neither"):
        sensor_from_settings({"name": "dark"})
    for leds in (None, 3, [3]):
        with pytest.raises(TypeError, match="leds as tables"):
            sensor_from_settings({"base": "digit", "leds": leds})
    with pytest.raises(ValueError, match="Did you mean 'digit'"):
        simulated_sensor_named("digitt")


UNTOUCHED = simulate_background(SMALL, None).astype(float)


@pytest.fixture
def source():
    with SimulatedSource(SMALL, rate_hz=200.0) as made:
        yield made


def test_frames_come_in_order_at_their_times_and_not_before(source):
    assert (source.name, source.serial) == ("simulated three-edges", "simulated-three-edges")
    assert source.settings == {"width": 64, "height": 48, "fps": source.rate_hz}
    with pytest.raises(ValueError, match="rate_hz"):
        SimulatedSource(SMALL, rate_hz=0.0)
    came = [(frame, time.monotonic()) for _, frame in zip(range(5), source)]
    times, steps = (np.diff([getattr(f, name) for f, _ in came]) for name in ("time_s", "index"))
    np.testing.assert_allclose(times, steps / 200)
    assert (steps >= 1).all()
    assert all(now >= frame.time_s for frame, now in came)
    reader = iter(source)
    before = next(reader).index
    time.sleep(0.1)
    assert next(reader).index >= before + 19


def test_closed_it_ends_also_just_as_its_loop_begins(source, monkeypatch):
    reader = iter(source)
    next(reader)
    source.close()
    assert list(reader) == []
    other, start = SimulatedSource(SMALL), threading.Thread.start
    monkeypatch.setattr(threading.Thread, "start", lambda thread: (other.close(), start(thread)))
    assert list(other) == []


def test_noise_is_of_the_frame_and_the_seed():
    one, again, other = (SimulatedSource(SMALL, seed=seed) for seed in (1, 1, 2))
    for index in (5, 60):  # untouched, and under the ball
        np.testing.assert_array_equal(one.image_at(index), again.image_at(index))
    for different in (one.image_at(6), other.image_at(5)):
        assert (one.image_at(5) != different).mean() > 0.2


def test_a_frame_is_the_simulated_image_of_its_touch(source):
    k = REST_IMAGES + 24
    rolling = program(SMALL)[0]
    truth, rounds = simulate_pose(SMALL, rolling[k].indenter, rolling[k].pose, rng=None).image, len(rolling)
    shown = np.mean([source.image_at(round((k + 0.5 + rounds * n) * 200 / 30)) for n in range(60)], axis=0)
    assert np.abs(shown - truth).mean() < 0.4  # rounding of the truth, and noise of the mean
    assert np.abs(shown - UNTOUCHED).max() > 20


def test_objects_touch_in_turn_without_going_through_the_gel():
    sensor = simulated_sensor_named("three-edges")
    for images in program(sensor):
        assert images[:REST_IMAGES] == [None] * REST_IMAGES
        depths = [touch.pose.depth_mm for touch in images[REST_IMAGES:]]
        assert max(depths) > 0.2
        assert all(0 < depth < 0.5 * sensor.gel.thickness_mm for depth in depths)
        assert max(depths[0], depths[-1]) < 0.1
    size_mm = np.array(sensor.shape[::-1]) * sensor.mm_per_px
    around = [touch.pose.center_mm / size_mm for touch in program(sensor)[0][REST_IMAGES:]]
    np.testing.assert_allclose(np.hypot(*np.transpose(around)), 0.3)  # the ball rolls around the middle


def test_at_rest_nothing_is_computed_ahead(source, monkeypatch):
    computed = []
    monkeypatch.setattr(source, "_levels_of_touch", lambda touch: computed.append(touch) or source._untouched)
    source.rest()
    images = [frame.image for _, frame in zip(range(40), source)]  # 0.2 s: six touches' time
    assert computed == []
    assert np.abs(np.mean(images, axis=0) - UNTOUCHED).mean() < 0.5
    source.rest(False)
    until(lambda: computed)


def test_a_press_is_where_it_was_asked_for_until_it_is_lifted(source):
    source.rest()
    source.press_at(20, 30, 0.5, held_s=60)
    changes = (np.abs(frame.image - UNTOUCHED).sum(axis=-1) for frame in source)
    change = next(one for one in changes if (one > 60).mean() > 0.01)
    y, x = np.mgrid[: SMALL.shape[0], : SMALL.shape[1]]
    middle = [np.average(axis, weights=np.where(change > 60, change, 0)) for axis in (x, y)]
    np.testing.assert_allclose(middle, (20, 30), atol=3)
    source.lift()
    assert np.abs(source.image_at(0) - UNTOUCHED).mean() < 3
