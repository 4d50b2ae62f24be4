"""The gain, a tilt and a room's light come back from pressed frames, and nothing else is taken for them.

A moved image is registered to hundredths of a pixel where there is texture; where there is none nothing is claimed.
"""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import map_coordinates

import gelform
from gelform._native import Kernel
from gelform.errors import CalibrationError
from gelform.image import light
from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.image.light import (
    block_means,
    gain_from_blocks,
    light_from_blocks,
    scale_of_light,
    without_light,
)
from gelform.image.registration import PreparedRegistration, registration_from_image
from gelform.sensors.files import read_image
from gelform.simulate import Ball, simulate_background, simulate_press
from kernel_agreement import assert_kernel_agrees

pytestmark = pytest.mark.linear_algebra
LIT_BLOCKS = Kernel(  # a step of `gain_of_blocks`
    "lit_blocks",
    "f32[h,w,3] blocks, f32[h,w,3] untouched, i64 step, f32 dark, f32 bright, out f32[8,n] lit, out f32[3] medians, "
    "out f32[m] work",
)


@pytest.fixture(scope="module")
def rest(sensor):
    return simulate_background(sensor, np.random.default_rng(0))


@pytest.fixture(scope="module")
def pressed(sensor):
    rng = np.random.default_rng(1)
    return simulate_press(sensor, Ball(3.0), depth_mm=0.6, center_mm=(1.5, 1), rng=rng).image


GAINS = st.tuples(*[st.floats(0.85, 1.2)] * 3)
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


@settings(max_examples=30, deadline=None)
@given(GAINS)
def test_a_gain_comes_back_on_a_pressed_frame(rest, pressed, gain):
    own, seen = light_of(pressed, rest), light_of(lit(pressed, gain=np.array(gain)), rest)
    assert own.is_known
    assert seen.is_known
    assert np.abs(seen.gain / own.gain / gain - 1).max() < 0.004
    assert np.abs(own.gain - 1).max() < 0.01


def test_a_large_contact_does_not_pull_the_gain(sensor, rest):
    """Two thirds of the frame slope: the third that does not still tells the gain."""
    wide = replace(sensor, relaxation_mm=1.2, gel=replace(sensor.gel, thickness_mm=8.0))
    press = simulate_press(wide, Ball(12.0), depth_mm=1.5, center_mm=(-4, 0), rng=np.random.default_rng(2))
    sloping = np.linalg.norm(press.gradients, axis=-1) > 0.02
    assert 0.55 < sloping.mean() < 0.8
    seen = light_of(lit(press.image, gain=np.array([1.08, 0.95, 1.0])), rest)
    assert seen.is_known
    assert np.abs(seen.gain / (1.08, 0.95, 1.0) - 1).max() < 0.015


def test_an_unsure_tilt_to_the_right_is_an_unsure_change_at_the_sides():
    covariance = np.zeros((3, 4, 4))
    covariance[:, 1, 1] = 0.1**2
    found = light.FrameLight(fit=SimpleNamespace(covariance=covariance)).change_sigma(
        np.full((3, 5, 3), 100, np.float32)
    )
    np.testing.assert_allclose(found, np.tile([0.08, 0.04, 0, 0.04, 0.08], (3, 1)), atol=1e-7)


def test_where_nothing_agrees_the_gain_is_unknown_and_its_deviation_says_so(rest):
    """Every part of the frame has another color change."""
    y, x = np.mgrid[: rest.shape[0], : rest.shape[1]] / rest.shape[0]
    change = np.stack([0.4 * np.sin(3 * x + y), 0.4 * np.cos(4 * y), 0.4 * np.sin(5 * x - 2 * y)], axis=-1)
    seen = light_of(np.clip(np.rint(rest * (1 + change)), 0, 255), rest)
    assert not seen.is_known
    assert seen.covariance[:, 0, 0].min() > 0.01**2
    bare = PreparedBackground(rest, ChangeSettings())
    assert bare.light_sigma(seen).min() > 0.01
    assert bare.light_sigma(light_of(rest, rest)) is None


def test_dark_and_saturated_blocks_tell_nothing():
    rest = np.full((60, 80, 3), 120, dtype=np.uint8)
    image = rest.copy()
    image[:40] = 255  # cut off: it would tell 2.1
    image[40:] = 126
    assert light_of(image, rest).gain == pytest.approx([1.05] * 3, abs=1e-3)
    nothing = light_of(np.zeros_like(rest), rest)
    assert not nothing.is_known
    assert nothing.share == 0
    np.testing.assert_array_equal(nothing.gain, 1)


