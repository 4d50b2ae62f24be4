"""Sixteen readings of an image: the right one is named, and none where nothing tells them apart."""

import re

import numpy as np
import pytest

import gelform
from gelform.errors import CalibrationError
from gelform.image.background.check import TOUCHED_SHARE, check_own_background, check_untouched
from gelform.image.background.light import block_means, gain_from_blocks
from gelform.image.background.orientation import (
    READINGS,
    UNLIKE,
    UPRIGHT,
    largest_touch,
    orientation_from_image,
)
from gelform.image.view import View, image_from_frame

SETS = ("mini-ball", "digit-ball", "gelslim", "mini-d", "gelslim-dots", "gelsight-ball-deep")


def lying(image, reading):
    """An image as it is before the reading undoes it."""
    spoilt = image[..., ::-1] if reading.reversed else image
    spoilt = spoilt[:: -1 if "y" in reading.flip else 1, :: -1 if "x" in reading.flip else 1]
    return np.ascontiguousarray(spoilt.transpose(1, 0, 2) if reading.transposed else spoilt)


@pytest.mark.parametrize("reading", READINGS)
def test_words_and_remedy_are_those_of_the_reading(reading):
    image = np.arange(24).reshape(2, 4, 3)
    spoilt = lying(image, reading)
    np.testing.assert_array_equal(reading.undone(spoilt), image)
    named = dict(re.findall(r'(flip|turn) "(\w+)"', reading.remedy))
    viewed = image_from_frame(spoilt.astype(np.uint8), View(**named))
    np.testing.assert_array_equal(viewed[..., :: -1 if "--bgr" in reading.remedy else 1], image)
    assert ("BGR" in reading.named) == reading.reversed
    if reading.transposed and reading.flip in ("x", "y"):
        turns = -1 if "counter" not in reading.named else 1
        np.testing.assert_array_equal(np.rot90(image, turns)[..., :: -1 if reading.reversed else 1], spoilt)


@pytest.mark.parametrize("reading", READINGS)
def test_a_simulated_press_is_named(press, simulated, reading):
    assert orientation_from_image(lying(press.image, reading), simulated.background) == reading


def test_another_exposure_and_a_tilted_lamp_are_no_orientation(press, simulated):
    for light in (0.9, 1.1, np.linspace(0.95, 1.05, press.image.shape[1])[:, None]):
        found = orientation_from_image(np.clip(press.image * light, 0, 255), simulated.background)
        assert found == UPRIGHT


def test_a_light_that_is_alike_from_all_sides_names_nothing():
    gray = np.full((60, 80, 3), 120.0)
    assert orientation_from_image(gray[:, ::-1], gray) is None
    assert orientation_from_image(gray[:50], gray) is None  # another size


def test_another_sensor_is_no_orientation_of_this_one(simulated):
    y, x = np.mgrid[: simulated.background.shape[0], : simulated.background.shape[1]]
    light = 120 + 60 * np.stack([np.sin(x / 30), np.cos(y / 25), np.sin((x + y) / 35)], axis=-1)
    noise = np.random.default_rng(1).uniform(40, 200, light.shape)
    for other in (light, noise):
        assert orientation_from_image(other, simulated.background) is None


@pytest.mark.slow
@pytest.mark.parametrize("name", SETS)
def test_every_reading_of_real_presses_is_named(data, name):
    presses = gelform.read_presses(data / name)
    blocks = block_means(presses.background)
    for press in presses.presses[::12]:
        for reading in READINGS:
            image = lying(press.image, reading)
            assert orientation_from_image(image, presses.background) == reading
            if not reading.transposed:
                unlike = gain_from_blocks(block_means(image), blocks).least_change > UNLIKE
                assert unlike == (reading != UPRIGHT), "the cheap question first loses nothing"


def test_a_touch_is_found_at_its_place_under_any_light(press, simulated):
    height, width = press.image.shape[:2]
    for light in (1, 1.08, np.linspace(0.96, 1.04, width)[:, None]):
        touch = largest_touch(*map(block_means, (np.clip(press.image * light, 0, 255), simulated.background)))
        assert 1 < touch.share / press.contact.mean() < 4  # with the gel that it draws down
        off = np.multiply(touch.center, (width, height)) - press.center_px
        assert np.hypot(*off) < press.contact_radius_px
        untouched = largest_touch(
            *map(block_means, (np.clip(simulated.background * light, 0, 255), simulated.background))
        )
        assert untouched.share < 0.002


def test_a_pressed_background_is_refused_with_its_place(press, simulated):
    with pytest.raises(
        CalibrationError, match=r"Something touches the gel .* about \(\d+, \d+\) px: \d+\.\d % of it"
    ):
        check_own_background(press.image.astype(np.float32), simulated.background)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mini-ball", "mini-d", "digit-ball", "gelsight-ball-deep"])
def test_real_presses_are_no_background(data, name):
    presses = gelform.read_presses(data / name)
    for press in presses.presses[::5]:
        with pytest.raises(CalibrationError, match=r"Something touches the gel|is not of"):
            check_own_background(press.image.astype(np.float32), presses.background)


@pytest.mark.slow
def test_less_is_a_touch_where_the_calibration_shows_contact(data):
    presses = gelform.read_presses(data / "gelslim")
    shown = np.ones(presses.background.shape[:2], dtype=bool)
    light = [
        image
        for image in (press.image.astype(np.float32) for press in presses.presses[::4])
        if largest_touch(block_means(image), block_means(presses.background)).share <= TOUCHED_SHARE
    ]
    assert len(light) >= 4
    for image in light:
        check_untouched(image, presses.background)
        check_untouched(image, presses.background, ~shown)
        with pytest.raises(CalibrationError, match="Something touches the gel"):
            check_untouched(image, presses.background, shown)
