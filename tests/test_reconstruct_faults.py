"""Frames that say nothing, or only in part: findings, large sigma, bounded depth; never an exception, never NaN.
Channels at an end of the camera's range: left out where training did not show them so, on a gel that is known exactly.
Calibrations without a scale, a forward response or a deviation, as importers make them; and old files.
"""

import json
from dataclasses import replace
from itertools import product

import cv2
import numpy as np
import pytest

import gelform
from gelform.simulate.press import Twin
from made.small_gel import (
    LIGHTS,
    MM_PER_PX,
    SHAPE,
    Touch,
    background,
    calibration,
    depth_of,
    image_of,
    stepping,
)

TOUCH = Touch(depth_mm=0.4, x_px=40, y_px=40)


@pytest.fixture(scope="module")
def reconstruct():
    return gelform.Reconstructor(calibration())


def names(result):
    return [finding.name for finding in result.health]


def test_a_dead_frame_is_depth_0_of_which_nothing_is_known(reconstruct):
    for level, name in [(0, "dark"), (255, "saturated"), (200, "torn")]:
        result = reconstruct(np.full((*SHAPE, 3), level, dtype=np.uint8))
        assert name in names(result)
        assert np.abs(result.depth_mm).max() < 5e-3
        uniform = min(SHAPE) * MM_PER_PX / 12**0.5  # any depth as likely as any other
        np.testing.assert_allclose(result.depth_sigma_mm, uniform, rtol=1e-5)
        assert result.gradients_sigma.min() >= 0.999
        assert result.confidence.max() < 1e-5
        assert not result.known.any()
        assert not result.contact.any()


def test_what_is_left_of_a_torn_frame_is_measured(reconstruct):
    frame = image_of(TOUCH)
    frame[:8] = 0
    result = reconstruct(frame)
    assert names(result) == ["torn"]
    assert not result.known[:8].any()
    assert result.known[24:].all()
    assert result.depth_sigma_mm[:8].min() > 1.0
    assert result.depth_sigma_mm[24:].max() < 0.5
    below = slice(24, None)
    assert np.abs(result.depth_mm[below] - depth_of(TOUCH)[below]).max() < 0.03


def test_a_background_that_is_none_is_refused():
    for level in [0, 255, 128]:
        with pytest.raises(gelform.CalibrationError, match="This image cannot be a background"):
            gelform.Reconstructor(calibration(), background=np.full((*SHAPE, 3), level, dtype=np.uint8))


def test_a_stream_that_starts_pressed_says_so(reconstruct):
    """Its background image has a contact, which lies in the depth turned over once the object is gone."""
    pressed = reconstruct.with_background(image_of(TOUCH).astype(np.float32))
    result = pressed(background().astype(np.uint8))
    found = {finding.name: finding.figure for finding in result.health}
    assert found["background_pressed"] == pytest.approx(0.4, abs=0.1)
    assert "background_pressed" not in names(reconstruct(image_of(TOUCH)))


def test_depth_ends_where_the_gel_does(reconstruct):
    """A color change that means slopes of 5 all over: no gel does that, and the result says so."""
    ramp = np.clip(background() * np.array([0.75, 1.3, 1.0]), 0, 255)
    ramp[:, :4] = background()[:, :4]
    result = reconstruct(ramp.astype(np.float32))
    assert np.abs(result.depth_mm).max() <= min(SHAPE) * MM_PER_PX + 1e-6
    assert np.abs(result.depth_mm).max() < 1e-3 or result.health


def test_depth_stays_within_the_gel_where_its_thickness_is_known():
    """The field of view alone would allow 6.4 mm."""
    thin = replace(calibration(), settings={"gel_thickness_mm": 0.3})
    result = gelform.Reconstructor(thin)(image_of(TOUCH))
    assert "beyond_gel" in names(result)
    assert result.depth_mm.max() == np.float32(0.3)
    assert "beyond_gel" not in names(gelform.Reconstructor(calibration())(image_of(TOUCH)))


