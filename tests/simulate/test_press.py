"""Presses, sets and sequences of them, presets, twins; what cannot be simulated is refused with the reason."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from gelform.image.background import color_change_from_image
from gelform.sensors.profiles import SENSORS
from gelform.simulate import (
    LAYOUTS,
    Ball,
    Coating,
    Coin,
    Cone,
    Cylinder,
    Gel,
    HeightMap,
    Led,
    Mesh,
    Optics,
    Placed,
    Pose,
    Posed,
    Several,
    SimulatedSensor,
    Timing,
    led_color,
    press_poses,
    simulate_background,
    simulate_ball_presses,
    simulate_press,
    simulate_sequence,
    slide_poses,
    text_relief,
)
from gelform.simulate.press import STEEPEST_RENDERED, CalibratedLook, Twin, largest_ball_mm
from made.sources import DRAGGED, PLAIN, SMALL, box


def test_truth_lies_on_pixel_centers_whatever_the_oversample():
    one, three = (
        simulate_press(SMALL, Ball(3), depth_mm=0.8, center_mm=(1.1, -2.3), rng=None, oversample=n)
        for n in (1, 3)
    )
    np.testing.assert_allclose(one.depth_mm, three.depth_mm, atol=1e-13)
    np.testing.assert_allclose(one.gradients, three.gradients, atol=1e-13)
    row, column = np.unravel_index(np.argmax(one.depth_mm), one.depth_mm.shape)
    assert abs(column - one.center_px[0]) <= 0.5
    assert abs(row - one.center_px[1]) <= 0.5
    x = SMALL.grid_mm()[0][0, column]
    assert abs(x - 1.1) <= 0.15


def test_one_press_of_a_set_does_not_depend_on_how_many_follow():
    few = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=2, rng=np.random.default_rng(5))
    again = simulate_ball_presses(SMALL, ball_diameters_mm=[4, 6], count=3, rng=np.random.default_rng(5))
    for a, b in zip(few.presses, again.presses):
        np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(few.background, again.background)


def test_ball_presses_are_spread_and_some_are_cut_by_the_border():
    done = []
    simulated = simulate_ball_presses(
        SMALL, ball_diameters_mm=[6.31, 9.5], count=30, rng=np.random.default_rng(0), oversample=1,
        progress=lambda k, n, what: done.append((k, n)),
    )  # fmt: skip
    assert done[0] == (1, 30)
    assert done[-1] == (30, 30)
    centers = np.array([press.center_px for press in simulated.presses])
    counts, *_ = np.histogram2d(*centers.T, bins=3, range=[[0, 64], [0, 48]])
    assert counts.min() >= 2
    radius = np.array([press.contact_radius_px for press in simulated.presses])
    cut = (centers.min(axis=1) < radius) | ((63, 47) - centers < radius[:, None]).any(axis=1)
    assert 5 < cut.sum() < 28
    rims = [np.hypot(*np.moveaxis(p.gradients[p.contact], -1, 0)).max() for p in simulated.presses]
    assert 0.5 < np.median(rims) < 0.95
    assert {press.ball_diameter_mm for press in simulated.presses} == {6.31, 9.5}


def test_markers_are_drawn_where_the_truth_says():
    press = list(simulate_sequence(DRAGGED, Ball(3), slide_poses(0.5, (-1, 0), (1, 0), 10), rng=None))[-1]
    assert np.abs(press.markers_shift_mm).max() > 0.1
    y, x = np.mgrid[:60, :80]
    whole = [(mx, my) for mx, my in press.markers_px if 4 < mx < 75 and 4 < my < 55]
    assert len(whole) > 20
    for mx, my in whole:
        dark = (1 - press.albedo) * (np.hypot(x - mx, y - my) < 3.5)
        found = (dark * x).sum() / dark.sum(), (dark * y).sum() / dark.sum()
        assert found == pytest.approx((mx, my), abs=0.1)


def test_a_sequence_takes_the_poses_and_the_clock():
    presses = list(simulate_sequence(DRAGGED, Ball(3), press_poses(0.4, 3), rng=None, start_s=2.0))
    assert [press.press_depth_mm for press in presses] == pytest.approx([0, 0.2, 0.4])
    assert not presses[0].contact.any()
    assert [press.time_s for press in presses] == pytest.approx([2.0, 2.04, 2.08])


def test_frames_are_dropped_as_often_as_said():
    sensor = replace(DRAGGED, coating=Coating(), timing=Timing(drop_probability=0.3))
    poses = [Pose(0.0)] * 200
    presses = list(simulate_sequence(sensor, Ball(3), poses, rng=np.random.default_rng(0)))
    assert 40 < sum(press is None for press in presses) < 80


def test_balls_that_the_gel_cannot_take_are_refused_with_the_range():
    sensor = LAYOUTS["three-edges"]

    def pressed(*diameters):
        rng = np.random.default_rng(0)
        return simulate_ball_presses(sensor, ball_diameters_mm=diameters, count=2, rng=rng)

    largest = largest_ball_mm(sensor)
    assert len(pressed(largest).presses) == len(pressed(0.26).presses) == 2
    for diameter in (1.001 * largest, 0.25, 300):
        with pytest.raises(ValueError, match=r"from 0\.254 to 18\.5 mm, got"):
            pressed(6, diameter)


REAL = {"gelsight-mini": "mini-ball", "digit": "digit-ball"}


@pytest.mark.parametrize("name", [*LAYOUTS, *SENSORS])
def test_every_sensor_makes_a_picture_that_can_be_used(name):
    sensor = LAYOUTS[name] if name in LAYOUTS else SENSORS[name].simulated()
    background = simulate_background(sensor, None)
    press = simulate_press(sensor, Ball(3), depth_mm=0.6, rng=None, oversample=1)
    change = np.abs(press.image.astype(float) - background)
    assert 50 < background.mean() < 150
    assert np.mean(background == 255) < 0.01
    assert np.quantile(change[press.contact].max(axis=-1), 0.5) > 15
    assert change[:8, :8].mean() < 3


def test_every_layout_is_exposed_as_it_says():
    said = {"three-edges": (78, 95, 105), "ring-120": (110, 110, 110), "homemade": (85, 80, 75)}
    for name, sensor in LAYOUTS.items():
        background = simulate_background(sensor, None, quantise=False)
        np.testing.assert_allclose(background.mean(axis=(0, 1)), said[name], rtol=1e-4)


@pytest.mark.parametrize("name", REAL)
def test_untouched_presets_look_like_the_real_sensor(name, data):
    real = cv2.imread(str(data / REAL[name] / "background.png"))[..., ::-1].astype(np.float64)
    made = simulate_background(SENSORS[name].simulated(), None, quantise=False)
    assert made.shape == real.shape
    np.testing.assert_allclose(made.mean((0, 1)), real.mean((0, 1)), atol=2)
    np.testing.assert_allclose(made.std((0, 1)), real.std((0, 1)), rtol=0.1)
    smooth = cv2.GaussianBlur(real, (0, 0), 2) - cv2.GaussianBlur(made, (0, 0), 2)
    assert np.sqrt(np.mean(smooth**2)) < 7


def test_an_untouched_twin_is_the_background(calibration):
    twin = Twin(calibration, gel=Gel(2.0), relaxation_mm=0.7)
    assert (twin.sensor.gel, twin.sensor.relaxation_mm) == (Gel(2.0), 0.7)
    image = twin.press(Ball(3), Pose(0.0), rng=None).image
    assert np.abs(image - calibration.background).max() <= 0.5 + 1e-4


def test_the_color_is_the_calibrations_forward_response(calibration):
    press = Twin(calibration).press(Ball(3), Pose(0.5), rng=None)
    y, x = (axis.ravel() for axis in np.mgrid[: press.depth_mm.shape[0], : press.depth_mm.shape[1]])
    expected = calibration.forward.color_from_gradients(
        press.gradients.reshape(-1, 2), x, y, depth_px=press.depth_mm.ravel() / calibration.mm_per_px
    ).reshape(*press.gradients.shape[:2], 3)
    sharp = replace(calibration.change, blur_px=0.0)
    seen = color_change_from_image(press.image, calibration.background, sharp)
    level = 0.51 / (calibration.background + calibration.change.offset)
    assert np.all(np.abs(seen - expected)[~press.saturated] <= level[~press.saturated] + 1e-5)
    assert np.abs(seen).max() > 0.1


def test_steep_slopes_are_rendered_as_the_steepest_known(calibration):
    look = CalibratedLook(calibration)
    depth = np.full(calibration.image_shape, 0.3)
    steep, limit = np.zeros((2, *calibration.image_shape, 2))
    steep[..., 0], limit[..., 0] = 3.0, STEEPEST_RENDERED
    np.testing.assert_allclose(look.color_change(steep, depth), look.color_change(limit, depth), atol=1e-6)
    limit[..., 0] = 0.8
    assert np.abs(look.color_change(steep, depth) - look.color_change(limit, depth)).max() > 0.02


def test_the_noise_is_that_of_the_images(calibration):
    uneven = replace(calibration, settings={"image_noise": [1.0, 2.0, 4.0]})
    for known in (calibration, uneven):
        look = CalibratedLook(known)
        np.testing.assert_array_equal(look.noise, known.settings["image_noise"])
        noisy = Twin(look).press(Ball(3), Pose(0.0), rng=np.random.default_rng(0)).image.astype(float)
        apart = (noisy - calibration.background).std(axis=(0, 1))
        np.testing.assert_allclose(apart, np.sqrt(look.noise**2 + 1 / 12), rtol=0.1)
    unknown = {k: v for k, v in calibration.settings.items() if k != "image_noise"}
    plain = CalibratedLook(replace(calibration, settings=unknown))
    np.testing.assert_array_equal(plain.noise, calibration.background_noise)


def test_the_same_seed_gives_the_same_presses_with_noise(calibration):
    twin = Twin(calibration)
    one, two, other = (
        twin.ball_presses(ball_diameters_mm=[6.0], count=2, rng=np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(one.presses[1].image, two.presses[1].image)
    assert np.any(one.presses[1].image != other.presses[1].image)


def test_what_is_no_look_is_refused(calibration):
    with pytest.raises(ValueError, match="square pixels"):
        Twin(replace(calibration, mm_per_px=(0.06, 0.07)))
    with pytest.raises(TypeError, match=r"Expected a Calibration or a look .* got str.*load_calibration"):
        Twin("mini.npz")


BAD_GELS = [{"thickness_mm": 0}, {"bulge": 1.0}, {"bulge": -0.1}, {"friction": -1}]
REFUSED = [
    *((lambda bad=bad: Gel(**bad), next(iter(bad))) for bad in BAD_GELS),
    (lambda: Coating(specular=-1), "specular"),
    (lambda: Coating(shininess=10), "power of two"),
    (lambda: Coating(scattering=1.0), "scattering"),
    (lambda: Coating(marker_pitch_mm=0.3), "marker_pitch_mm"),
    (lambda: Coating(albedo=np.full((3, 3), 2.0)), "albedo"),
    (lambda: Led((0, 0, 2), (1, 1, 1), beam_power=-1), "beam_power"),
    (lambda: Led((0, 0, 2), (1, 1, 1), aim_mm=(0, 0, 2)), "aim_mm"),
    (lambda: led_color(900), "peak_nm"),
    (lambda: Led((0, 0, -2), (1, 1, 1)), "z > 0 mm"),
    (lambda: Led((0, 0, 2), (0, 0, 0)), "color"),
    (lambda: Timing(readout_s=1.0), "readout_s"),
    (lambda: Timing(drop_probability=1.0), "drop_probability"),
    (lambda: Timing(frame_rate_hz=0), "frame_rate_hz"),
    (lambda: Optics(height_mm=0.1), "height_mm"),
    (lambda: Optics(distortion=(-0.6, 0)), "fold"),
    (lambda: Optics(jpeg_quality=0), "jpeg_quality"),
    (lambda: Optics(response_gamma=0), "response_gamma"),
    (lambda: Optics(exposure=0), "exposure > 0"),
    (lambda: Optics(distortion=(0.1, 0, 0)), "distortion (k1, k2) as 2 finite numbers"),
    (lambda: Led((0, np.nan, 2), (1, 1, 1)), "position_mm as 3 finite numbers"),
    (lambda: replace(PLAIN, leds=(Led((1, 0, 1), (1, 1, 1)),)), "outside the gel"),
    (lambda: replace(PLAIN, shading=((1, 2),)), "shading"),
    (lambda: SimulatedSensor(()), "at least one LED"),
    (lambda: replace(SMALL, noise_sd=-1), "noise_sd >= 0"),
    (lambda: replace(SMALL, noise_gain=-0.1), "noise_gain >= 0"),
    (lambda: replace(SMALL, vignetting=1.0), "vignetting"),
    (lambda: replace(SMALL, crosstalk=((1, 0), (0, 1))), "crosstalk"),
    (lambda: replace(SMALL, mm_per_px=0.0), "mm_per_px"),
    (lambda: replace(SMALL, shape=(0, 3)), "shape"),
    (lambda: Ball(6000), "another unit"),
    (lambda: Ball(0), "radius_mm > 0"),
    (lambda: HeightMap(np.full((4, 4), np.nan), 0.1), "finite height_mm"),
    (lambda: HeightMap(np.zeros(4), 0.1), "height_mm"),
    (lambda: Cone(4, 180), "angle_deg in 0-180"),
    (lambda: Cylinder(6000, 1), "another unit"),
    (lambda: text_relief("  ", height_mm=2), "printable ASCII"),
    (lambda: text_relief("gél", height_mm=2), "printable ASCII"),
    (lambda: Mesh(box(1, 1, 1)[0], box(1, 1, 1)[1][:-1]), "3 edges that border only one triangle"),
    (lambda: Mesh(np.zeros((4, 3)), np.zeros((0, 3), dtype=int)), "an empty one"),
    (lambda: Mesh(box(1, 1, 1)[0] * 100000.0, box(1, 1, 1)[1]), "another unit"),
    (lambda: Mesh(box(1, 1, 1)[0] * 0.001, box(1, 1, 1)[1]), "meters x 1000"),
    (lambda: Mesh(box(1, 1, 1)[0], box(1, 1, 1)[1] + 5), "indices in 0-7"),
    (lambda: Mesh(box(1, 1, 1)[0] * np.nan, box(1, 1, 1)[1]), "finite vertices_mm"),
    (lambda: Pose(np.nan), "finite numbers"),
    (lambda: Pose(0.3, tilt_deg=(0, 90)), "tilt_deg within"),
    (lambda: Posed(Coin(), tilt_deg=(80, 0)), "within +-75"),
    (lambda: Several(()), "at least one part"),
    (lambda: Several((Placed(Ball(1), back_mm=-1),)), "back_mm >= 0"),
    (lambda: simulate_background(SMALL, None, frames=0), "frames"),
    (lambda: simulate_press(replace(PLAIN, gel=Gel(1)), Ball(3), depth_mm=1.2, rng=None), "gel's thickness"),
    (lambda: simulate_press(SMALL, Ball(3), depth_mm=-1, rng=None), "depth_mm > 0"),
    (lambda: simulate_press(SMALL, Ball(3), depth_mm=1, rng=None, oversample=2), "odd"),
    (
        lambda: simulate_press(SMALL, Ball(3), depth_mm=1, center_mm=(99, 0), rng=None),
        "touches the gel within",
    ),
    (lambda: simulate_ball_presses(SMALL, ball_diameters_mm=[], count=3, rng=None), "a ball"),
    (lambda: press_poses(0.4, 0), "count >= 1"),
    (lambda: list(simulate_sequence(DRAGGED, Ball(3), [Pose(2.5)], rng=None)), "gel's thickness"),
]


def test_bad_settings_are_refused_with_the_reason():
    for make, message in REFUSED:
        with pytest.raises(ValueError, match=re.escape(message)):
            make()
