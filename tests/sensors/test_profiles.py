"""Profiles crop the same part of the gel from frames of any size, with square pixels."""

import subprocess
import sys

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
from gelform.simulate import LAYOUTS


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


def test_scales_carry_their_doubt_and_unknown_profiles_name_the_known_ones():
    assert profile_named("gelsight-mini").mm_per_px == 0.0634
    assert not profile_named("digit").verified
    assert all(0 < profile.mm_per_px_sigma < profile.mm_per_px / 10 for profile in PROFILES.values())
    with pytest.raises(SensorError, match="gelsight-mini, digit, got 'gelsight'"):
        profile_named("gelsight")


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


def test_makes_are_known_by_the_start_of_a_name_and_have_an_order_of_lights():
    assert light_order_of(make_of("GelSight Mini, unit A")) == "clockwise"
    assert light_order_of(make_of("DIGIT 7")) == "counter-clockwise"
    assert light_order_of(make_of("digit")) is None


def test_a_make_s_images_know_the_way_from_its_camera():
    """The scale tells images of the usual crop from those of the whole frame; a camera that lies is turned."""
    mini = PROFILES["gelsight-mini"]
    assert view_from_camera("gelsight-mini", (240, 320), 0.0634) == mini.view((2464, 3280))
    assert view_from_camera("gelsight-mini", (240, 320), 0.0634 * 7 / 5) == View(
        (2464, 3280), image_shape=(240, 320)
    )
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
