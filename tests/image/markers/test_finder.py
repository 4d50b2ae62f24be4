"""Dots are found where they are, on gels that have them, and nowhere else."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.image.markers.finder import MarkerFinder, is_grid, markers_from_image
from gelform.sensors.profiles import SENSORS
from gelform.simulate import Ball, simulate_background, simulate_press
from made.dots import grid


def marked(name="gelsight-mini", pitch_mm=2.0, radius_mm=0.3):
    sensor = SENSORS[name].simulated()
    coating = replace(sensor.coating, marker_pitch_mm=pitch_mm, marker_radius_mm=radius_mm)
    return replace(sensor, coating=coating)


def matched(found, true, shape, radius):
    """Recall and precision of dots wholly inside the image, within 2 px."""
    inside = np.all((true > radius + 1) & (true < np.array(shape[::-1]) - radius - 2), axis=1)
    distance = np.linalg.norm(found[:, None] - true[None], axis=-1)
    whole = np.all((found > radius + 1) & (found < np.array(shape[::-1]) - radius - 2), axis=1)
    return np.mean(distance.min(axis=0)[inside] < 2), np.mean(distance.min(axis=1)[whole] < 2)


@pytest.fixture(scope="module", params=["gelsight-mini", "digit", "gelslim"])
def presses(request):
    sensor = SENSORS["gelslim"].simulated() if request.param == "gelslim" else marked(request.param)
    rng = np.random.default_rng(1)
    places = [(1.0, 1.0), (-2.0, 2.5), (3.0, -1.5), (0.2, -3.1)]
    return (
        sensor,
        simulate_background(sensor, rng),
        [simulate_press(sensor, Ball(3), depth_mm=0.7, center_mm=at, rng=rng, oversample=1) for at in places],
    )


def test_dots_of_pressed_gels(presses):
    sensor, background, pressed = presses
    radius = sensor.coating.marker_radius_mm / sensor.mm_per_px
    finder = MarkerFinder(background)
    scores = [matched(finder(p.image).centers_px, p.markers_px, sensor.shape, radius) for p in pressed]
    recall, precision = np.mean(scores, axis=0)
    assert recall > 0.95
    assert precision > 0.95


def test_dots_inside_contacts_are_parted_from_shadows(presses):
    _, background, pressed = presses
    finder = MarkerFinder(background)
    missed, inside = 0, 0
    for press in pressed:
        distance = np.linalg.norm(press.markers_px - press.center_px, axis=1)
        true = press.markers_px[distance < press.contact_radius_px]
        true = true[np.all((true > 8) & (true < np.array(press.contact.shape[::-1]) - 9), axis=1)]
        found = finder(press.image).centers_px
        inside += len(true)
        missed += sum(np.linalg.norm(found - dot, axis=1).min() > 3 for dot in true)
    assert inside >= 8
    assert missed <= 0.1 * inside


def test_dots_of_untouched_gels(presses):
    sensor, background, pressed = presses
    found = markers_from_image(background)
    radius = sensor.coating.marker_radius_mm / sensor.mm_per_px
    at_rest = pressed[0].markers_px - pressed[0].markers_shift_mm / sensor.mm_per_px
    recall, precision = matched(found.centers_px, at_rest, sensor.shape, radius)
    assert min(recall, precision) > 0.98
    assert found.radius_px == pytest.approx(radius, rel=0.35)


def test_masks_cover_the_darkened_pixels(presses):
    _, background, pressed = presses
    finder = MarkerFinder(background)
    for press in pressed:
        dark = press.albedo < 0.5
        dark[:3] = dark[-3:] = dark[:, :3] = dark[:, -3:] = False
        for mask in (finder(press.image).mask, finder.mask(press.image)):
            assert np.mean(mask[dark]) > 0.95
            assert np.mean(mask) < 3.5 * np.mean(press.albedo < 0.5)
            assert mask.dtype == bool


@pytest.mark.parametrize("name", ["gelsight-mini", "digit", "first-build"])
def test_unmarked_gels_have_none(name):
    sensor, rng = SENSORS[name].simulated(), np.random.default_rng(2)
    background = simulate_background(sensor, rng)
    press = simulate_press(sensor, Ball(3), depth_mm=0.7, rng=rng, oversample=1)
    for image in (background, press.image):
        assert len(markers_from_image(image)) == 0
    found = markers_from_image(press.image, background)
    assert len(found) == 0
    assert found.radius_px == 0
    assert not found.mask.any()
    assert not MarkerFinder(background).mask(press.image).any()


def test_dust_is_no_grid():
    for seed in range(10):
        image = np.full((240, 320, 3), 120, np.uint8)
        for x, y in np.random.default_rng(seed).uniform(10, 230, (40, 2)):
            cv2.circle(image, (round(x), round(y)), 4, (20, 20, 20), -1)
        assert len(markers_from_image(image)) == 0


@pytest.mark.parametrize("shape", ["square", "hexagonal"])
@pytest.mark.parametrize("turn_deg", [0, 17])
def test_grids_turned_bent_and_with_gaps(shape, turn_deg):
    rng = np.random.default_rng(4)
    i, j = (axis.ravel() for axis in np.mgrid[-6:7, -6:7])
    points = np.stack(
        [i + (0.5 * j if shape == "hexagonal" else 0), j * (0.75**0.5 if shape == "hexagonal" else 1)], 1
    )
    angle = np.deg2rad(turn_deg)
    turned = 25 * points @ np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    bent = turned * (1 - 1e-6 * np.sum(turned**2, axis=1, keepdims=True)) + rng.normal(0, 1.5, turned.shape)
    assert is_grid(bent[rng.random(len(bent)) < 0.85])


def test_scattered_points_are_no_grid():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        assert not is_grid(rng.uniform(0, 300, (rng.integers(9, 80), 2)))
    for seed in range(6):  # and even where they keep their distance
        rng, spread = np.random.default_rng(seed), np.zeros((0, 2))
        for point in rng.uniform(0, 300, (3000, 2)):
            if len(spread) == 0 or np.linalg.norm(spread - point, axis=1).min() > 25:
                spread = np.concatenate([spread, point[None]])
        assert not is_grid(spread)
    line = np.stack([np.arange(8) * 20.0, np.zeros(8)], axis=1)
    assert not is_grid(line)


def test_bytes_and_floats_are_alike_and_shapes_are_checked():
    image = simulate_background(marked(), np.random.default_rng(0))
    by_bytes, by_floats = markers_from_image(image), markers_from_image(image.astype(np.float32))
    np.testing.assert_allclose(by_bytes.centers_px, by_floats.centers_px)
    with pytest.raises(ValueError, match="240"):
        markers_from_image(np.zeros((240, 320, 3), np.uint8), np.zeros((120, 160, 3), np.uint8))


def test_real_gels_without_markers_have_none(data):
    for name in ("mini-ball", "digit-ball", "gelsight-ball-deep", "mini-objects"):
        paths = [data / name / "background.png", *sorted((data / name).rglob("*.png"))[::12]]
        for path in paths:
            assert len(markers_from_image(gelform.read_image(path))) == 0, path


def test_real_gel_with_markers(data):
    frames = list(gelform.Video(data / "mini-markers-video" / "mini_example.avi").frames({0, 109, 170}))
    finder = MarkerFinder(frames[0].image)
    assert len(finder.untouched) == 80
    assert finder.untouched.radius_px == pytest.approx(5.9, abs=0.5)
    for frame in frames[1:]:
        assert 74 <= len(finder(frame.image)) <= 84


def test_irregular_layouts_are_markers():
    sensor = marked(pitch_mm=1.6, radius_mm=0.26)
    for seed, jitter in enumerate((0.4, 0.5, 0.5)):
        coating = replace(sensor.coating, marker_jitter=jitter, marker_missing=0.05, seed=seed)
        own = replace(sensor, coating=coating)
        found = markers_from_image(simulate_background(own, np.random.default_rng(seed)))
        true = (
            coating.markers_mm(own.shape, own.mm_per_px) / own.mm_per_px + (np.array(own.shape[::-1]) - 1) / 2
        )
        assert matched(found.centers_px, true, own.shape, 5)[0] > 0.97


def spots(shape, size, pitch):
    """A lit gel with dark rectangles of (height, width) px on a square grid, all of them whole."""
    image = np.full((*shape, 3), [110.0, 140.0, 125.0])
    for y in range(pitch, shape[0] - size[0] - 4, pitch):
        for x in range(pitch, shape[1] - size[1] - 4, pitch):
            image[y : y + size[0], x : x + size[1]] *= 0.4
    return image.astype(np.uint8)


@pytest.mark.parametrize(("size", "found"), [((5, 5), 18), ((4, 8), 18), ((14, 26), 0)])
def test_dots_are_small_and_compact_whichever_way_the_image_lies(size, found):
    """A dot may be twice as long as wide, but no larger than 0.15 of the image's shorter side."""
    image = spots((120, 210), size, 29)
    for turned in (image, image.transpose(1, 0, 2).copy()):
        assert len(markers_from_image(turned)) == found


REST = grid()
