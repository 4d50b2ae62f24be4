"""Lambertian: the camera's exponent and the crosstalk come back, exact on its own law. Near lights: the simulator's
LEDs are found again; frames equal pixels; crosstalk and response come back.
"""

from dataclasses import replace

import numpy as np
import pytest

from gelform.image.background import ChangeSettings, PreparedBackground
from gelform.simulate import Ball, SimulatedSensor, simulate_background, simulate_press
from gelform.simulate.sensor import Led
from gelform.slopes.color_models import LambertianModel, NearLightModel, Samples, physical
from gelform.slopes.color_models.physical import (
    OFF_DIAGONAL,
    gradients_from_scaled,
    inverse_lights,
    light_ratio,
    light_ratio_derivatives,
    linear_change,
    toward_lights,
)
from kernel_agreement import assert_kernel_agrees
from made.images import LIGHTS, ball_samples, lambertian_change

pytestmark = pytest.mark.linear_algebra

SCALED = LIGHTS / LIGHTS[:, 2:]


def gamma_coded(exponent, mixture=None):
    """Samples of slopes up to 0.4 as a camera of that response and crosstalk sees them."""
    samples = ball_samples(lambda g, x, y: lambertian_change(g / 2, x, y))
    ratio = 1 + samples.color_change
    if mixture is not None:
        ratio = ratio @ mixture.T
    return replace(samples, color_change=ratio**exponent - 1, gradients=samples.gradients / 2)


@pytest.mark.parametrize(("exponent", "given"), [(0.45, None), (0.7, None), (1.0, None), (0.7, 0.7)])
def test_the_response_is_found_or_taken(exponent, given):
    model = LambertianModel.fit(gamma_coded(exponent), response=given)
    assert model.response == pytest.approx(exponent, abs=0 if given else 1e-3)
    np.testing.assert_allclose(model.lights, SCALED, atol=1e-5 if given else 1e-3)


def test_crosstalk_is_held_by_the_lights():
    mixture = np.array([[0.8, 0.15, 0.05], [0.1, 0.7, 0.2], [0.0, 0.2, 0.8]])
    samples = gamma_coded(0.7, mixture)
    model = LambertianModel.fit(samples)
    np.testing.assert_allclose(model.lights, mixture @ SCALED, atol=2e-3)
    found = model.gradients_at(samples.color_change, samples.x_px, samples.y_px)
    np.testing.assert_allclose(found, samples.gradients, atol=5e-3)


def test_linear_light_undoes_the_response():
    change = np.array([-0.5, 0.0, 0.5, -1.0])
    np.testing.assert_allclose(linear_change((1 + change) ** 0.45 - 1, 0.45), change, atol=1e-12)
    assert linear_change(change.astype(np.float32), 0.45).dtype == np.float32


def test_it_finds_its_lights_and_inverts_them():
    model = LambertianModel.fit(ball_samples(lambertian_change))
    np.testing.assert_allclose(model.lights, SCALED, atol=1e-5)
    unseen = ball_samples(lambertian_change, seed=3)
    lit = (unseen.color_change > -0.98).all(axis=1)
    found = model.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
    np.testing.assert_allclose(found[lit], unseen.gradients[lit], atol=1e-4)


def test_a_pixel_in_shadow_stays_finite():
    change = np.array([[-1.0, -1.0, 5.0], [-1.0, -1.0, -1.0]])
    gradients = LambertianModel(SCALED).gradients_at(change, np.zeros(2), np.zeros(2))
    assert np.isfinite(gradients).all()
    assert np.linalg.norm(gradients, axis=1).max() <= 5.0 + 1e-6


def test_what_tells_no_lights_is_refused():
    coplanar = np.array([[1.0, 0, 1], [0, 0, 1], [-1, 0, 1]])
    for make, said in (
        (lambda: inverse_lights(coplanar), "condition number .*coplanar"),
        (lambda: inverse_lights(coplanar + 1e-7 * np.eye(3)), "condition number .*coplanar"),
        (lambda: LambertianModel.fit(gamma_coded(0.7), response=-1), "response > 0"),
        (lambda: NearLightModel.fit(samples_of(count=10)), "at least 32"),
    ):
        with pytest.raises(ValueError, match=said):
            make()


def test_huber_weights_ignore_a_bad_press():
    good, rng = ball_samples(lambertian_change), np.random.default_rng(6)
    change = good.color_change.copy()
    change[rng.choice(len(change), 400, replace=False)] = rng.uniform(-0.5, 0.5, (400, 3))
    model = LambertianModel.fit(replace(good, color_change=change))
    np.testing.assert_allclose(model.lights, SCALED, atol=0.05)


