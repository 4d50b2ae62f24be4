"""Exposure: the gain that was applied comes back, whatever touches the gel, and no touch is taken for one."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.image.background import exposure
from gelform.image.background.change import ChangeSettings, PreparedBackground
from gelform.image.background.exposure import Exposure, exposure_from_image
from gelform.image.background.light import FrameLight
from gelform.sensors.files import read_image
from gelform.simulate import Ball, simulate_press
from kernel_agreement import assert_kernel_agrees

GAINS = st.tuples(*[st.floats(0.85, 1.2)] * 3)


def times(image, gain):
    return np.clip(np.rint(image.astype(float) * gain), 0, 255).astype(np.uint8)


@settings(max_examples=30, deadline=None)
@given(GAINS)
def test_a_gain_comes_back_on_a_pressed_frame(rest, pressed, gain):
    own = exposure_from_image(pressed, rest)
    seen = exposure_from_image(times(pressed, gain), rest)
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
    seen = exposure_from_image(times(press.image, (1.08, 0.95, 1.0)), rest)
    assert seen.is_known
    assert np.abs(seen.gain / (1.08, 0.95, 1.0) - 1).max() < 0.01


def test_too_little_untouched_is_said_and_compensates_nothing(rest):
    """Every part of the frame has another color change: nothing agrees on a gain."""
    y, x = np.mgrid[: rest.shape[0], : rest.shape[1]] / rest.shape[0]
    change = np.stack([0.4 * np.sin(3 * x + y), 0.4 * np.cos(4 * y), 0.4 * np.sin(5 * x - 2 * y)], axis=-1)
    seen = exposure_from_image(times(rest, 1 + change), rest)
    assert not seen.is_known
    np.testing.assert_array_equal(seen.believed_gain, 1)
    assert seen.gain_sigma == 0.05
    bare = PreparedBackground(rest, ChangeSettings())
    np.testing.assert_array_equal(bare.change(rest, FrameLight(seen)), bare.change(rest))


def test_belief_grows_without_a_jump_and_doubt_falls_with_it():
    seen = [Exposure(np.full(3, 1.1), share, 0, 0) for share in np.linspace(0, 1, 101)]
    gains, sigmas = np.array([(one.believed_gain[0], one.gain_sigma) for one in seen]).T
    assert (gains[7], gains[15]) == (1, pytest.approx(1.1))
    assert 0 <= np.diff(gains).min() <= np.diff(gains).max() < 0.02
    np.testing.assert_allclose(sigmas / 0.05, 1 - np.log(gains) / np.log(1.1), atol=1e-12)


def test_dark_and_saturated_cells_tell_nothing():
    rest = np.full((60, 80, 3), 120, dtype=np.uint8)
    image = rest.copy()
    image[:40] = 255  # cut off: it would tell 2.1
    image[40:] = 126
    assert exposure_from_image(image, rest).gain == pytest.approx([1.05] * 3, abs=1e-3)
    nothing = exposure_from_image(np.zeros_like(rest), rest)
    assert not nothing.is_known
    assert nothing.gain is None
    np.testing.assert_array_equal(nothing.believed_gain, 1)


def test_real_presses_give_their_gain_back(data):
    rest = read_image(data / "mini-ball" / "background.png")
    for path in sorted((data / "mini-ball").rglob("gelsight.png"))[::9]:
        image = read_image(path)
        own = exposure_from_image(image, rest)
        assert own.share > 0.5
        assert np.abs(own.gain - 1).max() < 0.03
        for gain in ((1.08, 1.08, 1.08), (0.93, 1.05, 1.0)):
            seen = exposure_from_image(times(image, gain), rest)
            assert np.abs(seen.gain / own.gain / gain - 1).max() < 0.003


def test_a_digit_pressed_all_over_gives_its_gain_back(data):
    """On most of these presses, a seventh to a third of the image is at rest."""
    folder = data / "digit-ball"
    rest = read_image(folder / "background.png")
    for path in sorted((folder / "images").iterdir())[::6]:
        image = read_image(path)
        own, other = (exposure_from_image(times(image, gain), rest) for gain in (1, 1.05))
        np.testing.assert_allclose(other.believed_gain / own.believed_gain, 1.05, atol=0.015)


def crowd(logs, half_widths, center, distances):
    """The fullest window of each channel, then the mean of what is near in all, round by round."""
    bins = np.clip(((logs + 1.2) * 100).astype(int), 0, 239)
    counts = [np.convolve(np.bincount(bins[:, c], minlength=240), np.ones(6), "valid") for c in range(3)]
    found = np.array([(np.argmax(count) + 3) / 100 - 1.2 for count in counts])
    for half_width in half_widths:
        distance = np.abs(logs - found).max(axis=1)
        found = found + (logs - found)[distance < half_width].mean(axis=0)
    return found, distance


@pytest.mark.parametrize("count", [7, 1200])
def test_the_kernel_agrees_with_numpy(count):
    rng = np.random.default_rng(count)
    logs = rng.normal([0.05, -0.1, 0.02], 0.02, (count, 3)).astype(np.float32)
    logs[: count // 3] += rng.uniform(-0.5, 0.5, (count // 3, 3)).astype(np.float32)
    arguments = logs, exposure.HALF_WIDTHS_LOG, np.empty(3), np.empty(count)
    assert_kernel_agrees(exposure._crowd_of_ratios, crowd, *arguments)


def test_the_lit_ratios_are_those_of_numpy():
    rng = np.random.default_rng(2)
    seen, rest = rng.uniform(1, 254, (2, 50, 3)).astype(np.float32)
    lit = ((np.minimum(seen, rest) > 20) & (np.maximum(seen, rest) < 240)).all(axis=1)
    ratios = np.zeros((51, 3), np.float32)
    count = exposure._lit_ratios(seen, rest, 20.0, 240.0, ratios)
    assert 0 < count == np.count_nonzero(lit) < 50
    np.testing.assert_array_equal(ratios[:count], (seen / rest)[lit])
    assert_kernel_agrees(
        exposure._lit_ratios, lambda *_: ratios.copy(), seen, rest, 20.0, 240.0, np.zeros_like(ratios)
    )


@pytest.mark.parametrize(("shape", "step"), [((24, 32), 8), ((30, 45), 15), ((12, 21), 3)])
def test_the_means_of_bytes_are_those_of_opencv(shape, step):
    image = np.random.default_rng(5).integers(0, 256, (*shape, 3), dtype=np.uint8)
    image[: shape[0] // 2] //= 2
    size = shape[1] // step, shape[0] // step

    def by_opencv(image, *_):
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)

    work, means = np.zeros(3 * shape[1], np.uint16), np.zeros((size[1], size[0], 3), np.float32)
    assert_kernel_agrees(exposure._means_of_bytes, by_opencv, image, step, work, means)


@pytest.mark.parametrize(("level", "known"), [(7.6, False), (8.4, True), (249.6, True), (250.4, False)])
def test_between_which_levels_a_block_tells_the_gain(level, known):
    """Below, noise rules the ratio; above, the sensor's end."""
    blocks = np.full((20, 3), level, dtype=np.float32)
    assert (exposure.exposure_from_blocks(blocks, blocks).gain is not None) == known
