"""The color change and its inverse; backgrounds from frames; the dark surround of a gel."""

import cv2
import numpy as np
import pytest

from gelform.errors import DataError
from gelform.image import background
from gelform.image.background import (
    ChangeSettings,
    PreparedBackground,
    background_from_frames,
    color_change_from_image,
    crop_inside,
    image_from_color_change,
    noise_from_image,
    surround_of,
    trimmed_mean,
)
from kernel_agreement import assert_kernel_agrees
from made.images import TOUCHED_SHAPE, scene, touched


def test_division_is_the_relative_change():
    rest = np.full((*TOUCHED_SHAPE, 3), 90, dtype=np.uint8)
    image = np.full((*TOUCHED_SHAPE, 3), 140, dtype=np.uint8)
    np.testing.assert_allclose(color_change_from_image(image, rest), 0.5, rtol=1e-6)
    subtracted = color_change_from_image(image, rest, ChangeSettings("subtract"))
    np.testing.assert_allclose(subtracted, 50 / 255, rtol=1e-6)


def test_pixels_that_nothing_can_be_divided_by_say_nothing():
    rest = np.full((*TOUCHED_SHAPE, 3), 90, dtype=np.uint8)
    rest[1, 2, 0] = 0
    settings = ChangeSettings("divide", 0.0)
    change = color_change_from_image(np.full_like(rest, 180), rest, settings)
    assert change[1, 2, 0] == 0
    np.testing.assert_array_equal(
        image_from_color_change(change, rest, settings), np.where(rest == 0, 0, 180)
    )
    assert np.count_nonzero(change == 1) == change.size - 1


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
        wide = np.pad(found, ends, mode="reflect" if found.shape[axis] > 1 else "edge")
        parts = [np.take(wide, range(k, k + found.shape[axis]), axis=axis) for k in range(2 * radius + 1)]
        found = sum(taps[abs(k - radius)] * part for k, part in enumerate(parts))
    return found


def test_the_kernel_agrees_with_numpy():
    """Mirrored borders included, also where the blur is wider than the image."""
    assert_kernel_agrees(background._color_change, changed_and_blurred)


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
    y, x = np.mgrid[: TOUCHED_SHAPE[0], : TOUCHED_SHAPE[1]] / 80
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
    other = image * np.array([1.08, 0.94, 1.03])
    plain, brighter = (bare.change(one, bare.compare(one)[0]) for one in (image, other))
    np.testing.assert_allclose(brighter, plain, atol=2e-3)
    assert np.abs(bare.change(other) - plain).max() > 0.04  # without: the gain is in the change


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


SHAPE = (48, 64)


def truth():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]] / 64
    return np.stack([80 + 60 * x, 110 - 40 * y, 70 + 50 * x * y], axis=-1)


def frames(count, noise=2.0, seed=0):
    rng = np.random.default_rng(seed)
    noisy = (truth() + rng.normal(0, noise, (*SHAPE, 3)) for _ in range(count))
    return [np.clip(np.rint(one), 0, 255).astype(np.uint8) for one in noisy]


def touched_average(frame, at=(12, 40)):
    image = frame.copy()
    image[at[0] : at[0] + 16, at[1] : at[1] + 16] += np.array([30, 10, 20], dtype=np.uint8)
    return image


def rms(errors):
    return np.sqrt(np.mean(errors**2))


def test_noise_falls_with_the_number_of_frames():
    error = {n: rms(background_from_frames(frames(n)).background - truth()) for n in (1, 4, 36)}
    assert error[4] / error[1] == pytest.approx(1 / 2, rel=0.1)
    assert error[36] / error[1] == pytest.approx(1 / 6, rel=0.15)  # a trimmed mean costs a few per cent


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_noise_is_that_of_one_frame(count):
    """Of a slope it is none."""
    noise = background_from_frames(frames(count, noise=2.0)).noise
    assert noise == pytest.approx([2.0] * 3, rel=0.12)
    assert noise_from_image(truth()) == pytest.approx([0] * 3, abs=1e-4)


def test_frames_that_are_touched_or_exposed_otherwise_are_left_out_by_name():
    images = frames(9)
    images[2], images[7] = touched_average(images[2]), touched_average(images[7])
    images[4] = np.clip(np.rint(images[4] * [1, 0.96, 1]), 0, 255).astype(np.uint8)
    found = background_from_frames(images, names=[f"{k}.png" for k in range(9)])
    assert [name for name, _ in found.left_out] == ["2.png", "4.png", "7.png"]
    assert "by a touch or a shadow" in found.left_out[0][1]
    assert "-4 %" in found.left_out[1][1]
    clean = background_from_frames([image for k, image in enumerate(images) if k not in (2, 4, 7)])
    np.testing.assert_array_equal(found.background, clean.background)
    assert background_from_frames(images).left_out[0][0] == "frame 2"