@pytest.mark.parametrize("model", [LambertianModel, NearLightModel])
def test_its_color_change_is_the_ratio_of_light_however_dark_the_gel(model):
    """The law is of I/I0: levels added to either, as other models want them against noise, would bend it."""
    ratio = np.linspace(0.3, 1.9, 60).reshape(4, 5, 3).astype(np.float32)
    dark = np.full((4, 5, 3), 10.0, dtype=np.float32)
    settings = ChangeSettings(offset=model.change_offset, blur_px=0.0)
    np.testing.assert_allclose(PreparedBackground(dark, settings).change(dark * ratio), ratio - 1, atol=1e-5)


MM_PER_PX = 0.1
LEDS = np.array([[9.0, 1.0, 4.0], [-6.0, 7.5, 5.0], [-4.0, -8.0, 4.5]])
SHAPE_NEAR_LIGHT = (96, 128)
MIXTURE = np.array([[1.0, 0.15, 0.05], [0.1, 1.0, 0.2], [0.0, 0.12, 1.0]])


def samples_of(mixture=None, response=1.0, count=4000, seed=0, slope=0.4):
    """Color changes by the inverse square and cosine laws, written out light by light."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, SHAPE_NEAR_LIGHT[1] - 1, count), rng.uniform(0, SHAPE_NEAR_LIGHT[0] - 1, count)
    gradients = rng.uniform(-slope, slope, (count, 2))
    middle = (np.array(SHAPE_NEAR_LIGHT[::-1]) - 1) / 2
    place = np.stack([x - middle[0], y - middle[1], 0 * x], axis=1) * MM_PER_PX
    normals = np.concatenate([-gradients, np.ones((count, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    light, rest = [], []
    for led in LEDS:
        way = led - place
        distance = np.linalg.norm(way, axis=1)
        strength = np.linalg.norm(led) ** 2
        light.append(strength * np.maximum(np.sum(way * normals, axis=1), 0) / distance**3)
        rest.append(strength * way[:, 2] / distance**3)
    mix = np.eye(3) if mixture is None else mixture
    ratio = (np.array(light).T @ mix.T) / (np.array(rest).T @ mix.T)
    return Samples(ratio**response - 1, x, y, gradients, np.ones(count), SHAPE_NEAR_LIGHT)


@pytest.mark.parametrize(
    ("mixture", "response", "off_mm", "off"), [(np.eye(3), 1.0, 0.02, 1e-3), (MIXTURE, 0.6, 0.3, 0.01)]
)
def test_positions_in_mm_crosstalk_and_response_come_back(mixture, response, off_mm, off):
    model = NearLightModel.fit(samples_of(mixture, response))
    np.testing.assert_allclose(model.positions_mm(MM_PER_PX), LEDS, atol=off_mm)
    np.testing.assert_allclose(model.mixture, mixture, atol=3 * off)
    assert model.response == pytest.approx(response, abs=off)


def test_a_channel_may_see_another_light_more_than_its_own():
    mixture = np.array([[1.0, 0.1, 1.4], [0.0, 1.0, 0.1], [0.05, 0.1, 1.0]])
    model = NearLightModel.fit(samples_of(mixture), response=1.0)
    np.testing.assert_allclose(model.mixture, mixture, atol=0.05)


def test_gradients_of_unseen_pixels_are_exact_where_all_lights_shine():
    model = NearLightModel.fit(samples_of(MIXTURE))
    unseen = samples_of(MIXTURE, seed=1, slope=0.15)
    found = model.gradients_at(unseen.color_change, unseen.x_px, unseen.y_px)
    np.testing.assert_allclose(found, unseen.gradients, atol=5e-3)


def test_outliers_are_outvoted():
    samples = samples_of()
    spoilt = np.array(samples.color_change)
    spoilt[::10] = np.random.default_rng(2).uniform(-0.5, 0.5, spoilt[::10].shape)
    model = NearLightModel.fit(replace(samples, color_change=spoilt), response=1.0)
    np.testing.assert_allclose(model.positions_mm(MM_PER_PX), LEDS, atol=0.5)


def test_the_simulators_leds_are_found_within_a_tenth_of_a_millimeter():
    """Its depth, which the model leaves out, is 0.12 mm of the lights' 4-5 mm; the response is given."""
    leds = tuple(Led(tuple(position), tuple(6000.0 * np.eye(3)[k])) for k, position in enumerate(LEDS))
    sensor = SimulatedSensor(shape=SHAPE_NEAR_LIGHT, mm_per_px=MM_PER_PX, leds=leds)
    parts, untouched = [], simulate_background(sensor, None, quantise=False)
    for cx in (-4.0, 0.0, 4.0):
        for cy in (-2.8, 0.0, 2.8):
            how = {"depth_mm": 0.12, "center_mm": (cx, cy), "rng": None, "quantise": False}
            press = simulate_press(sensor, Ball(2.5), **how)
            rows, cols = np.nonzero(press.contact & ~press.shadowed)
            change = press.image[rows, cols] / untouched[rows, cols] - 1
            parts.append((change, cols, rows, press.gradients[rows, cols]))
    change, x, y, gradients = map(np.concatenate, zip(*parts))
    samples = Samples(change, x, y, gradients, np.ones(len(x)), SHAPE_NEAR_LIGHT)
    model = NearLightModel.fit(samples, response=1.0)
    np.testing.assert_allclose(model.positions_mm(MM_PER_PX), LEDS, atol=0.1)


