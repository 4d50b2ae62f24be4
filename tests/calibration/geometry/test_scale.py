"""Scales carry what they come from: hand-worked uncertainties, weights, and disagreements that are refused.

The scale of simulated sensors from a step of a stage: within 0.6 %, and within three of its own sigmas.

Grids seen through a known lens: the residual under 0.1 px, the scale true, and calibration better for it.

Crosstalk comes back from frames with one LED lit, and undone images are those of a sensor without it.

What was measured beside the presses, as a sensor.toml holds it and as a report says it.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform import Reconstructor, calibrate, with_scale
from gelform.calibration.geometry.measured import Crosstalk, Geometry, crosstalk_from_frames
from gelform.calibration.geometry.scale import (
    Scale,
    combined_scale,
    scale_from_points,
    scale_from_profile,
    scale_from_stage,
    view_from_grid,
)
from gelform.errors import DataError, SensorError
from gelform.image.background import ChangeSettings, color_change_from_image
from gelform.image.view import Lens, image_from_frame, image_px_from_frame_px
from gelform.simulate import LAYOUTS, Ball, Coin, Optics, Punch, simulate_background, simulate_press
from gelform.simulate.presets import gelsight_mini
from gelform.simulate.sensor import IDENTITY


def test_two_points():
    scale = scale_from_points((10, 20), (310, 420), 25.0, sigma_px=0.5, sigma_mm=0.05)
    assert scale.mm_per_px == pytest.approx(0.05)
    # 25 mm +- 0.05 over 500 px +- 0.707: 0.2 % and 0.1414 %
    assert scale.sigma / scale.mm_per_px == pytest.approx(np.hypot(0.002, np.sqrt(0.5) / 500))
    assert "500.0 px and 25 mm" in scale.source
    with pytest.raises(ValueError, match=r"at least 5 px apart, got 4 px"):
        scale_from_points((0, 0), (4, 0), 1.0)


def test_a_mean_is_weighted_and_better_than_each():
    mean = combined_scale([Scale(0.0600, 0.0006, "a"), Scale(0.0606, 0.0003, "b")])
    assert mean.mm_per_px == pytest.approx((0.0600 + 4 * 0.0606) / 5)
    assert mean.sigma == pytest.approx(0.0003 * np.sqrt(4 / 5))
    assert mean.source == "a; b"
    assert combined_scale([mean]).mm_per_px == pytest.approx(mean.mm_per_px)


def test_scales_that_disagree_are_refused():
    with pytest.raises(DataError, match=r"0\.06 .*\(a\) and 0\.07 .*\(b\): 7\.1 standard deviations"):
        combined_scale([Scale(0.06, 0.001, "a"), Scale(0.07, 0.001, "b")])
    with pytest.raises(ValueError, match="a step of a stage"):
        combined_scale([])


def test_lengths_along_both_axes_show_pixels_that_are_not_square():
    """A block of 7 x 5 mm at 11.7 and 10.8 px/mm, and its diagonal."""
    x = scale_from_points((10, 20), (10 + 7 * 11.7, 20), 7.0)
    y = scale_from_points((10, 20), (10, 20 + 5 * 10.8), 5.0)
    diagonal = scale_from_points((10, 20), (10 + 7 * 11.7, 20 + 5 * 10.8), np.hypot(7, 5))
    for scales in ((x, y), (y, diagonal, x)):
        with pytest.raises(DataError, match=r"not square: mm_per_px = \[0\.08547, 0\.092593\] fits"):
            combined_scale(scales)
    wrong = scale_from_points((10, 20), (10 + 7 * 11.7, 20 + 5 * 10.8), 7.0)
    longer = scale_from_points((10, 20), (10 + 7 * 11.7, 20), 8.0)
    for scales in ((x, y, wrong), (x, longer), (x, y, Scale(0.2, 0.001, "a grid"))):
        with pytest.raises(DataError, match="Leave the wrong one out"):
            combined_scale(scales)


def test_a_profile_has_its_doubt():
    scale = scale_from_profile("gelsight-mini")
    assert (scale.mm_per_px, scale.sigma) == (0.0634, 0.0009)
    assert "0.0625" in scale.source
    with pytest.raises(SensorError):
        scale_from_profile("mini")


@pytest.mark.slow
def test_depth_is_off_by_the_square_of_a_wrong_scale(presses, simulated):
    """The slopes of the balls and the steps between pixels are both off by its factor."""
    few, deepest = presses.subset(range(0, 14, 2)), []
    for wrong in (1.0, 1.04):
        scaled = with_scale(few, Scale(wrong * simulated.sensor.mm_per_px, 1e-4, "stated"))
        reconstruct = Reconstructor(calibrate(scaled, color_model="polynomial"))
        deepest.append(reconstruct(simulated.presses[0].image).depth_mm.max())
    assert deepest[1] / deepest[0] == pytest.approx(1.04**2, abs=0.01)


SENSORS = {"three-edges": LAYOUTS["three-edges"], "gelsight-mini": gelsight_mini()}


@pytest.fixture(scope="module", params=SENSORS)
def sensor_scale_images(request):
    return SENSORS[request.param]


@pytest.fixture(scope="module")
def rest(sensor_scale_images):
    return simulate_background(sensor_scale_images, np.random.default_rng(0))


def pressed(sensor, indenter, seed=1, **how):
    return simulate_press(sensor, indenter, rng=np.random.default_rng(seed), oversample=1, **how).image


STEP_MM = (3.5, 1.2)


@pytest.mark.parametrize(("indenter", "depth"), [(Ball(3.0), 0.5), (Coin(4.0, 0.15), 0.2), (Punch(3.0), 0.3)])
def test_a_step_tells_the_scale(sensor_scale_images, rest, indenter, depth):
    first = pressed(sensor_scale_images, indenter, 8, depth_mm=depth, center_mm=(-2.0, -0.5))
    second = pressed(
        sensor_scale_images, indenter, 11, depth_mm=depth, center_mm=np.add((-2.0, -0.5), STEP_MM)
    )
    scale = scale_from_stage(first, second, rest, float(np.hypot(*STEP_MM)))
    assert abs(scale.mm_per_px / sensor_scale_images.mm_per_px - 1) < 0.006
    assert abs(scale.mm_per_px - sensor_scale_images.mm_per_px) < 3 * scale.sigma
    dx, dy = (float(text) for text in scale.source.split("(")[1].split(")")[0].split(","))
    assert (dx, dy) == pytest.approx(np.array(STEP_MM) / sensor_scale_images.mm_per_px, abs=0.4)


def test_no_step_and_no_one_thing_are_refused(sensor_scale_images, rest):
    first = pressed(sensor_scale_images, Ball(3.0), 8, depth_mm=0.5, center_mm=(-2.0, -0.5))
    with pytest.raises(DataError, match="long against its uncertainty"):
        scale_from_stage(first, first, rest, 1.0)
    with pytest.raises(DataError, match="no shift aligns"):
        scale_from_stage(first, rest, rest, 1.0)


SHAPE = (240, 320)
MM_PER_PX = 0.0634
LENS = Lens((320.0, 320.0, 163.0, 117.0), (-0.25, 0.08))
PATTERN = (11, 8)
PITCH = 1.2


def grid_height(x_mm, y_mm, kind):
    """Brightness of the grid on the gel, 0 or 1, at points in mm from its middle; soft only by averaging."""
    columns, rows = PATTERN
    u, v = x_mm / PITCH + (columns - 1) / 2, y_mm / PITCH + (rows - 1) / 2
    if kind == "dots":
        on = (np.abs(u - np.rint(u)) ** 2 + np.abs(v - np.rint(v)) ** 2 < 0.27**2) & (np.rint(u) >= 0)
        on &= (np.rint(u) < columns) & (np.rint(v) >= 0) & (np.rint(v) < rows)
        return 1.0 - on
    squares = (np.floor(u) + np.floor(v)) % 2
    there = (u > -1) & (u < columns) & (v > -1) & (v < rows)
    return np.where(there, squares, 1.0)


def seen_through(lens, homography, kind, oversample=3, seed=0):
    """A frame (H, W, 3) of the grid: homography takes mm to undistorted px."""
    n = oversample
    y, x = (np.mgrid[: SHAPE[0] * n, : SHAPE[1] * n] + 0.5) / n - 0.5
    flat = lens.rectified_px_from_frame_px(np.stack([x.ravel(), y.ravel()], axis=1))
    mm = cv2.perspectiveTransform(flat[None], np.linalg.inv(homography))[0]
    bright = grid_height(mm[:, 0], mm[:, 1], kind).reshape(x.shape)
    small = bright.reshape(SHAPE[0], n, SHAPE[1], n).mean(axis=(1, 3))
    small = cv2.GaussianBlur(small, (0, 0), 0.7)
    levels = 50 + 130 * small[..., None] * [1, 0.9, 0.8]
    noise = np.random.default_rng(seed).normal(0, 1.5, levels.shape)
    return np.clip(np.rint(levels + noise), 0, 255).astype(np.uint8)


def pose(turn_deg=4.0, tilt=(4e-4, -3e-4), shift=(158.0, 121.0)):
    """mm on the gel -> undistorted px."""
    c, s = np.cos(np.deg2rad(turn_deg)) / MM_PER_PX, np.sin(np.deg2rad(turn_deg)) / MM_PER_PX
    flat = np.array([[c, -s, shift[0]], [s, c, shift[1]], [0, 0, 1.0]])
    return flat + np.outer([*shift, 1], [*np.divide(tilt, MM_PER_PX), 0])


@pytest.mark.linear_algebra
@pytest.mark.parametrize("kind", ["checkerboard", pytest.param("dots", marks=pytest.mark.slow)])
@pytest.mark.parametrize("tilt", [pytest.param((0.0, 0.0), marks=pytest.mark.slow), (4e-4, -3e-4)])
def test_a_known_lens_is_undone(kind, tilt):
    """Points all over the gel come out where a camera without faults would show them, to 0.1 px (dots: 0.2)."""
    homography = pose(tilt=tilt)
    found = view_from_grid([seen_through(LENS, homography, kind)], pattern=PATTERN, pitch_mm=PITCH, kind=kind)
    assert found.residual_px < 0.1
    assert found.residual_mm == pytest.approx(found.residual_px * found.scale.mm_per_px)
    y, x = np.mgrid[-3.5:3.6:0.7, -5.5:5.6:0.7]
    mm = np.stack([x.ravel(), y.ravel()], axis=1)
    frame_px = LENS.frame_px_from_rectified_px(cv2.perspectiveTransform(mm[None], homography)[0])
    image_px = image_px_from_frame_px(frame_px, found.view)
    pitch = found.scale.mm_per_px
    turn, *_ = np.linalg.lstsq(np.column_stack([mm, np.ones(len(mm))]), image_px, rcond=None)
    # a similarity and nothing else: square pixels, no distortion left
    off = np.sqrt(np.sum((np.column_stack([mm, np.ones(len(mm))]) @ turn - image_px) ** 2, axis=1))
    assert np.sqrt(np.mean(off**2)) < (0.1 if kind == "checkerboard" else 0.2)
    size = turn[:2] * pitch
    np.testing.assert_allclose(size @ size.T, np.eye(2), atol=0.004)
    assert abs(np.sqrt(abs(np.linalg.det(turn[:2]))) * pitch - 1) < 3 * found.scale.sigma / pitch


@pytest.mark.linear_algebra
@pytest.mark.slow
def test_further_images_help_with_the_distortion():
    one = seen_through(LENS, pose(tilt=(0, 0)), "dots")
    more = seen_through(LENS, pose(-10, (1e-3, 0), (150, 115)), "dots", seed=1)
    found = view_from_grid([one, more], pattern=PATTERN, pitch_mm=PITCH, kind="dots")
    assert found.points == 2 * 88
    assert found.residual_px < 0.05
    assert found.view.lens.distortion[0] == pytest.approx(-0.25, abs=0.02)


@pytest.mark.linear_algebra
@pytest.mark.slow
def test_nothing_unseen_is_in_the_image():
    """A pincushion's rectified corners lie outside the frame: they are cropped, at the same scale."""
    lens = replace(LENS, distortion=(0.2, 0.0))
    found = view_from_grid([seen_through(lens, pose(), "checkerboard")], pattern=PATTERN, pitch_mm=PITCH)
    _, _, width, height = found.view.crop
    assert (width, height) == found.view.shape[::-1]
    assert width < 320
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]])
    from gelform.image.view import frame_px_from_image_px

    there = frame_px_from_image_px(corners, found.view)
    assert (there > -0.6).all()
    assert (there < [319.6, 239.6]).all()


