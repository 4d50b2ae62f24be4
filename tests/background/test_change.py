"""color_change: division and subtraction, their inverse; exposure, response and crosstalk undone."""

import numpy as np
import pytest

from gelform.background.change import (
    ChangeSettings,
    PreparedBackground,
    color_change_from_image,
    image_from_color_change,
)
from made.touched_images import SHAPE, scene, touched


@pytest.mark.parametrize("method", ["divide", "subtract"])
@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_change_and_image_are_inverse(method, offset):
    settings = ChangeSettings(method, offset)
    rest = scene()
    image = touched(rest)
    change = color_change_from_image(image, rest, settings)
    np.testing.assert_allclose(image_from_color_change(change, rest, settings), image, atol=1e-3)


def test_division_is_the_relative_change():
    rest = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    image = np.full((*SHAPE, 3), 140, dtype=np.uint8)
    np.testing.assert_allclose(color_change_from_image(image, rest), 0.5, rtol=1e-6)
    subtracted = color_change_from_image(image, rest, ChangeSettings("subtract"))
    np.testing.assert_allclose(subtracted, 50 / 255, rtol=1e-6)


def test_darker_than_the_background_is_negative():
    rest = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    assert color_change_from_image(rest // 2, rest).max() < 0


def test_division_by_zero_is_refused():
    rest = np.zeros((*SHAPE, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match="Give an offset"):
        color_change_from_image(rest, rest, ChangeSettings("divide", 0.0))


def test_unknown_method_is_refused():
    with pytest.raises(ValueError, match="'divide' or 'subtract'"):
        ChangeSettings("ratio")  # type: ignore[arg-type]


GAIN = np.array([1.08, 0.94, 1.03])


def test_a_gain_is_compensated():
    rest = scene()
    bare = PreparedBackground(rest, ChangeSettings())
    image = touched(scene(1))
    plain, brighter = (bare.change(one, bare.compare(one)[0]) for one in (image, image * GAIN))
    np.testing.assert_allclose(brighter, plain, atol=2e-3)
    assert np.abs(bare.change(image * GAIN) - plain).max() > 0.05  # without: the gain is in the change


def test_prepared_background_agrees_with_the_formula():
    rest, image = scene(), touched(scene(1))
    bare = PreparedBackground(rest, ChangeSettings())
    np.testing.assert_allclose(bare.change(image), (image - rest) / (rest + 10), atol=1e-6)
    out = np.empty_like(rest)
    assert bare.change(image.astype(np.uint8), out=out) is out


def light_and_image(crosstalk, response, seed=0):
    """Linear light per LED, 0-255, and what a camera with crosstalk and a response curve makes of it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 80
    light = 40 + 60 * np.stack([x, 1 - y, (x + y) / 2], axis=-1)
    if seed:
        light[20:40, 30:50] *= np.array([1.5, 0.7, 1.2])
    return light, 255 * (light @ np.asarray(crosstalk).T / 255) ** response


CROSSTALK = ((1.0, 0.15, 0.02), (0.1, 1.0, 0.2), (0.0, 0.12, 1.0))


@pytest.mark.parametrize("response", [1.0, 0.45])
@pytest.mark.parametrize("crosstalk", [None, CROSSTALK])
def test_change_is_that_of_the_light(crosstalk, response):
    """Response and crosstalk undone: the change is what the three lights did, each in its own channel."""
    mixing = np.eye(3) if crosstalk is None else np.asarray(crosstalk)
    settings = ChangeSettings("divide", 0.0, crosstalk=crosstalk, response=response)
    (light0, rest), (light1, image) = light_and_image(mixing, response), light_and_image(mixing, response, 1)
    change = color_change_from_image(image.astype(np.float32), rest.astype(np.float32), settings)
    np.testing.assert_allclose(change, light1 / light0 - 1, atol=2e-5)
    rounded = np.rint(image).astype(np.uint8)  # by the table of an 8-bit image
    np.testing.assert_allclose(
        color_change_from_image(rounded, rest.astype(np.float32), settings), light1 / light0 - 1, atol=0.05
    )


@pytest.mark.parametrize("response", [1.0, 0.45])
@pytest.mark.parametrize("crosstalk", [None, CROSSTALK])
def test_gains_act_in_front_of_crosstalk_and_response(crosstalk, response):
    mixing = np.eye(3) if crosstalk is None else np.asarray(crosstalk)
    bare = PreparedBackground(
        light_and_image(mixing, response)[1].astype(np.float32),
        ChangeSettings(crosstalk=crosstalk, response=response),
    )
    image = light_and_image(mixing, response, 1)[1].astype(np.float32)
    plain, brighter = (bare.change(one, bare.compare(one)[0]) for one in (image, image * GAIN))
    np.testing.assert_allclose(brighter, plain, atol=2e-3)


@pytest.mark.parametrize("response", [1.0, 0.45])
@pytest.mark.parametrize("crosstalk", [None, CROSSTALK])
def test_the_image_of_a_change_is_its_image(crosstalk, response):
    settings = ChangeSettings(crosstalk=crosstalk, response=response)
    rest, image = scene(), touched(scene(1))
    change = color_change_from_image(image, rest, settings)
    np.testing.assert_allclose(image_from_color_change(change, rest, settings), image, atol=0.02)


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"response": 0.0}, "response > 0"),
        ({"crosstalk": ((1, 0), (0, 1))}, "3x3 finite"),
        ({"crosstalk": ((1, 0.9, 0), (1, 0.95, 0), (0, 0, 1))}, "condition number .*same LED"),
    ],
)
def test_settings_that_cannot_be_undone_are_refused(settings, text):
    with pytest.raises(ValueError, match=text):
        ChangeSettings(**settings)