def test_the_kernel_is_the_law_of_a_matrix_per_pixel():
    rng = np.random.default_rng(4)
    change = rng.uniform(-1, 0.5, (7, 29, 3)).astype(np.float32)
    inverse = (np.eye(3)[:, :, None, None] + 0.4 * rng.normal(size=(3, 3, 7, 29))).astype(np.float32)

    def reference(change, inverse, gradients, least_share):
        return gradients_from_scaled(change, np.moveaxis(inverse, (0, 1), (2, 3)).astype(np.float64))

    gradients = np.empty((7, 29, 2), np.float32)
    assert_kernel_agrees(
        physical._near_light_gradients, reference, change, inverse, gradients, 1 / physical.MAX_SLOPE
    )


POSITIONS = np.array([[1.4, 0.2, 0.6], [-0.9, 1.2, 0.8], [-0.6, -1.3, 0.7]])
LEAKS = np.array([[1.0, 0.15, 0.05], [0.1, 1.0, 0.2], [0.02, 0.12, 1.0]])


@pytest.fixture
def pixels():
    rng = np.random.default_rng(0)
    slopes = rng.uniform(-0.8, 0.8, (40, 2))
    slopes[0] = 9, 0  # two lights are behind it
    normals = np.concatenate([-slopes, np.ones((40, 1))], axis=1)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    return normals, rng.uniform(-1, 1, 40), rng.uniform(-0.75, 0.75, 40)


def test_a_point_light_falls_with_the_square_of_the_distance(pixels):
    _, x, y = pixels
    light = toward_lights(x, y, POSITIONS, 2.0).light
    way = POSITIONS - np.stack([x, y, 0 * x], axis=-1)[:, None]
    distance = np.linalg.norm(way, axis=-1)
    np.testing.assert_allclose(np.linalg.norm(light, axis=-1), np.sum(POSITIONS**2, axis=1) / distance**2)
    np.testing.assert_allclose(np.cross(light, way), 0, atol=1e-12)
    up = np.tile([0.0, 0.0, 1.0], (40, 1))  # of untouched gel
    np.testing.assert_allclose(light_ratio(up, x, y, POSITIONS, LEAKS, 2.0), 1)


@pytest.mark.parametrize("falloff", [0.0, 2.0])
def test_derivatives_are_those_of_finite_differences(pixels, falloff):
    ratio, by_position, by_mixture = light_ratio_derivatives(*pixels, POSITIONS, LEAKS, falloff)
    np.testing.assert_array_equal(ratio, light_ratio(*pixels, POSITIONS, LEAKS, falloff))
    assert ratio[0].min() < 0.3
    step = 1e-6
    for k in range(9):
        move = step * (np.arange(9) == k).reshape(3, 3)
        up, down = (light_ratio(*pixels, POSITIONS + s * move, LEAKS, falloff) for s in (1, -1))
        np.testing.assert_allclose(by_position[..., k], (up - down) / (2 * step), atol=1e-7)
    for k, (row, column) in enumerate(np.argwhere(OFF_DIAGONAL)):
        more, less = (LEAKS + s * step * (np.arange(9).reshape(3, 3) == 3 * row + column) for s in (1, -1))
        up, down = (light_ratio(*pixels, POSITIONS, mixture, falloff) for mixture in (more, less))
        np.testing.assert_allclose(by_mixture[..., k], (up - down) / (2 * step), atol=1e-7)