class Pins:
    """The face of 7x5 round pins of 0.5 mm radius, 1.8 mm apart."""

    def face_mm(self, x_mm, y_mm):
        off = [
            np.abs(along - 1.8 * np.clip(np.rint(along / 1.8), -n, n)) for along, n in ((x_mm, 3), (y_mm, 2))
        ]
        square = 0.25 - off[0] ** 2 - off[1] ** 2
        return np.where(square > 0, np.sqrt(np.maximum(square, 0)) - 0.5, -np.inf)


@pytest.mark.linear_algebra
@pytest.mark.parametrize("layout", ["three-edges", "ring-120"])
def test_pins_that_are_pressed_in_are_dots_against_the_gel_at_rest(layout):
    sensor, rng = LAYOUTS[layout], np.random.default_rng(0)
    rest = simulate_background(sensor, rng)
    image = simulate_press(sensor, Pins(), depth_mm=0.1, rng=rng, spin_deg=4.0).image
    how = {"pitch_mm": 1.8, "kind": "dots", "background": rest}
    found = view_from_grid([image], pattern=(7, 5), **how)
    assert found.scale.mm_per_px == pytest.approx(sensor.mm_per_px, rel=0.005)
    with pytest.raises(DataError, match=r"dots of 9x7 points in grid image 1, found 35 of 63 dots"):
        view_from_grid([image], pattern=(9, 7), **how)
    with pytest.raises(ValueError, match="kind 'dots' with a background"):
        view_from_grid([image], pattern=(7, 5), pitch_mm=1.8, background=rest)