def test_a_seam_right_at_a_contact_is_found(reconstruct):
    """The row below it jumps too, as the displaced ball begins there."""
    frame = image_of(Touch(radius_mm=3.5, depth_mm=0.27, x_px=50, y_px=41.4, seed=216))
    frame[28:] = np.roll(frame[28:], 40, axis=1)
    result = reconstruct(frame)
    assert names(result) == ["torn"]
    assert not result.known[30:60].any()
    assert np.abs(result.depth_mm).max() < 0.1


TOUCH_RECONSTRUCT_CLIPPED = Touch(radius_mm=3.0, depth_mm=0.6, x_px=40, y_px=32)
DEPTH = depth_of(TOUCH_RECONSTRUCT_CLIPPED)
SLOPES = np.stack(np.gradient(DEPTH, MM_PER_PX)[::-1], axis=-1)
INSIDE = DEPTH > 0.03
SHOWN = np.ones((2, 3), bool)
BOX = np.s_[5:15, 60:75]  # beside the ball


def learnt(known):
    """A calibration whose presses showed every channel at both ends."""
    return replace(known, forward=replace(known.forward, clipped=SHOWN))


def exposed(*channels, level=240):
    """Background and image of which some channels are at a level at rest; of 240 the ball's bright side is beyond 255."""
    rest = background().copy()
    rest[..., list(channels)] = level
    normals = np.concatenate([-SLOPES, np.ones((*SHAPE, 1))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    light = rest * np.maximum(normals @ LIGHTS.T, 0) + np.random.default_rng(1).normal(0, 1, rest.shape)
    image = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    assert (np.count_nonzero(image >= 254) > 250) == (level == 240)
    return rest, image


def slope_error(result, where):
    return float(np.sqrt(np.mean(np.square(result.observed_gradients - SLOPES)[where])))


def depth_error_um(result):
    return 1e3 * np.sqrt(np.mean((result.depth_mm - DEPTH) ** 2))


def test_a_channel_that_clips_in_use_is_left_out():
    """Each pixel here lacks one channel at most: the other two say the slope nearly as well."""
    for channels in [(0,), (1,), (2,), (0, 1, 2)]:
        rest, image = exposed(*channels)
        clips = (image >= 254).any(axis=-1) & INSIDE
        reconstruct = gelform.Reconstructor(replace(stepping(), background=rest))
        result, why = reconstruct(image), reconstruct.explain(image)
        as_it_is = gelform.Reconstructor(replace(learnt(stepping()), background=rest))(image)
        assert slope_error(result, clips) < 0.6 * slope_error(as_it_is, clips)
        assert slope_error(result, clips) < 1.5 * slope_error(result, INSIDE & ~clips)
        off = np.linalg.norm(result.observed_gradients - SLOPES, axis=-1)
        assert (off > 3 * why.gradients_sigma)[clips].mean() < 0.01
        assert np.median(result.confidence[clips]) == 1
        assert (why.maps["saturated"][clips] > 0).all()
        assert depth_error_um(result) < 3


def test_what_is_left_out_is_missed():
    """The step's own deviation says what two channels say less than three, of the same ball less exposed."""
    for channel in [0, 1, 2]:
        rest, image = exposed(channel)
        two = gelform.Reconstructor(replace(stepping(), background=rest)).explain(image)
        clips = (image >= 254).any(axis=-1) & INSIDE
        rest, image = exposed(channel, level=200)
        three = gelform.Reconstructor(replace(stepping(), background=rest)).explain(image)
        assert not three.maps["saturated"].any()
        assert 1.1 < np.median(two.maps["saturated"][clips] / three.law[clips]) < 2
        beside = (two.maps["saturated"] == 0) & INSIDE
        assert np.median(two.law[beside] / three.law[beside]) == pytest.approx(1, abs=0.02)


def test_a_channel_that_training_showed_clipped_counts_fully():
    for channel, (level, within) in product([0, 1, 2], [(254, 253), (2, 3), (0, 3)]):
        image, other = image_of(TOUCH_RECONSTRUCT_CLIPPED), image_of(TOUCH_RECONSTRUCT_CLIPPED)
        image[BOX[0], BOX[1], channel], other[BOX[0], BOX[1], channel] = level, within
        shown, left_out = gelform.Reconstructor(learnt(stepping())), gelform.Reconstructor(stepping())
        why = shown.explain(image).maps
        assert not np.any([why["saturated"], why["dark"]])
        read = [[made(one).observed_gradients[BOX] for one in (image, other)] for made in (shown, left_out)]
        assert np.abs(read[0][0] - read[0][1]).max() < 0.1 < np.abs(read[1][0] - read[1][1]).max()


def test_of_two_clipped_channels_nothing_is_known():
    for channels, level in product([[0, 1], [0, 2], [1, 2], [0, 1, 2]], [0, 2, 254, 255]):
        image = image_of(TOUCH_RECONSTRUCT_CLIPPED)
        image[BOX[0], BOX[1], channels] = level
        reconstruct = gelform.Reconstructor(stepping())
        result, why = reconstruct(image), reconstruct.explain(image)
        assert 0 < result.confidence[BOX].max() < 1e-5
        assert result.gradients_sigma[BOX].min() > 0.2
        name = "dark" if level < 100 else "saturated"
        assert [finding.name for finding in why.findings] == [name]
        assert depth_error_um(result) < 8


def test_a_dead_channel_beside_the_ball_does_no_harm():
    for channel, level in product([0, 1, 2], [0, 255]):
        image = image_of(TOUCH_RECONSTRUCT_CLIPPED)
        image[BOX[0], BOX[1], channel] = level
        reconstruct = gelform.Reconstructor(stepping())
        result, why = reconstruct(image), reconstruct.explain(image)
        off = np.linalg.norm(result.observed_gradients - SLOPES, axis=-1)
        assert (off[BOX] < 4 * why.gradients_sigma[BOX]).all()
        assert (why.maps["dark" if level == 0 else "saturated"][BOX] > 0).all()
        assert depth_error_um(result) < 12


def test_without_a_step_a_clipped_channel_costs_the_pixel_its_weight():
    """As in calibrations that were imported; the rest gives its result."""
    image, own = image_of(TOUCH_RECONSTRUCT_CLIPPED), calibration().slope_sigma
    image[BOX[0], BOX[1], 1] = 255
    stepless = replace(stepping(), forward=replace(stepping().forward, step_sigma=None))
    for known, sigma in product([calibration(), stepless], [own, None]):
        result = gelform.Reconstructor(replace(known, slope_sigma=sigma))(image)
        assert result.confidence[BOX].max() < 1e-5
        assert (result.gradients_sigma is None) == (sigma is None)
        assert depth_error_um(result) < 10
    mixed = ((0.9, 0.08, 0.02), (0.1, 0.85, 0.05), (0.0, 0.1, 0.9))
    undone = replace(stepping(), change=replace(stepping().change, crosstalk=mixed))
    in_all_three = gelform.Reconstructor(undone)(image)
    assert in_all_three.confidence[BOX].max() < 1e-5


def test_black_dots_and_a_corner_that_is_never_lit_clip_nothing_around_them():
    y, x = np.indices(SHAPE)
    dots, corner = ((y - 4) % 10 < 4) & ((x - 4) % 10 < 4) & (y > 3) & (x > 3), (y < 10) & (x < 12)
    for name, black in (("marker", dots), ("outside", corner)):
        rest, image = background().copy(), image_of(TOUCH_RECONSTRUCT_CLIPPED)
        rest[black], image[black] = 1, 1 if name == "marker" else 0
        why = gelform.Reconstructor(replace(stepping(), background=rest)).explain(image)
        assert {finding.name for finding in why.findings} == {name}
        assert why.maps[name].any()
        assert not why.maps["dark"].any()


def test_an_average_of_presses_is_no_background(calibration, presses):
    """Each press is an eighth as deep in it, with less structure than half of a press has."""
    pressed = np.mean([one.image for one in presses.presses[:8]], axis=0)
    found = {one.name: one for one in gelform.Reconstructor(calibration, background=pressed).findings}
    assert "more of it, compared with the calibration's" in found["background_touched"].message
    rest, noise = presses.background.astype(np.float32), np.random.default_rng(1)
    for gain in (1.0, 0.97):
        today = np.clip(gain * rest + noise.normal(0, 1.5, rest.shape), 0, 255)
        names = {one.name for one in gelform.Reconstructor(calibration, background=today).findings}
        assert "background_touched" not in names


@pytest.fixture
def bare(calibration):
    """The calibration with everything taken away that an importer may not know."""
    return replace(calibration, mm_per_px=None, mm_per_px_sigma=None, forward=None, slope_sigma=None)


@pytest.fixture
def image(simulated):
    return simulated.presses[1].image


def test_depth_in_pixels_and_none_in_mm(bare, image):
    result = gelform.Reconstructor(bare)(image)
    for name in ("depth_mm", "peak_mm"):
        with pytest.raises(gelform.GelformError, match=r"scale .* unknown.*depth_px.*--mm-per-px"):
            getattr(result, name)
    assert result.mm_per_px is None
    scaled = gelform.Reconstructor(replace(bare, mm_per_px=0.1153))(image)
    np.testing.assert_array_equal(result.observed_gradients, scaled.observed_gradients)
    np.testing.assert_allclose(result.gradients, scaled.gradients, atol=2e-3)
    np.testing.assert_array_equal(scaled.depth_px, scaled.depth_mm / np.float32(0.1153))
    assert np.abs(result.depth_px - scaled.depth_px).max() < 0.02 * scaled.depth_px.max()
    assert scaled.depth_px.max() > 3
    assert scaled.contact.any()
    of_usual_width = gelform.Reconstructor(replace(bare, mm_per_px=20 / bare.image_shape[1]))(image)
    np.testing.assert_array_equal(result.contact, of_usual_width.contact)


def test_no_claim_of_confidence_but_for_clipped_pixels(bare, image):
    clipped = image.copy()
    clipped[10:14, 20:25, 1] = 255
    clipped[30, 40, 2] = 0
    result = gelform.Reconstructor(bare)(clipped)
    assert result.gradients_sigma is None
    there = ((clipped <= 2) | (clipped >= 254)).any(axis=-1)
    assert 0 < np.count_nonzero(there) < 1000
    assert result.confidence[there].max() < 1e-5
    reached = cv2.dilate(there.astype(np.uint8), np.ones((15, 15), np.uint8)) > 0
    assert (result.confidence[~reached] == 1).all()


def test_the_file_of_a_result_in_pixels_and_of_one_in_mm(bare, calibration, image, tmp_path):
    path = tmp_path / "result.npz"
    in_px, in_mm = (bare, "depth_px", {"depth_mm", "mm_per_px"}), (calibration, "depth_mm", {"depth_px"})
    for known, there, absent in (in_px, in_mm):
        result = gelform.Reconstructor(known)(image)
        gelform.save_result(result, path, overwrite=True)
        with np.load(path) as file:
            assert not absent & set(file.files)
            np.testing.assert_array_equal(file[there], getattr(result, there))
            assert json.loads(str(file["meta"]))["format_version"] == 1
        again = gelform.load_result(path)
        np.testing.assert_array_equal(again.depth_px, result.depth_px)
        assert again.mm_per_px == known.mm_per_px
        if known is bare:
            with pytest.raises(gelform.GelformError, match="scale"):
                again.depth_mm  # noqa: B018
    with pytest.raises(gelform.GelformError, match="square pixels"):
        replace(result, mm_per_px=(0.1, 0.2)).depth_px  # noqa: B018


def test_shown_in_pixels(bare, image):
    result = gelform.Reconstructor(bare)(image)
    assert "scale unknown" in repr(result)
    assert " mm" not in repr(result)
    assert "scale unknown" in result._repr_html_()
    pytest.importorskip("matplotlib", reason="matplotlib, the extra `plots`, is not installed")
    assert gelform.picture(result, image).shape[2] == 3


def test_what_needs_more_says_so(bare, presses):
    with pytest.raises(gelform.CalibrationError, match="without a forward response"):
        bare.color_from_gradients(np.zeros((*bare.image_shape, 2)))
    with pytest.raises(gelform.CalibrationError, match=r"scale .* unknown"):
        Twin(bare)
    with pytest.raises(gelform.GelformError, match=r"scale .* unknown"):
        gelform.evaluate(bare, presses)
