"""A tilt and a room's light come back from pressed frames, and nothing else is taken for them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelform
from gelform.errors import CalibrationError
from gelform.image.background import light
from gelform.image.background.check import check_background
from gelform.image.background.exposure import block_means
from gelform.image.background.light import light_from_blocks
from gelform.sensors.files import read_image
from gelform.simulate import Ball, simulate_press
from kernel_agreement import assert_kernel_agrees

pytestmark = pytest.mark.linear_algebra

TILTS = st.tuples(*[st.floats(-0.08, 0.08)] * 6)
ROOMS = st.builds(np.multiply, st.floats(0, 25), st.tuples(*[st.floats(0.8, 1.2)] * 3))


def places(shape):
    y, x = ((np.arange(n) + 0.5) / n * 2 - 1 for n in shape[:2])
    return x[None, :, None], y[:, None, None]


def lit(image, tilt=((0, 0, 0), (0, 0, 0)), room=(0, 0, 0), gain=1.0):
    """An image in another light: tilt to the right and down for each channel, and gray levels added."""
    x, y = places(image.shape)
    other = image * gain * np.exp(x * np.array(tilt[0]) + y * np.array(tilt[1])) + np.array(room)
    return np.clip(np.rint(other), 0, 255).astype(np.uint8)


def light_of(image, rest):
    return light_from_blocks(block_means(image), block_means(rest))


@settings(max_examples=25, deadline=None)
@given(TILTS)
def test_a_tilt_comes_back_on_a_pressed_frame(rest, pressed, tilt):
    tilt = np.reshape(tilt, (2, 3))
    seen = light_of(lit(pressed, tilt), rest)
    assert np.abs(seen.tilt.T - tilt).max() < (0.01 if np.abs(tilt).max() > 0.04 else 0.04)


@settings(max_examples=25, deadline=None)
@given(ROOMS, st.floats(0.9, 1.1))
def test_room_light_comes_back_on_a_pressed_frame(rest, pressed, room, gain):
    seen = light_of(lit(pressed, room=room, gain=gain), rest)
    assert np.abs(seen.room - room).max() < (2 if max(room) > 12 else 12)


def test_its_deviation_is_that_of_its_errors(sensor, rest):
    """Ten presses in one light: the errors of tilt and room light, in their own standard deviations."""
    tilt, room, errors = np.array([[0.05, 0.02, -0.04], [0.03, -0.05, 0.01]]), np.array([20.0, 15, 10]), []
    for k in range(10):
        rng = np.random.default_rng(k)
        press = simulate_press(
            sensor, Ball(3.0), depth_mm=0.5, center_mm=rng.uniform(-3, 3, 2), rng=rng
        ).image
        seen = light_of(lit(press, tilt, room), rest)
        sigma = np.sqrt(np.diagonal(seen.covariance, axis1=1, axis2=2))
        errors.append(np.c_[seen.tilt - tilt.T, seen.room - room] / sigma[:, 1:])
    assert np.mean(np.abs(errors) < 2) > 0.9
    assert seen.change_sigma(block_means(rest)).max() < 0.01


def test_a_touch_is_no_light(sensor, rest):
    """Balls at the border and a face that fills half of the frame leave the light as it is."""
    for center, diameter in (((-7, 0), 8.0), ((6, 4), 6.0), ((0, 0), 20.0)):
        press = simulate_press(
            sensor, Ball(diameter), depth_mm=0.8, center_mm=center, rng=np.random.default_rng(3)
        )
        assert light_of(press.image, rest).is_plain


@pytest.mark.parametrize("light_name", ["tilted_light", "room_light"])
def test_depth_is_that_of_the_background_s_light(calibration, simulated, light_name):
    """Without it, 5 % of tilt move the depth by some percent, and room light by half of it."""
    changes = {"tilted_light": {"tilt": ((0.05,) * 3, (0,) * 3)}, "room_light": {"room": (20, 20, 20)}}
    reconstruct = gelform.Reconstructor(calibration)
    for press in simulated.presses[:3]:
        plain, other = (
            reconstruct(image) for image in (press.image, lit(press.image, **changes[light_name]))
        )
        peak = plain.depth_mm.max()
        assert np.sqrt(np.mean((plain.depth_mm - other.depth_mm) ** 2)) < 0.02 * peak
        assert light_name in [one.name for one in other.health]
        assert light_name not in [one.name for one in plain.health]
        assert (other.gradients_sigma >= 0.999 * plain.gradients_sigma.min()).all()


@pytest.mark.parametrize("name", ["mini-ball", "mini-d", "gelslim", "digit-ball"])
def test_real_presses_in_another_light_keep_their_depth_colors(data, name):
    """5 % of tilt and 20 levels of room light on pressed frames; on a GelSlim, the light has often moved by itself."""
    presses = gelform.read_presses(data / name)
    background = np.asarray(presses.background, dtype=np.float32)
    for press in presses.presses[::12]:
        own = light_of(press.image, background)
        seen = light_of(lit(press.image, ((0.05,) * 3, (0,) * 3), (20,) * 3), background)
        assert np.abs(seen.tilt - [0.05, 0] - own.tilt).max() < 0.05
        assert np.abs(seen.room - 20 - own.room).max() < 7


def test_a_usual_light_stays_while_no_other_fits_better(rest, pressed):
    """The light of the frames before is kept to the last bit, with an exposure of its own; not in another light."""
    tilt = ((0.05, 0.02, -0.04), (0.03, -0.05, 0.01))
    blocks = block_means(rest)
    usual = light_from_blocks(block_means(lit(pressed, tilt)), blocks)
    brighter = light_from_blocks(block_means(lit(pressed, tilt, gain=1.04)), blocks, usual)
    assert brighter.values is usual.values
    np.testing.assert_allclose(brighter.exposure.gain, 1.04 * usual.exposure.gain, rtol=0.005)
    assert light_from_blocks(block_means(pressed), blocks, usual).is_plain
    moved = light_from_blocks(block_means(lit(pressed, tilt, (20, 15, 10))), blocks, usual)
    np.testing.assert_allclose(moved.room, (20, 15, 10), atol=2)


def test_a_mirrored_frame_is_not_taken_for_a_tilted_one(data):
    rest = read_image(data / "mini-ball" / "background.png")
    for path in sorted((data / "mini-ball").rglob("gelsight.png"))[::20]:
        with pytest.raises(CalibrationError, match="mirrored left to right"):
            check_background(read_image(path)[:, ::-1], rest)


def step_by_numpy(image, untouched, prior, widened, values, normal, side, square, of_rest, work, sigma, least, wide, alike,
                  offset, dark, bright, learns, moves):  # fmt: skip
    """One round of the fit."""
    x, y = places(image.shape)
    gain, across, down, room = values.T
    of_light = np.exp(gain + x * across + y * down) * untouched
    seen = of_light + room + offset
    residual, per_log, per_level = (image + offset) / seen - 1, of_light / seen, 1 / seen
    total = (residual**2).sum(axis=-1)
    rest, touched = (np.exp(-total / (2 * one**2)) / one**3 for one in (sigma, wide))
    at_rest = (rest / (rest + touched))[..., None]
    terms = np.stack([per_log, per_log * x, per_log * y, per_level], axis=-1)
    weight = alike / (total.size * sigma**2)
    normal = weight * np.einsum("hwci,hwcj->cij", terms * at_rest[..., None], terms) + np.diag(prior)
    side = weight * np.einsum("hwci,hwc->ci", terms * at_rest[..., None], residual) - prior * values
    learnt = np.sqrt((at_rest[..., 0] * total).sum() / (3 * at_rest.sum() + 1e-9))
    return values, normal, side, total.ravel(), np.array([learnt])


def test_the_kernel_agrees_with_numpy():
    rng = np.random.default_rng(4)
    rest = rng.uniform(60, 180, (9, 12, 3)).astype(np.float32)
    image = (rest * 1.03 + rng.normal(0, 3, rest.shape)).astype(np.float32)
    image[:3] += 20
    values = np.array([[0.02, 0.01, 0, 3], [0.03, 0, -0.02, 1], [0.01, 0.02, 0.01, 2]])
    empty = np.empty((3, 4, 4)), np.empty((3, 4)), np.empty(108), np.empty(1), np.empty(63)
    numbers = 0.02, 0.001, 0.6, 31.0, 10.0, 2.0, 250.0, 1, 1
    given_light = light.PRIOR, np.ones(1), values, *empty, *numbers
    assert_kernel_agrees(light._fit_light, step_by_numpy, image, rest, *given_light)