@pytest.mark.linear_algebra
def test_what_is_no_grid_is_refused():
    frame = seen_through(LENS, pose(), "checkerboard")
    with pytest.raises(DataError, match=r"5x4 points in grid image 1, found none"):
        view_from_grid([np.full_like(frame, 90)], pattern=(5, 4), pitch_mm=1.0)
    with pytest.raises(ValueError, match=r"all of one size"):
        view_from_grid([frame, frame[:200]], pattern=PATTERN, pitch_mm=PITCH)
    with pytest.raises(ValueError, match=r"3x3 points or more"):
        view_from_grid([frame], pattern=(2, 8), pitch_mm=PITCH)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
    waved = x + 1.5 * np.sin(y / 20).astype(np.float32)  # no plane looks so
    bent = cv2.remap(frame, waved, y, cv2.INTER_LINEAR)
    with pytest.raises(DataError, match=r"px off one \(limit 0.5\)"):
        view_from_grid([bent], pattern=PATTERN, pitch_mm=PITCH)


@pytest.mark.linear_algebra
@pytest.mark.slow
def test_direction_and_middle_stay_and_the_rectified_image_shows_a_straight_grid():
    """The image is not turned to the grid: what was right stays right, at about the same size."""
    frame = seen_through(LENS, pose(15.0), "checkerboard")
    found = view_from_grid([frame], pattern=PATTERN, pitch_mm=PITCH)
    middle = np.array([[159.5, 119.5], [179.5, 119.5], [159.5, 139.5]])
    at = image_px_from_frame_px(middle, found.view)
    np.testing.assert_allclose(at[1] - at[0], [20, 0], atol=0.6)
    np.testing.assert_allclose(at[2] - at[0], [0, 20], atol=0.6)
    np.testing.assert_allclose(at[0], (np.array(found.view.shape[::-1]) - 1) / 2, atol=1.1)
    again = view_from_grid([image_from_frame(frame, found.view)], pattern=PATTERN, pitch_mm=PITCH)
    assert again.view.lens.distortion[0] == pytest.approx(0, abs=0.02)
    assert again.scale.mm_per_px == pytest.approx(found.scale.mm_per_px, rel=0.001)