@pytest.mark.parametrize(("level", "known"), [(7.6, False), (8.4, True), (249.6, True), (250.4, False)])
def test_between_which_levels_a_block_tells_the_gain(level, known):
    """Below, noise rules the ratio; above, the sensor's end."""
    blocks = np.full((4, 5, 3), level, dtype=np.float32)
    assert gain_from_blocks(blocks, blocks).is_known == known


@pytest.mark.parametrize(
    ("name", "step", "gains"),
    [
        ("mini-ball", 9, [(1.08, 1.08, 1.08), (0.93, 1.05, 1.0)]),
        # On most of these presses, a seventh to a third of the image agrees to 2 %.
        ("digit-ball", 6, [(1.05, 1.05, 1.05)]),
    ],
)
def test_real_presses_give_their_gain_back(data, name, step, gains):
    presses = gelform.read_presses(data / name)
    rest = presses.background
    for press in presses.presses[::step]:
        own = light_of(press.image, rest)
        if name == "mini-ball":
            assert own.share > 0.5
            assert np.abs(own.gain - 1).max() < 0.03
        for gain in gains:
            seen = light_of(lit(press.image, gain=np.array(gain)), rest)
            np.testing.assert_allclose(seen.gain / own.gain, gain, rtol=0.003)


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
    assert seen.is_known  # though a gain and room light are much alike


@pytest.mark.parametrize(
    ("levels", "is_room"),
    [((10, 4, 2.1), True), ((-2.1, -10, -4), True), ((10, 4, 1.9), False), ((10, 10, -3), False)],
)
def test_a_rooms_light_reaches_all_channels_with_one_sign(levels, is_room):
    values = np.column_stack([np.zeros((3, 3)), levels])
    assert light._Fit(values, *[None] * 8).has_room is is_room


def test_its_deviation_is_that_of_its_errors(sensor, rest):
    """Ten presses in one light: the errors of tilt and room light, in their own standard deviations."""
    tilt, room, errors = np.array([[0.05, 0.02, -0.04], [0.03, -0.05, 0.01]]), np.array([20.0, 15, 10]), []
    for k in range(10):
        rng = np.random.default_rng(k)
        press = simulate_press(sensor, Ball(3.0), depth_mm=0.5, center_mm=rng.uniform(-3, 3, 2), rng=rng)
        seen = light_of(lit(press.image, tilt, room), rest)
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
    np.testing.assert_array_equal(brighter.values[:, 1:], usual.values[:, 1:])
    np.testing.assert_allclose(brighter.gain, 1.04 * usual.gain, rtol=0.005)
    assert light_from_blocks(block_means(pressed), blocks, usual).is_plain
    moved = light_from_blocks(block_means(lit(pressed, tilt, (20, 15, 10))), blocks, usual)
    np.testing.assert_allclose(moved.room, (20, 15, 10), atol=2)


def test_a_mirrored_frame_is_not_taken_for_a_tilted_one(data):
    rest = read_image(data / "mini-ball" / "background.png")
    for path in sorted((data / "mini-ball").rglob("gelsight.png"))[::20]:
        with pytest.raises(CalibrationError, match="mirrored left to right"):
            PreparedBackground(rest, ChangeSettings()).compare(read_image(path)[:, ::-1])


def step_by_numpy(found, count, prior, is_free, widened, values, normal, farthest, *more):
    """One round of the fit."""
    _, _, sigma, _, _, wide, alike, offset = more
    blocks, rest, (x, y) = found[:3, :count].T, found[3:6, :count].T, found[6:, :count, None]
    gain, across, down, room = values.T
    of_light = np.exp(gain + x * across + y * down) * rest
    residual = (blocks + offset) / (of_light + room + offset) - 1
    per_log, per_level = of_light / (of_light + room + offset), 1 / (of_light + room + offset)
    total = (residual**2).sum(axis=-1)
    both = [-total / (2 * one**2) - 3 * np.log(one) for one in (sigma, wide)]
    at_rest = np.exp(both[0] - np.logaddexp(*both))[:, None]
    terms = np.stack([per_log, per_log * x, per_log * y, per_level], axis=-1)
    weight = alike / (count * sigma**2)
    normal = weight * np.einsum("nci,ncj->cij", terms * at_rest[..., None], terms) + np.diag(prior)
    side = weight * np.einsum("nci,nc->ci", terms * at_rest[..., None], residual) - prior * values
    likelihood, few = alike * np.logaddexp(*both).mean(), normal[:, is_free][..., is_free]
    evidence = likelihood - (prior * values**2)[:, is_free].sum() / 2 + 1.5 * np.log(prior[is_free]).sum()
    evidence -= np.linalg.slogdet(few)[1].sum() / 2
    gained = [
        np.sum(b * np.linalg.solve(a, b[..., None])[..., 0]) / 2
        for a, b in ((normal, side), (few, side[:, is_free]))
    ]
    learnt = np.sqrt((at_rest[:, 0] * total).sum() / (3 * at_rest.sum() + 1e-9))
    farthest[:count] = np.abs(blocks / (of_light + room) - 1).max(axis=1)
    figures = np.array([learnt, at_rest.sum(), likelihood, evidence, gained[0] - gained[1]])
    return values, normal, farthest, figures


