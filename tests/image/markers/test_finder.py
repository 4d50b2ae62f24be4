"""Dots are found where they are and where they were moved to, on gels that have them, and nowhere else."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import gelform
from gelform.image.markers import MarkerFollower, finder
from gelform.image.markers.finder import (
    MarkerFinder,
    MarkerPatches,
    is_grid,
    level_from_image,
    logs_from_image,
    markers_from_image,
)
from gelform.sensors.profiles import SENSORS
from gelform.simulate import Ball, simulate_background, simulate_press
from kernel_agreement import assert_kernel_agrees
from made.images import RADIUS, grid, image_of_dots

REST = grid()


def prepared(rest=REST, radius=RADIUS, dots=None, **how):
    """Patches of the dots at `rest`; `dots`, where the image has others too."""
    image = image_of_dots(rest if dots is None else dots, **how)
    return MarkerPatches(logs_from_image(image), rest, radius)


def sampled(image, x, y, side):
    """Catmull-Rom interpolation on a square, from its definition; the nearest value beyond the border."""

    def weights(t):
        return np.array(
            [-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2]
        ) / 2  # fmt: skip

    rows, columns = (np.floor(v).astype(int) + np.arange(-1, side + 2) for v in (y, x))
    taken = image[np.clip(rows, 0, len(image) - 1)][:, np.clip(columns, 0, image.shape[1] - 1)].astype(float)
    down, across = (weights(v - np.floor(v)) for v in (y, x))
    return sum(
        down[i] * across[j] * taken[i : i + side, j : j + side] for i in range(4) for j in range(4)
    ).ravel()


def reference(image, corners, weight, basis, triangle, shift, fit, side, steps, longest):
    """The steps of the docstring's paper in double precision, one solve each."""
    shift, fit = shift.astype(float), fit.astype(float)
    for i, corner in enumerate(corners):
        for _ in range(steps):
            seen = weight[i] * sampled(image, *(corner + shift[i]), side)
            on = basis[i].astype(float) @ seen
            strength, dx, dy = np.linalg.solve(triangle[i].astype(float), on[6:])
            step = np.array([dx, dy]) / max(strength, 0.3)
            length = np.linalg.norm(step)
            shift[i] -= step * min(1, longest / length)
            fit[i] = strength, max(seen @ seen - on @ on, 0), on[6] ** 2, length
            if length < 0.004:
                break
    return shift, fit


@pytest.mark.linear_algebra
def test_the_kernel_is_the_written_method():
    own = prepared(noise=1.0)
    image = logs_from_image(image_of_dots(np.add(REST, [1.3, -0.6]), noise=1.0, seed=1))
    count = len(REST)
    assert_kernel_agrees(
        finder._follow_patches, reference, image, own.corners_px, own.weights, own._basis, own._triangle,
        np.zeros((count, 2), np.float32), np.zeros((count, 4), np.float32), own.side_px, 3, 1.0,
        tolerance=1e-3,
    )  # fmt: skip


# Two overlapping spots make a broken, lopsided dot; it moves as a round one does.
SPOTS = np.concatenate([REST, np.add(REST[::3], [2.5, 1.0])])
BROKEN = {"dots": SPOTS, "radii": np.where(np.arange(len(SPOTS)) < len(REST), RADIUS, 1.5)}
LARGE = {"rest": np.array([[64.0, 48.0]]), "radius": 25.0, "radii": 25.0}  # larger than the largest patch


@pytest.mark.linear_algebra
@pytest.mark.parametrize(
    ("shift", "light", "how", "tolerance_px"),
    [
        *(((x, y), 0, {}, 0.03) for x, y in ((0, 0), (0.37, -0.81), (2.4, 1.6), (-3.1, 2.2))),
        ((0, 0), 0.6, {}, 0.05),  # the light of a contact moves no dot
        ((1.2, -0.4), 0, BROKEN, 0.03),
        ((1.2, -0.4), 0, LARGE, 0.05),
    ],
)
def test_shifts_to_hundredths_of_a_pixel(shift, light, how, tolerance_px):
    own = prepared(**how)
    dots = np.add(how.get("dots", own.centers_px), shift)
    image = image_of_dots(dots, light=light, radii=how.get("radii", RADIUS))
    found = own(logs_from_image(image), np.zeros_like(own.centers_px))
    assert found.ok.all()
    assert np.abs(found.shift_px - shift).max() < tolerance_px


@pytest.mark.linear_algebra
@pytest.mark.parametrize(("shape", "side_px"), [((20, 30), 19), ((40, 30), 25)])
def test_a_patch_is_no_larger_than_the_image(shape, side_px):
    """Twice 1.35 radii, a pixel on each side, and the middle: 25 px."""
    logs = logs_from_image(image_of_dots([(15, 10)], radii=8.0, shape=shape))
    assert MarkerPatches(logs, np.array([[15.0, 10.0]]), 8.0).side_px == side_px


@pytest.mark.linear_algebra
def test_dots_that_are_gone_are_not_ok():
    image = logs_from_image(image_of_dots(np.delete(REST, [5, 20], axis=0), noise=1.0, seed=2))
    found = prepared(noise=1.0)(image, np.zeros_like(REST))
    np.testing.assert_array_equal(found.ok, ~np.isin(np.arange(len(REST)), [5, 20]))
    of = np.array([3, 5, 8])
    some = prepared(noise=1.0)(image, np.zeros((3, 2)), of)
    np.testing.assert_array_equal(some.ok, [True, False, True])
    np.testing.assert_array_equal(some.shift_px, found.shift_px[of])