MIXING = ((1.0, 0.15, 0.02), (0.1, 1.0, 0.2), (0.0, 0.12, 1.0))
PURE = replace(LAYOUTS["three-edges"], shape=(120, 160), mm_per_px=0.1268, ambient=(0, 0, 0))


BALANCE = np.array(PURE.white_balance)
SEEN = np.array(MIXING) * BALANCE[:, None] / BALANCE  # a gain behind the filters is part of what is seen


def pure_leds(sensor):
    """Each LED in its own channel alone."""
    strongest = [int(np.argmax(led.color)) for led in sensor.leds]
    leds = [
        replace(led, color=tuple(float(max(led.color)) if c == k else 0.0 for c in range(3)))
        for led, k in zip(sensor.leds, strongest)
    ]
    return replace(sensor, leds=tuple(leds)), strongest


def led_frames(sensor, rng=None, quantise=True):
    pure, strongest = pure_leds(sensor)
    frames = []
    for k in range(3):
        lit = tuple(led for led, color in zip(pure.leds, strongest) if color == k)
        frames.append(np.clip(simulate_background(replace(pure, leds=lit), rng, quantise=quantise), 0, 255))
    return frames


@pytest.mark.parametrize("gamma", [1.0, 2.2])
def test_the_matrix_comes_back(gamma):
    sensor = replace(PURE, crosstalk=MIXING, optics=Optics(response_gamma=gamma))
    found = crosstalk_from_frames(led_frames(sensor, quantise=False), response=1 / gamma)
    np.testing.assert_allclose(found.matrix, SEEN, atol=1e-4)
    assert np.max(found.spread) < 1e-4
    noisy = crosstalk_from_frames(led_frames(sensor, np.random.default_rng(0)), response=1 / gamma)
    np.testing.assert_allclose(noisy.matrix, SEEN, atol=0.01)
    assert "17." in noisy.describe()
    assert "blue light in the green channel" in noisy.describe()