@pytest.mark.parametrize("is_free", [light.GAIN, light.TILTED, light.BOTH], ids=["gain", "tilted", "both"])
def test_the_fit_agrees_with_numpy(is_free):
    rng = np.random.default_rng(4)
    rest = rng.uniform(60, 180, (9, 12, 3)).astype(np.float32)
    image = (rest * 1.03 + rng.normal(0, 3, rest.shape)).astype(np.float32)
    image[:3] += 20
    seen = light._LitBlocks(image, rest, every=1)
    values = np.array([[0.02, 0.01, 0, 3], [0.03, 0, -0.02, 1], [0.01, 0.02, 0.01, 2]])
    size = seen._lit.shape[1]
    empty = np.empty((3, 4, 4)), np.zeros(size, np.float32), np.empty(5), np.empty(14 * size, np.float32)
    given_light = seen._lit, seen.count, light.PRIOR, is_free, np.ones(1), values, *empty
    assert_kernel_agrees(light._fit_light, step_by_numpy, *given_light, 0.02, 0.001, 1.0, 0.6, 31.0, 10.0)


@pytest.mark.parametrize("shape", [(60, 80), (120, 160), (240, 320), (132, 176)])
def test_blocks_are_rounded_as_opencv_rounds_them(shape):
    """Halves of 2x2 pixels up, of more to even; 132x176 has fractions of pixels."""
    image = np.random.default_rng(5).integers(0, 256, (*shape, 3), dtype=np.uint8)
    found = block_means(image)
    expected = cv2.resize(image, found.shape[1::-1], interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("shape", "step"), [((24, 32), 8), ((30, 45), 15), ((12, 21), 3)])
def test_the_means_of_bytes_are_those_of_opencv(shape, step):
    image = np.random.default_rng(5).integers(0, 256, (*shape, 3), dtype=np.uint8)
    image[: shape[0] // 2] //= 2
    size = shape[1] // step, shape[0] // step

    def by_opencv(image, *_):
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)

    work, means = np.zeros(3 * shape[1], np.uint16), np.zeros((size[1], size[0], 3), np.float32)
    assert_kernel_agrees(light._means_of_bytes, by_opencv, image, step, work, means)


def lit_by_numpy(blocks, untouched, step, dark, bright, lit, medians, work):
    both = np.concatenate([blocks, untouched], axis=-1)[::step, ::step]
    y, x = np.meshgrid(*((2 * np.arange(n) + 1) / n - 1 for n in blocks.shape[:2]), indexing="ij")
    kept = ((both > dark) & (both < bright)).all(axis=-1)
    found = np.zeros_like(lit)
    found[:, : kept.sum()] = [*both[kept].T, x[::step, ::step][kept], y[::step, ::step][kept]]
    return found, np.median(both[kept][:, :3] / both[kept][:, 3:], axis=0)


@pytest.mark.parametrize(
    ("shape", "step"), [((5, 7), 1), ((12, 17), 2), ((9, 12), 1), ((9, 12), 2), ((1, 1), 1)]
)
def test_lit_blocks_agree_with_numpy(shape, step):
    blocks, untouched = np.random.default_rng(3).uniform(1, 254, (2, *shape, 3)).astype(np.float32)
    blocks[0, 0], untouched[0, 0] = 110, 100
    size = blocks[::step, ::step, 0].size + 1
    out = np.zeros((8, size), np.float32), np.zeros(3, np.float32), np.empty(2 * size, np.float32)
    asked = step, 20.0, 240.0, *out
    count = LIT_BLOCKS(blocks, untouched, *asked)
    lit, medians = lit_by_numpy(blocks, untouched, *asked)
    assert count == np.count_nonzero(lit[0])
    assert 0 < count < size - (shape != (1, 1))
    np.testing.assert_allclose(out[0][:, :count], lit[:, :count], atol=1e-6)
    np.testing.assert_allclose(out[1], medians, rtol=1e-6)
    # What a block leaves behind the last lit one counts no more: of one that is lit to the end there is none.
    whole = np.clip(blocks, 30, 200), np.clip(untouched, 30, 200)
    assert_kernel_agrees(LIT_BLOCKS, lit_by_numpy, *whole, *asked)


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
    channels = [map_coordinates(one, sources[::-1], mode="mirror") for one in np.moveaxis(image, -1, 0)]
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
    unknown = textured(noisy(gel(0.03), 1), np.ones(SHAPE, dtype=bool))
    assert (unknown.untouched, unknown.moved_px()) == (0, 0)
    assert (unknown.shift_px.tolist(), unknown.shift_sigma_px.tolist()) == ([0, 0], [5, 5])


