"""Light on a surface against analytic light."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.normals import image_from_normals
from gelform.simulate import (
    Ball,
    Coating,
    Gel,
    Led,
    Pose,
    SimulatedSensor,
    simulate_background,
    simulate_pose,
    simulate_press,
)
from gelform.simulate.gel.gel import Surface
from gelform.simulate.light import irradiance
from gelform.simulate.light.irradiance import irradiance_from_surface
from kernel_agreement import assert_kernel_agrees
from made.sensors import PLAIN

WHITE = (1.0, 1.0, 1.0)


def sensor_with(*leds, **settings):
    return SimulatedSensor(leds, **{"shape": (40, 50), "mm_per_px": 0.1} | settings)


def plane(x, y, slope_x, slope_y):
    z = slope_x * x + slope_y * y
    gradients = np.empty((*z.shape, 2))
    gradients[...] = slope_x, slope_y
    return Surface(x, y, z, gradients, np.zeros(z.shape, dtype=bool))


@pytest.mark.parametrize(("slope_x", "slope_y"), [(0.0, 0.0), (0.3, -0.2), (-0.5, 0.4)])
def test_one_light_on_a_plane_is_lamberts_law(slope_x, slope_y):
    light, strength = np.array([4.0, -3.0, 6.0]), 100.0
    sensor = sensor_with(Led(tuple(light), (strength, 0, 0)))
    x, y = sensor.grid_mm()
    levels = irradiance_from_surface(plane(x, y, slope_x, slope_y), sensor.leds)
    z = slope_x * x + slope_y * y
    normal = np.array([-slope_x, -slope_y, 1]) / np.sqrt(1 + slope_x**2 + slope_y**2)
    to_light = light - np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    distance = np.linalg.norm(to_light, axis=-1)
    expected = strength * np.maximum(to_light @ normal, 0) / distance**3
    np.testing.assert_allclose(levels[..., 0], expected, rtol=1e-12)
    assert np.all(levels[..., 1:] == 0)


def test_one_light_on_a_ball_is_lamberts_law():
    light, strength, radius, depth = np.array([-5.0, 6.0, 7.0]), 100.0, 3.0, 0.6
    sensor = sensor_with(Led(tuple(light), (0, strength, 0)))
    press = simulate_press(
        sensor, Ball(radius), depth_mm=depth, center_mm=(0.3, -0.2), rng=None, oversample=1, quantise=False
    )
    x, y = np.broadcast_arrays(*sensor.grid_mm())
    from_center = np.stack([x - 0.3, y + 0.2, press.depth_mm - (depth - radius)], axis=-1)
    on_ball = press.contact
    normal = from_center[on_ball] / radius
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1), 1, rtol=1e-12)
    to_light = light - np.stack([x, y, press.depth_mm], axis=-1)[on_ball]
    distance = np.linalg.norm(to_light, axis=-1)
    expected = strength * np.maximum(np.sum(normal * to_light, axis=-1), 0) / distance**3
    assert on_ball.sum() > 100
    np.testing.assert_allclose(press.image[on_ball][:, 1], expected, rtol=1e-6, atol=1e-9)


def test_light_falls_with_the_square_of_the_distance():
    sensor = sensor_with(Led((0, 0, 1), WHITE), shape=(3, 3), mm_per_px=1e-6, gel=Gel(thickness_mm=0.5))
    near, far = (
        simulate_background(
            SimulatedSensor((Led((0, 0, d), WHITE),), shape=(3, 3), mm_per_px=1e-6), None, quantise=False
        )
        for d in (5.0, 15.0)
    )
    np.testing.assert_allclose(near / far, 9, rtol=1e-9)
    np.testing.assert_allclose(simulate_background(sensor, None, quantise=False), 1, rtol=1e-9)


def test_lights_add_up():
    leds = (Led((4, 1, 5), (90, 10, 0)), Led((-3, 2, 4), (0, 50, 20)), Led((0, -5, 6), (5, 0, 70)))
    settings = {"depth_mm": 0.5, "rng": None, "quantise": False}
    together = simulate_press(sensor_with(*leds), Ball(3), **settings).image
    apart = sum(simulate_press(sensor_with(led), Ball(3), **settings).image for led in leds)
    np.testing.assert_allclose(together, apart, rtol=1e-12, atol=1e-15)


def test_turning_lights_and_scene_turns_the_picture():
    leds = (Led((4, 1, 5), (90, 10, 0)), Led((-3, 2, 4), (0, 50, 20)))
    turned = tuple(
        Led((-led.position_mm[1], led.position_mm[0], led.position_mm[2]), led.color) for led in leds
    )
    settings = {"depth_mm": 0.5, "rng": None, "quantise": False}
    image = simulate_press(
        sensor_with(*leds, shape=(41, 41)), Ball(2), center_mm=(0.7, 0.3), **settings
    ).image
    again = simulate_press(
        sensor_with(*turned, shape=(41, 41)), Ball(2), center_mm=(-0.3, 0.7), **settings
    ).image
    np.testing.assert_allclose(again, np.rot90(image, k=-1), rtol=1e-10)


def test_no_light_from_behind():
    sensor = sensor_with(Led((20, 0, 2), WHITE))
    x, y = sensor.grid_mm()
    away = irradiance_from_surface(plane(x, y, 0.5, 0.0), sensor.leds)
    towards = irradiance_from_surface(plane(x, y, -0.5, 0.0), sensor.leds)
    assert np.all(away == 0)
    assert np.all(towards > 0)


def test_far_lights_agree_with_the_packages_own_shading():
    directions = np.array([[0.6, 0.1, 0.8], [-0.3, 0.5, 0.8], [-0.2, -0.6, 0.77]])
    far = 1e6
    leds = tuple(
        Led(tuple(far * d / np.linalg.norm(d)), tuple(far**2 * 100 * np.eye(3)[c]))
        for c, d in enumerate(directions)
    )
    press = simulate_press(sensor_with(*leds), Ball(3), depth_mm=0.8, rng=None, oversample=1, quantise=False)
    lights = 100 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    np.testing.assert_allclose(press.image, image_from_normals(press.normals, lights), atol=2e-3)


def test_a_pixel_is_the_mean_of_its_subpixels():
    led = Led((3, 2, 4), (100, 50, 20))
    x, y = sensor_with(led).grid_mm(oversample=3)
    z = 0.1 * np.sin(2 * x) * np.cos(3 * y)
    gradients = np.stack([0.2 * np.cos(2 * x) * np.cos(3 * y), -0.3 * np.sin(2 * x) * np.sin(3 * y)], axis=-1)
    surface = Surface(x, y, z, gradients, np.zeros(z.shape, dtype=bool))
    fine = irradiance_from_surface(surface, (led,))
    mean = fine.reshape(40, 3, 50, 3, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(irradiance_from_surface(surface, (led,), oversample=3), mean, rtol=1e-12)


def test_a_beam_falls_off_with_its_power_of_the_cosine():
    led = Led((0, 0, 5), (1000, 0, 0))
    wide, narrow = (
        simulate_background(replace(PLAIN, leds=(replace(led, beam_power=m),)), None, quantise=False)
        for m in (0, 3)
    )
    x, y = PLAIN.grid_mm()
    cosine = 5 / np.sqrt(x**2 + y**2 + 25)
    np.testing.assert_allclose(narrow[..., 0], wide[..., 0] * cosine**3, rtol=1e-9)


def test_gloss_is_brightest_where_the_surface_mirrors_the_light():
    led = Led((-20, 0, 20), (1e5, 0, 0))
    sensor = replace(PLAIN, leds=(led,), shape=(61, 81))
    press = simulate_press(
        replace(sensor, coating=Coating(specular=0.5, shininess=64)),
        Ball(3),
        depth_mm=1.0,
        rng=None,
        quantise=False,
    )
    matte = simulate_press(sensor, Ball(3), depth_mm=1.0, rng=None, quantise=False)
    gloss = press.image[..., 0] - matte.image[..., 0]
    row, column = np.unravel_index(np.argmax(gloss), gloss.shape)
    normal = press.normals[row, column]
    to_light = np.array([-20, 0, 20]) - np.array(
        [(column - 40) * 0.1, (row - 30) * 0.1, press.depth_mm[row, column]]
    )
    half = to_light / np.linalg.norm(to_light) + np.array([0, 0, 1])
    assert normal @ half / np.linalg.norm(half) > 0.999
    assert gloss.min() > -1e-9


@pytest.mark.parametrize("shininess", [1, 2, 16])
def test_gloss_is_the_power_of_the_half_angle(shininess):
    led = Led((-20, 0, 20), (1e5, 0, 0))
    settings = {"rng": None, "quantise": False, "oversample": 1}
    coating = Coating(specular=0.5, shininess=shininess)
    matte, glossy = (
        simulate_pose(replace(PLAIN, leds=(led,), coating=c), Ball(2), Pose(0), **settings).image[..., 0]
        for c in (Coating(), coating)
    )
    x, y = PLAIN.grid_mm()
    to_light = np.stack(np.broadcast_arrays(-20 - x, -y, 20.0), axis=-1)
    square = np.sum(to_light**2, axis=-1)
    half = to_light / np.sqrt(square)[..., None] + np.array([0, 0, 1])
    cosine = half[..., 2] / np.linalg.norm(half, axis=-1)
    np.testing.assert_allclose(glossy - matte, 0.5 * 1e5 * cosine**shininess / square, rtol=1e-9)


@pytest.mark.parametrize("oversample", [1, 3])
@pytest.mark.parametrize("shininess", [1, 16])
def test_the_kernel_is_the_formula_on_every_instruction_set(oversample, shininess):
    rng = np.random.default_rng(1)
    sensor = sensor_with(
        Led((4, 1, 5), (90, 10, 0), beam_power=2), Led((-3, 2, 4), (0, 50, 20)), shape=(20, 300)
    )
    x, y = (axis.ravel() for axis in sensor.grid_mm(oversample))
    z = 0.2 * np.sin(x) * np.cos(y)[:, None]
    gradients = rng.uniform(-1, 1, (*z.shape, 2))
    texture = rng.uniform(-0.1, 0.1, (*z.shape, 2)).astype(np.float32)
    visible = rng.uniform(0, 1, (2, 20, 300)).astype(np.float32)
    doublings = shininess.bit_length() - 1

    def reference(x, y, z, gradients, texture, table, visible, out, specular, doublings, oversample):
        surface = Surface(x[None], y[:, None], z, gradients + texture, z > 0)
        return irradiance.exact_irradiance(
            surface, table.astype(float), visible.repeat(oversample, 1).repeat(oversample, 2)[:, ::oversample, ::oversample],
            oversample, specular, doublings,
        )  # fmt: skip

    assert_kernel_agrees(
        irradiance._irradiance, reference, x, y, z, gradients, texture,
        irradiance._table(sensor.leds).astype(np.float32), visible, np.zeros((20, 300, 3), np.float32),
        0.3, doublings, oversample,
    )  # fmt: skip