@pytest.mark.linear_algebra
def test_a_dot_that_left_by_the_border_is_not_ok():
    rest = grid(margin=6.0)
    image = logs_from_image(image_of_dots(np.add(rest, [-5.0, 0.0])))
    found = prepared(rest)(image, np.full_like(rest, [-5.0, 0.0]))
    np.testing.assert_array_equal(found.ok, rest[:, 0] > 6)


@pytest.mark.linear_algebra
def test_logs_of_bytes_and_floats_agree():
    image = image_of_dots(REST)
    by_floats = logs_from_image(image.astype(np.float32))
    assert np.abs(logs_from_image(image) - by_floats).max() < 0.02
    for kind in (np.uint8, float):
        level = np.full((4, 5, 3), [10, 20, 60], dtype=kind)
        assert (level_from_image(level) == 30).all()
        np.testing.assert_allclose(logs_from_image(level), np.log(30 + 10), rtol=1e-5)


FEW_RADIUS = 5.5
FEW = grid(32.0, (160, 192), 16.0)
UNTOUCHED = image_of_dots(FEW, radii=FEW_RADIUS, shape=(160, 192), noise=1.0)
LOGS = logs_from_image(UNTOUCHED)
DOT, MOVED = 8, np.array([3.3, -1.6])


def image_of_stretched(warp, moved=MOVED, light=0.3):
    """All dots at rest but one, which a map (2, 2) about its center has stretched."""
    y, x = np.mgrid[:160, :192].astype(float)
    others = np.delete(FEW, DOT, 0)
    clean = image_of_dots(others, radii=FEW_RADIUS, shape=(160, 192), light=light).astype(float)
    away = np.stack([x, y], axis=-1) - (FEW[DOT] + moved)
    inside = np.hypot(*np.moveaxis(away @ np.linalg.inv(warp).T, -1, 0))
    clean *= (1 - 0.85 / (1 + np.exp((inside - FEW_RADIUS) / 0.4)))[..., None]
    noisy = clean + np.random.default_rng(1).normal(0, 1, clean.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def turned(longer, shorter, degrees):
    """A stretch along a direction."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    turn = np.array([[c, -s], [s, c]])
    return turn @ np.diag([longer, shorter]) @ turn.T


@pytest.mark.linear_algebra
@pytest.mark.parametrize(
    ("longer", "shorter", "degrees"), [(1.0, 1.0, 0), (1.6, 1.1, 0), (1.7, 0.9, 40), (0.9, 0.6, 110)]
)
def test_a_stretched_dot_is_found_where_it_is(longer, shorter, degrees):
    patches = MarkerPatches(LOGS, FEW, FEW_RADIUS)
    logs = logs_from_image(image_of_stretched(turned(longer, shorter, degrees)))
    found = patches.stretched(logs, MOVED[None] + [[1.5, -1.0]], np.array([DOT]))
    assert found.ok[0]
    assert np.abs(found.shift_px[0] - MOVED).max() < 0.1
    assert found.sigma_px[0] < 0.1


@pytest.mark.linear_algebra
def test_a_shift_alone_refuses_it_and_the_follower_does_not():
    image = image_of_stretched(turned(1.9, 1.3, 20))
    plain = MarkerPatches(LOGS, FEW, FEW_RADIUS)(logs_from_image(image), np.zeros((len(FEW), 2)))
    assert not plain.ok[DOT]
    follower = MarkerFollower(UNTOUCHED)
    flow = follower(image)
    at = np.linalg.norm(follower.rest_px - FEW[DOT], axis=1).argmin()
    assert flow.seen.all()
    assert np.abs(flow.displacement_px[at] - MOVED).max() < 0.25


@pytest.mark.linear_algebra
def test_no_dot_is_none():
    patches = MarkerPatches(LOGS, FEW, FEW_RADIUS)
    others = np.delete(FEW, DOT, 0)
    empty = logs_from_image(image_of_dots(others, radii=FEW_RADIUS, shape=(160, 192), noise=1.0))
    assert not patches.stretched(empty, np.zeros((1, 2)), np.array([DOT])).ok[0]
    none = patches.stretched(empty, np.zeros((0, 2)), np.zeros(0, np.intp))
    assert len(none.shift_px) == len(none.ok) == 0


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
    background = simulate_background(sensor, rng)
    one = {"depth_mm": 0.7, "rng": rng, "oversample": 1}
    return sensor, background, [simulate_press(sensor, Ball(3), center_mm=at, **one) for at in places]


def test_dots_of_pressed_gels(presses):
    sensor, background, pressed = presses
    radius = sensor.coating.marker_radius_mm / sensor.mm_per_px
    finder = MarkerFinder(background)
    scores = [matched(finder(p.image).centers_px, p.markers_px, sensor.shape, radius) for p in pressed]
    assert np.mean(scores, axis=0).min() > 0.95  # recall and precision


def test_dots_inside_contacts_are_parted_from_shadows(presses):
    _, background, pressed = presses
    finder = MarkerFinder(background)
    missed = inside = 0
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
    points = np.stack([i + 0.5 * j, j * 0.75**0.5] if shape == "hexagonal" else [i, j], axis=1)
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
        middle = (np.array(own.shape[::-1]) - 1) / 2
        true = coating.markers_mm(own.shape, own.mm_per_px) / own.mm_per_px + middle
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