def test_a_small_thing_that_moves_leaves_no_trace():
    """A fiber over a pixel or two in some frames is too small to cost a frame; the trimming takes it."""
    images = frames(15)
    for k in (1, 6, 11):
        images[k][20, 30:32] = 0
    found = background_from_frames(images)
    assert found.left_out == ()
    assert np.abs(found.background - truth())[20, 30:32].max() < 3


@pytest.mark.parametrize("count", [2, 4])
def test_frames_that_disagree_are_refused(count):
    images = frames(count)
    images[: count // 2] = [touched_average(image) for image in images[: count // 2]]
    with pytest.raises(DataError, match=r"that agree, got \d of \d .*frame 0: .*Take them again"):
        background_from_frames(images)


def test_no_frames_and_other_sizes_are_refused():
    with pytest.raises(DataError, match="got none"):
        background_from_frames([])
    with pytest.raises(ValueError, match="48x64"):
        background_from_frames([*frames(2), np.zeros((20, 30, 3), dtype=np.uint8)])


def test_a_long_stream_is_thinned_evenly_and_not_held():
    """Light that drifts by 2 % over the stream: the average is that of the whole, not of its end."""
    rng, size = np.random.default_rng(1), truth().size
    noisy = (
        np.clip(np.rint(gain * truth() + rng.normal(0, 2, (*SHAPE, 3))), 0, 255).astype(np.uint8)
        for gain in np.linspace(0.99, 1.01, 200)
    )
    found = background_from_frames(noisy, max_bytes=20 * size).background
    assert next(noisy, None) is None
    assert np.mean(found) / np.mean(truth()) == pytest.approx(1, abs=0.002)
    assert 2 / np.sqrt(22) < rms(found - truth()) < 2 / np.sqrt(9)  # 10 to 20 of the 200 were averaged


def test_a_trimmed_mean_ignores_a_passing_speck_and_leaves_no_frame_out():
    images = frames(24)
    images[3][10:15, 10:15] = 250
    for image, gain in zip(images, np.linspace(1, 0.8, 24)):
        image[:] = image * gain
    mean, noise = trimmed_mean(images)
    assert np.abs(mean - 0.9 * truth())[10:15, 10:15].max() < 3.5
    assert (noise > 2).all()
    with pytest.raises(DataError, match="another exposure"):
        background_from_frames(images)


def lit(shape=(120, 160), level=120.0):
    image = np.full((*shape, 3), level, dtype=np.float32)
    return image + np.random.default_rng(0).normal(0, 2, image.shape).astype(np.float32)


def test_dark_pixels_count_where_they_reach_the_border():
    assert surround_of(lit()) is None
    image, dust, one_channel = lit(), lit(), lit()
    image[:, :30] = 12
    np.testing.assert_array_equal(surround_of(image), np.broadcast_to(np.arange(160) < 30, (120, 160)))
    dust[50:90, 60:110] = 2
    assert surround_of(dust) is None, "a dark part inside the gel"
    one_channel[:, :30, 0] = 0
    assert surround_of(one_channel) is None, "lit from the other sides"


@pytest.mark.parametrize("size", [(120, 160), (243, 325)])
def test_the_crop_is_the_largest_one(size):
    outside = np.zeros(size, dtype=bool)
    height, width = size
    outside[: height // 4] = outside[:, : width // 2] = True
    left, top, wide, high = crop_inside(outside)
    assert not outside[top : top + high, left : left + wide].any()
    assert wide * high > 0.8 * (width / 2) * (3 * height / 4)
    notch = np.zeros(size, dtype=bool)
    notch[: height // 2, : width // 3] = True
    left, top, wide, high = crop_inside(notch)
    assert (left > width // 3, top, wide * high > 0.9 * width * height * 2 / 3) == (True, 0, True)
    assert crop_inside(np.ones(size, dtype=bool))[2:] == (0, 0)


def test_the_crop_ends_where_the_blurred_edge_does():
    """At whole blocks of 2 px."""
    outside = np.zeros((96, 144), dtype=bool)
    outside[:, :48] = outside[90:] = True
    assert crop_inside(outside) == (50, 0, 94, 88)