def test_undone_changes_are_those_without_crosstalk():
    clean = replace(pure_leds(PURE)[0], crosstalk=IDENTITY)
    mixed = replace(clean, crosstalk=MIXING)
    how = {"rng": None, "quantise": False, "oversample": 1, "depth_mm": 0.6}
    rests = [np.clip(simulate_background(one, None, quantise=False), 0, 255) for one in (clean, mixed)]
    images = [np.clip(simulate_press(one, Ball(3.0), **how).image, 0, 255) for one in (clean, mixed)]
    assert np.max(images) < 255, "unsaturated"
    matrix = crosstalk_from_frames(led_frames(mixed, quantise=False)).matrix
    wanted = color_change_from_image(images[0], rests[0], ChangeSettings())
    as_it_is = color_change_from_image(images[1], rests[1], ChangeSettings())
    undone = color_change_from_image(images[1], rests[1], ChangeSettings(crosstalk=matrix))
    assert np.abs(as_it_is - wanted).max() > 0.05
    np.testing.assert_allclose(undone, wanted, atol=1e-3)


def test_ambient_light_is_taken_off_with_a_dark_frame():
    sensor = replace(PURE, crosstalk=MIXING, ambient=(0.0002, 0.0002, 0.0002))
    faint = (replace(PURE.leds[0], color=(1e-12, 1e-12, 1e-12)),)
    dark = np.clip(simulate_background(replace(sensor, leds=faint), None, quantise=False), 0, 255)
    found = crosstalk_from_frames(led_frames(sensor, quantise=False), dark=dark)
    np.testing.assert_allclose(found.matrix, SEEN, atol=1e-3)


def test_position_dependence_is_reported():
    frames = [frame.astype(np.float32) for frame in led_frames(replace(PURE, crosstalk=MIXING))]
    frames[0][..., 1] += np.linspace(0, 0.2, 160)[None] * frames[0][..., 0]
    found = crosstalk_from_frames(np.clip(frames, 0, 255))
    assert found.spread[1][0] > 0.03
    assert found.spread[2][0] < 0.02


def test_wrong_frames_are_refused():
    frames = led_frames(replace(PURE, crosstalk=MIXING))
    with pytest.raises(
        DataError, match=r"red LED's frame brightest in red, got red .*order red, green, blue"
    ):
        crosstalk_from_frames([frames[1], frames[0], frames[2]])
    with pytest.raises(DataError, match="levels of 20-250"):
        crosstalk_from_frames([frames[0] // 20, frames[1], frames[2]])
    with pytest.raises(ValueError, match="three frames"):
        crosstalk_from_frames(frames[:2])


MATRIX = [[1, 0.2, 0.05], [0.1, 1, 0.3], [0, 0.2, 1]]


def test_nothing_is_measured_by_default():
    geometry = Geometry()
    assert geometry.matrix is None
    assert geometry.settings() == {}
    scale, crosstalk = geometry.notes(1.0, None)
    assert "the number given. Its standard deviation is not known" in scale
    assert "The color model absorbs the crosstalk" in crosstalk


def test_the_table_of_a_sensor_toml_and_what_a_report_says_of_it():
    table = {"scale": "a punch of 5 mm", "lens": "96 points", "crosstalk": MATRIX}
    geometry = Geometry.from_settings(table)
    np.testing.assert_array_equal(geometry.matrix, MATRIX)
    assert geometry.crosstalk == Crosstalk(geometry.matrix, ((0.0,) * 3,) * 3)
    assert geometry.settings() == {
        "scale_source": "a punch of 5 mm",
        "lens": "96 points",
        "crosstalk": geometry.crosstalk.describe(),
    }
    notes = Geometry.from_settings({**table, "crosstalk_spread": MATRIX}).notes(0.45, 0.0004)
    assert notes[0].startswith("The scale comes from a punch of 5 mm. Its standard deviation is 0.0004 mm/px")
    assert "30.0 % (blue light in the green channel)" in notes[1]
    assert "exponent 0.45" in notes[2]
    assert notes[3] == "gelform corrects the lens: 96 points."
