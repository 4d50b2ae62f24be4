"""Photometric stereo with known lights, forwards and backwards."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.normals import (
    image_from_normals,
    lights_from_normals,
    normals_from_gradients,
    normals_from_image,
)

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


def test_coplanar_lights_are_refused():
    coplanar = np.array([[1.0, 0, 1], [0, 0, 1], [-1, 0, 1]])
    with pytest.raises(ValueError, match=r"condition number .*coplanar"):
        normals_from_image(np.ones((4, 4, 3)), coplanar)
