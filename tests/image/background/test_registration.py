"""A moved image is registered to hundredths of a pixel where there is texture; where there is none nothing is claimed."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from gelform.foundations.filters import log_levels
from gelform.image.background.registration import PreparedRegistration, registration_from_image

pytestmark = pytest.mark.linear_algebra

SHAPE = (144, 192)


def gel(texture, seed=0):
    """(H, W, 3) float: smooth light, and a fixed fine texture of that strength."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    light = 120 + 30 * np.cos(x / 90) - 0.1 * y
    grain = cv2.GaussianBlur(np.random.default_rng(seed).standard_normal(SHAPE), (0, 0), 1.5)
    return (light * (1 + texture * grain / grain.std()))[..., None] * [0.9, 1.0, 0.8]


def moved(image, shift, turn_deg=0.0, stretch=0.0):
    """What was at p is at center + (1 + stretch) R(turn) (p - center) + shift.

    By splines: cv2.remap knows places to 1/32 px before OpenCV 4.12, and its cubic is off by up to 0.05 px.
    """
    center = (np.array(SHAPE[::-1]) - 1) / 2
    angle, size = np.deg2rad(turn_deg), 1 + stretch
    turn = size * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    affine = np.column_stack([turn, center - turn @ center + shift])
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    back = cv2.invertAffineTransform(affine)
    sources = back @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    channels = [
        map_coordinates(channel, sources[::-1], mode="mirror") for channel in np.moveaxis(image, -1, 0)
    ]
    return np.stack(channels, axis=-1).reshape(image.shape)


def noisy(image, seed):
    return np.clip(image + np.random.default_rng(seed).normal(0, 1.0, image.shape), 0, 255)


@pytest.fixture(scope="module")
def textured():
    return PreparedRegistration(noisy(gel(0.03), 100))


@pytest.mark.parametrize(
    ("shift", "turn_deg", "stretch"),
    [
        ((0, 0), 0, 0),
        ((0.4, -0.25), 0, 0),
        ((2.3, 1.2), 0.4, 0),
        ((-5.3, 4.1), 0, 0.004),
        ((1, 0), -0.8, -0.003),
    ],
)
def test_motion_where_there_is_texture(textured, shift, turn_deg, stretch):
    found = textured(noisy(moved(gel(0.03), shift, turn_deg, stretch), 1))
    assert np.abs(found.shift_px - shift).max() < 0.03
    assert found.turn_deg == pytest.approx(turn_deg, abs=0.02)
    assert found.stretch == pytest.approx(stretch, abs=4e-4)
    assert (found.shift_sigma_px < 0.05).all()


def test_errors_are_as_large_as_said(textured):
    ratios = []
    for seed in range(12):
        shift = np.random.default_rng(seed).uniform(-2, 2, 2)
        found = textured(noisy(moved(gel(0.03), shift), seed))
        ratios.extend((found.shift_px - shift) / found.shift_sigma_px)
    assert 0.3 < np.sqrt(np.mean(np.square(ratios))) < 2.0


@pytest.mark.parametrize("shift", [(0, 0), (1.5, -1.0)])
def test_a_smooth_gel_tells_nothing(shift):
    found = registration_from_image(noisy(moved(gel(0.0), shift), 1), noisy(gel(0.0), 100))
    assert 2 < found.shift_sigma_px.max() <= 5
    assert found.moved_px() == 0


def test_a_touch_and_room_light_are_no_motion(textured):
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    ball = np.exp(-((x - 120) ** 2 + (y - 60) ** 2) / 20**2)
    pressed = gel(0.03) * (1.05 + 0.5 * ball * np.sin((x - 120) / 15))[..., None] + 4
    found = textured(noisy(pressed, 1))
    assert np.abs(found.shift_px).max() < 0.05
    assert 0.3 < found.untouched < 0.8
    assert textured(noisy(pressed, 1), ball > 0.01).untouched < found.untouched


def test_all_touched_is_unknown(textured):
    found = textured(noisy(gel(0.03), 1), np.ones(SHAPE, dtype=bool))
    assert found.untouched == 0
    assert found.shift_sigma_px.tolist() == [5, 5]
    assert found.shift_px.tolist() == [0, 0]
    assert found.moved_px() == 0


@pytest.mark.parametrize("shift", [(3, 4), (-3, -4)])
def test_certain_motion_is_shorter_than_the_motion(textured, shift):
    found = textured(noisy(moved(gel(0.03), shift), 1))
    assert 4.5 < found.moved_px() < 5


def test_light_is_the_logarithm_of_the_channels_mean():
    image = np.full((4, 5, 3), [10.0, 20.0, 60.0])
    np.testing.assert_allclose(log_levels(image), np.log(30 + 10), rtol=1e-5)


@pytest.mark.parametrize("touched", [np.zeros((0, 80), bool), np.zeros((64, 0), bool), np.zeros((64, 80))])
def test_what_is_no_mask_and_other_sizes_are_refused(touched):
    image = np.full((64, 80, 3), 90.0)
    with pytest.raises((ValueError, TypeError), match="Expected touched"):
        registration_from_image(image, image, touched)
    with pytest.raises(ValueError, match="144"):
        registration_from_image(np.zeros((10, 20, 3), np.uint8), gel(0.0))
