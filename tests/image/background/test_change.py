"""color_change: division and subtraction, their inverse; exposure, response and crosstalk undone."""

import cv2
import numpy as np
import pytest

from gelform.image.background import change
from gelform.image.background.change import (
    ChangeSettings,
    PreparedBackground,
    color_change_from_image,
    image_from_color_change,
)
from gelform.image.background.light import FrameLight
from kernel_agreement import assert_kernel_agrees
from made.touched_images import SHAPE, scene, touched


def test_division_is_the_relative_change():
    rest = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    image = np.full((*SHAPE, 3), 140, dtype=np.uint8)
    np.testing.assert_allclose(color_change_from_image(image, rest), 0.5, rtol=1e-6)
    subtracted = color_change_from_image(image, rest, ChangeSettings("subtract"))
    np.testing.assert_allclose(subtracted, 50 / 255, rtol=1e-6)


def test_pixels_that_nothing_can_be_divided_by_say_nothing():
    rest = np.full((*SHAPE, 3), 90, dtype=np.uint8)
    rest[1, 2, 0] = 0
    change = color_change_from_image(np.full_like(rest, 180), rest, ChangeSettings("divide", 0.0))
    assert change[1, 2, 0] == 0
    assert np.count_nonzero(change == 1) == change.size - 1


GAIN = np.array([1.08, 0.94, 1.03])
TILTED = np.array([[0.05, 0.04, -0.03, 8], [-0.02, 0.03, 0.03, 5], [0.01, 0, 0.05, 6]])


@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (3, 5), (40, 300)])
@pytest.mark.parametrize("blur_px", [0.0, 0.4, 1.25, 3.0])
@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("light", [None, FrameLight(TILTED), FrameLight(np.where([1, 1, 1, 0], TILTED, 0))])
def test_the_kernel_agrees_with_numpy(shape, blur_px, dtype, light):
    """Mirrored borders included, also where the blur is wider than the image."""
    rng = np.random.default_rng(0)
    image = rng.integers(0, 256, (*shape, 3)).astype(dtype)
    rest = rng.uniform(20, 200, (*shape, 3)).astype(np.float32)
    pending = PreparedBackground(rest, ChangeSettings(blur_px=blur_px)).pending(image, light)
    work, out = np.empty(pending.work_size, np.float32), np.empty((*shape, 3), np.float32)
    assert_kernel_agrees(change._color_change, changed_and_blurred, *pending.arguments, work, out)


def changed_and_blurred(image, light, scale, untouched, gain, taps, work, out):
    """What the kernel should give, in float64."""
    pixels = (light if image is None else image).astype(np.float64)
    height, width = pixels.shape[:2]
    columns, rows, room = np.split(scale.reshape(-1, 3), [width, width + height])
    if len(rows):
        pixels = (pixels - room[0]) * rows[:, None]
    found = (pixels * columns - untouched) * gain
    radius = len(taps) - 1
    for axis in (0, 1):
        ends = [(radius, radius) if k == axis else (0, 0) for k in range(3)]
        wide = (
            np.pad(found, ends, mode="reflect") if found.shape[axis] > 1 else np.pad(found, ends, mode="edge")
        )
        parts = [np.take(wide, range(k, k + found.shape[axis]), axis=axis) for k in range(2 * radius + 1)]
        found = sum(taps[abs(k - radius)] * part for k, part in enumerate(parts))
    return found


def test_the_blur_is_that_of_opencv():
    image = np.random.default_rng(1).uniform(0, 255, (40, 60, 3)).astype(np.float32)
    rest = np.full((40, 60, 3), 90, dtype=np.float32)
    for blur_px in (0.5, 1.25, 2.6):
        sharp = PreparedBackground(rest, ChangeSettings()).change(image)
        expected = cv2.GaussianBlur(sharp, (0, 0), blur_px, borderType=cv2.BORDER_REFLECT_101)
        found = PreparedBackground(rest, ChangeSettings(blur_px=blur_px)).change(image)
        np.testing.assert_allclose(found, expected, atol=1e-5)


def light_and_image(crosstalk, response, seed=0):
    """Linear light per LED, 0-255, and what a camera with crosstalk and a response curve makes of it."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 80
    light = 40 + 60 * np.stack([x, 1 - y, (x + y) / 2], axis=-1)
    if seed:
        light[20:40, 30:50] *= np.array([1.5, 0.7, 1.2])
    return light, 255 * (light @ np.asarray(crosstalk).T / 255) ** response


CROSSTALK = ((1.0, 0.15, 0.02), (0.1, 1.0, 0.2), (0.0, 0.12, 1.0))


def every_camera(test):
    """With crosstalk and without, of every kind of response curve."""
    with_crosstalk = pytest.mark.parametrize("crosstalk", [None, CROSSTALK])
    return with_crosstalk(pytest.mark.parametrize("response", [1.0, 0.45, 2.0])(test))


@every_camera
@pytest.mark.parametrize("method", ["divide", "subtract"])
@pytest.mark.parametrize("offset", [0.0, 10.0])
def test_change_and_image_are_inverse(method, offset, crosstalk, response):
    settings = ChangeSettings(method, offset, crosstalk=crosstalk, response=response)
    rest, image = scene(), touched(scene(1))
    change = color_change_from_image(image, rest, settings)
    plain = crosstalk is None and response == 1
    back = image_from_color_change(change, rest, settings)
    np.testing.assert_allclose(back, image, atol=1e-3 if plain else 0.02)


@every_camera
def test_change_is_that_of_the_light(crosstalk, response):
    """Response and crosstalk undone: the change is what the three lights did, each in its own channel."""
    mixing = np.eye(3) if crosstalk is None else np.asarray(crosstalk)
    settings = ChangeSettings("divide", 0.0, crosstalk=crosstalk, response=response)
    (light0, rest), (light1, image) = light_and_image(mixing, response), light_and_image(mixing, response, 1)
    by_table = np.rint(image).astype(np.uint8)  # of an 8-bit image
    for one, tolerance in ((image.astype(np.float32), 2e-5), (by_table, 0.05)):
        change = color_change_from_image(one, rest.astype(np.float32), settings)
        np.testing.assert_allclose(change, light1 / light0 - 1, atol=tolerance)


@every_camera
def test_gains_are_compensated_in_front_of_crosstalk_and_response(crosstalk, response):
    bare = PreparedBackground(scene(), ChangeSettings(crosstalk=crosstalk, response=response))
    image = touched(scene(1))
    plain, brighter = (bare.change(one, bare.compare(one)[0]) for one in (image, image * GAIN))
    np.testing.assert_allclose(brighter, plain, atol=2e-3)
    assert np.abs(bare.change(image * GAIN) - plain).max() > 0.04  # without: the gain is in the change


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"method": "ratio"}, "'divide' or 'subtract'"),
        ({"response": 0.0}, "response between 0.05 and 20"),
        ({"crosstalk": ((1, 0), (0, 1))}, "crosstalk of shape"),
        ({"crosstalk": ((1, 0.9, 0), (1, 0.95, 0), (0, 0, 1))}, "condition number .*same LED"),
    ],
)
def test_settings_that_cannot_be_undone_are_refused(settings, text):
    with pytest.raises(ValueError, match=text):
        ChangeSettings(**settings)