@pytest.mark.parametrize("shift", [(3, 4), (-3, -4)])
def test_certain_motion_is_shorter_than_the_motion(textured, shift):
    found = textured(noisy(moved(gel(0.03), shift), 1))
    assert 4.5 < found.moved_px() < 5


@pytest.mark.parametrize("touched", [np.zeros((0, 80), bool), np.zeros((64, 0), bool), np.zeros((64, 80))])
def test_what_is_no_mask_and_other_sizes_are_refused(touched):
    image = np.full((64, 80, 3), 90.0)
    with pytest.raises((ValueError, TypeError), match="Expected touched"):
        registration_from_image(image, image, touched)
    with pytest.raises(ValueError, match="144"):
        registration_from_image(np.zeros((10, 20, 3), np.uint8), gel(0.0))


def test_what_undoes_a_light_is_its_inverse():
    light = np.random.default_rng(0).uniform(-0.2, 0.2, (3, 4)) + np.array([0, 0, 0, 9])
    image = np.random.default_rng(1).uniform(50, 200, (6, 8, 3)).astype(np.float32)
    columns, rows, room = np.split(scale_of_light(image.shape, light), [24, 42])
    undone = (image - room) * columns.reshape(8, 3) * rows.reshape(6, 1, 3)
    np.testing.assert_allclose(undone, without_light(image, light), rtol=1e-5)


def correlation_by_numpy(seen, rest, scale, *_):
    scaled = seen * scale
    distance = np.abs(scaled - rest).sum(axis=1)
    least = distance <= np.sort(distance)[len(distance) // 2]
    a, b = (values[least].astype(np.float64) for values in (scaled, rest))
    if b.std() < 0.01:
        return np.array([np.nan])
    return np.array([np.corrcoef(a.ravel(), b.ravel())[0, 1] if a.std() >= 0.01 else 0])


def test_the_correlation_over_the_least_changed_blocks_is_that_of_numpy():
    assert_kernel_agrees(light._correlation, correlation_by_numpy)
    seen, rest = np.random.default_rng(2).uniform(20, 200, (2, 40, 3)).astype(np.float32)
    for pair in ((seen, np.full_like(rest, 90)), (np.full_like(seen, 90), rest)):
        given = np.ones(3, np.float32), np.empty(80, np.float32), np.zeros(1)
        assert_kernel_agrees(light._correlation, correlation_by_numpy, *pair, *given)


def test_the_gain_of_blocks_is_that_of_its_steps():
    def by_steps(image, blocks, untouched, prior, is_free, widened, *out_and_numbers):
        lit, values, normal, far, figures, beside, work, step, dark, bright, *of_fit = out_and_numbers
        if image is not None:
            block = len(image) // len(blocks)
            light._means_of_bytes(image, block, np.empty(3 * image.shape[1], np.uint16), blocks)
        medians = np.empty(3, np.float32)
        count = LIT_BLOCKS(blocks, untouched, step, dark, bright, lit, medians, work)
        values[:] = 0
        values[:, 0] = np.log(medians.astype(float))
        light._fit_light(lit, count, prior, is_free, widened, values, normal, far, figures, work, *of_fit)
        order, gain = np.sort(far[:count]), np.exp(-values[:, 0]).astype(np.float32)
        pairs = (one.reshape(-1, 3) for one in (blocks, untouched))
        light._correlation(*pairs, gain, work, beside[3:])
        beside[:2] = order[[count // 4, count // 2]] if count else np.nan
        beside[2] = normal[:, 0, 0].min()
        return blocks, lit, values, normal, far, figures, beside

    assert_kernel_agrees(light._gain_of_blocks, by_steps)
