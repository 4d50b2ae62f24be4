"""Photometric stereo with known lights, forward and backward."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.slopes.normals import (
    image_from_normals,
    lights_from_normals,
    normals_from_gradients,
    normals_from_image,
)

pytestmark = pytest.mark.linear_algebra

LIGHTS = np.array([[0.8, 0.1, 0.9], [-0.5, 0.6, 0.8], [-0.2, -0.9, 1.1]])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.2, 3.0))
def test_photometric_stereo_round_trip(seed, albedo):
    """normals -> image -> normals and albedo, wherever every light reaches."""
    gradients = np.random.default_rng(seed).uniform(-0.35, 0.35, (5, 6, 2))
    normals = normals_from_gradients(gradients)
    image = image_from_normals(normals, LIGHTS, albedo)
    found, found_albedo = normals_from_image(image, LIGHTS)
    np.testing.assert_allclose(found, normals, atol=2e-5)
    np.testing.assert_allclose(found_albedo, albedo, rtol=2e-5)


def test_albedo_may_be_a_map():
    rng = np.random.default_rng(0)
    normals = normals_from_gradients(rng.uniform(-0.35, 0.35, (5, 6, 2)))
    albedo = rng.uniform(0.2, 3.0, (5, 6))
    image = image_from_normals(normals, LIGHTS, albedo)
    np.testing.assert_allclose(normals_from_image(image, LIGHTS)[1], albedo, rtol=2e-5)
    np.testing.assert_allclose(lights_from_normals(image, normals, albedo), LIGHTS, atol=1e-5)


def test_a_black_pixel_looks_up():
    image = image_from_normals(normals_from_gradients(np.zeros((2, 3, 2))), LIGHTS)
    image[1, 2] = 0
    normals, albedo = normals_from_image(image, LIGHTS)
    np.testing.assert_allclose(normals, np.broadcast_to([0, 0, 1], (2, 3, 3)), atol=1e-6)
    assert albedo[1, 2] == 0


def test_attached_shadow_gets_no_light():
    steep = normals_from_gradients(np.array([[[4.0, 0.0]]]))  # its normal points to -x, away from light 0
    image = image_from_normals(steep, LIGHTS)
    assert image[0, 0, 0] == 0
    assert (image[0, 0, 1:] > 0).all()


def test_lights_come_back_from_a_ball():
    y, x = np.mgrid[-1:1:41j, -1:1:41j]
    inside = x**2 + y**2 < 0.6
    height = np.sqrt(np.where(inside, 1 - x**2 - y**2, 1))
    normals = normals_from_gradients(np.stack([-x / height, -y / height], axis=-1))[inside]
    image = image_from_normals(normals, LIGHTS)
    assert (image == 0).any()  # some pixels are in the attached shadow and must be left out
    np.testing.assert_allclose(lights_from_normals(image, normals), LIGHTS, atol=1e-5)


def test_lights_need_normals_that_span_space():
    flat = np.broadcast_to([0.0, 0.0, 1.0], (50, 3))
    with pytest.raises(ValueError, match="press of a ball"):
        lights_from_normals(image_from_normals(flat, LIGHTS), flat)


def test_three_normals_determine_the_lights():
    normals = np.array([[0.0, 0.0, 1.0], [0.2, 0.1, 1.0], [-0.1, 0.3, 1.0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    np.testing.assert_allclose(
        lights_from_normals(image_from_normals(normals, LIGHTS), normals), LIGHTS, atol=1e-4
    )


def test_slightly_curved_is_enough_but_rounding_is_not():
    """A tolerance in proportion to the length of a column: the same for few pixels and for many."""
    rng = np.random.default_rng(0)
    tilted = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    curved = tilted + rng.normal(0, 1e-3, (10_000, 3))
    np.testing.assert_allclose(lights_from_normals(curved @ LIGHTS.T, curved), LIGHTS, atol=1e-2)
    rounded = tilted + rng.normal(0, 1e-7, (10_000, 3))
    with pytest.raises(ValueError, match="press of a ball"):
        lights_from_normals(rounded @ LIGHTS.T, rounded)
