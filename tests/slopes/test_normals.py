"""Photometric stereo with known lights, forward and backward. Slopes: from normals and depth, their curl, and
smoothing.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gelform.slopes import gradients, normals
from gelform.slopes.gradients import (
    curl_from_gradients,
    gradients_from_depth,
    gradients_from_normals,
    slopes_of_solution,
)
from gelform.slopes.normals import (
    image_from_normals,
    lights_from_normals,
    normals_from_gradients,
    normals_from_image,
)
from kernel_agreement import assert_kernel_agrees
from scenes import PEAKS, QUADRATIC, polynomial, scene

pytestmark = pytest.mark.linear_algebra

LIGHTS = np.array([[0.8, 0.1, 0.9], [-0.5, 0.6, 0.8], [-0.2, -0.9, 1.1]])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.2, 3.0, None]))
def test_photometric_stereo_round_trip(seed, albedo):
    """normals -> image -> normals and albedo, a number or a map, wherever every light reaches."""
    rng = np.random.default_rng(seed)
    normals = normals_from_gradients(rng.uniform(-0.35, 0.35, (5, 6, 2)))
    albedo = rng.uniform(0.2, 3.0, (5, 6)) if albedo is None else albedo
    image = image_from_normals(normals, LIGHTS, albedo)
    found, found_albedo = normals_from_image(image, LIGHTS)
    np.testing.assert_allclose(found, normals, atol=2e-5)
    np.testing.assert_allclose(found_albedo, albedo, rtol=2e-5)
    np.testing.assert_allclose(lights_from_normals(image, normals, albedo), LIGHTS, atol=1e-4)


def test_the_kernel_of_normals_is_the_formula():
    def reference(slopes, normals):
        raw = np.concatenate([-slopes, np.ones_like(slopes[:, :1])], axis=1, dtype=np.float64)
        return raw / np.linalg.norm(raw, axis=1, keepdims=True)

    assert_kernel_agrees(normals._normals_of_slopes, reference)


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


def test_three_normals_determine_the_lights_and_one_does_not():
    normals = np.array([[0.0, 0.0, 1.0], [0.2, 0.1, 1.0], [-0.1, 0.3, 1.0]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    found = lights_from_normals(image_from_normals(normals, LIGHTS), normals)
    np.testing.assert_allclose(found, LIGHTS, atol=1e-4)
    flat = np.broadcast_to([0.0, 0.0, 1.0], (50, 3))
    with pytest.raises(ValueError, match="press of a ball"):
        lights_from_normals(image_from_normals(flat, LIGHTS), flat)


def test_slightly_curved_is_enough_but_rounding_is_not():
    """A tolerance in proportion to the length of a column: the same for few pixels and for many."""
    rng = np.random.default_rng(0)
    tilted = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])
    curved = tilted + rng.normal(0, 1e-3, (10_000, 3))
    np.testing.assert_allclose(lights_from_normals(curved @ LIGHTS.T, curved), LIGHTS, atol=1e-2)
    rounded = tilted + rng.normal(0, 1e-7, (10_000, 3))
    with pytest.raises(ValueError, match="press of a ball"):
        lights_from_normals(rounded @ LIGHTS.T, rounded)


PITCHES = [(0.0634, 0.0634), (0.05, 0.08)]


@pytest.mark.parametrize("pitch", PITCHES)
@pytest.mark.parametrize("shape", [(12, 17), (3, 3)])
def test_gradients_from_depth_are_exact_on_quadratics_border_included(shape, pitch):
    truth, gradients, _ = scene(QUADRATIC, shape, pitch)
    assert gradients_from_depth(truth, mm_per_px=pitch) == pytest.approx(gradients, abs=1e-5)


def test_gradients_from_depth_converge_with_order_two():
    errors = []
    for n in (1, 2, 4):
        truth, gradients, pitch = scene(PEAKS, (60 * n, 80 * n), 0.25 / n)
        errors.append(np.max(np.abs(gradients_from_depth(truth, mm_per_px=pitch) - gradients)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.4)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2, abs=0.4)


@pytest.mark.parametrize("shape", [(1, 5), (5, 1), (2, 2)])
def test_gradients_from_depth_of_thin_frames(shape):
    truth, gradients, pitch = scene(polynomial({(1, 0): 0.3, (0, 1): -0.2}), shape, 0.1)
    expected = gradients * [shape[1] > 1, shape[0] > 1]
    assert gradients_from_depth(truth, mm_per_px=pitch) == pytest.approx(expected, abs=1e-6)


def ball_normals(radius_px, noise=0.0, edge=0.8):
    """Normals of a pressed ball within the flat gel, and the slopes."""
    y, x = np.mgrid[-40:41, -50:51].astype(float)
    inside = x**2 + y**2 < (edge * radius_px) ** 2
    z = np.sqrt(np.where(inside, radius_px**2 - x**2 - y**2, 1.0))
    slopes = np.where(inside[..., None], np.stack([-x, -y], -1) / z[..., None], 0.0)
    slopes = (slopes + np.random.default_rng(0).normal(0, noise, slopes.shape)).astype(np.float32)
    return normals_from_gradients(slopes), slopes


@pytest.mark.parametrize("radius_px", [15, 40])
@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1])
def test_normals_of_other_conventions_and_their_wrong_sign_of_y(radius_px, noise):
    normals, slopes = ball_normals(radius_px, noise)
    for convention, signs in (("directx", (1, 1, 1)), ("opengl", (1, -1, 1)), ("opencv", (1, 1, -1))):
        found = gradients_from_normals(normals * np.float32(signs), convention=convention)
        np.testing.assert_allclose(found, slopes, atol=1e-5)
    if noise < 0.1:  # more noise hides the curl: nothing is said
        for given, convention, said in (
            ("opengl", "directx", "point up"),
            ("directx", "opengl", "point down"),
        ):
            theirs = normals * np.float32([1, -1 if given == "opengl" else 1, 1])
            with pytest.raises(ValueError, match=rf"{said}.*convention='{given}'"):
                gradients_from_normals(theirs, convention=convention)
    with pytest.raises(ValueError, match="directx, opengl, opencv, got 'z up'"):
        gradients_from_normals(normals, convention="z up")
    with pytest.raises(ValueError, match="face the camera"):
        gradients_from_normals(normals, convention="opencv")


@pytest.mark.parametrize("pitch", PITCHES)
def test_curl_of_a_surface_is_zero_and_of_a_rotation_is_not(pitch):
    truth, gradients, _ = scene(QUADRATIC, (12, 17), pitch)
    assert curl_from_gradients(gradients, mm_per_px=pitch) == pytest.approx(np.zeros_like(truth), abs=1e-5)
    y, x = np.mgrid[:12, :17] * np.array([pitch[1], pitch[0]])[:, None, None]
    rotation = np.stack([y, -x], axis=-1)
    assert curl_from_gradients(rotation, mm_per_px=pitch) == pytest.approx(np.full((12, 17), 2.0), abs=1e-4)


def test_curl_of_several_frames_is_that_of_each():
    slopes = np.random.default_rng(0).normal(size=(2, 5, 6, 2))
    each = [curl_from_gradients(of_frame, mm_per_px=(0.05, 0.08)) for of_frame in slopes]
    np.testing.assert_array_equal(curl_from_gradients(slopes, mm_per_px=(0.05, 0.08)), each)


def test_the_kernel_of_a_solutions_slopes_agrees_with_numpy():
    def numpy_slopes(depth, out, per_x, per_y):
        return gradients_from_depth(depth, mm_per_px=(0.01 / per_x, 0.01 / per_y)) * 0.01

    assert_kernel_agrees(gradients._slopes_of_depth, numpy_slopes)
    depth, pitch = np.random.default_rng(0).normal(size=(21, 33)).astype(np.float32), (0.0634, 0.08)
    expected = gradients_from_depth(depth, mm_per_px=pitch)
    np.testing.assert_allclose(slopes_of_solution(depth, pitch), expected, atol=1e-3)


def test_the_kernel_of_curl_agrees_with_numpy():
    def numpy_squares(g, known, result):
        turn = (g[:, 2:, 1:-1, 0] - g[:, :-2, 1:-1, 0]) - (g[:, 1:-1, 2:, 1] - g[:, 1:-1, :-2, 1])
        inner = (np.ones(g.shape[:3], bool) if known is None else known)[:, 1:-1, 1:-1]
        return np.array([(0.25 * turn.astype(float) ** 2)[inner].sum(), inner.sum()])

    assert_kernel_agrees(gradients._curl_squares, numpy_squares)
    slopes = np.random.default_rng(0).normal(size=(1, 5, 6, 2)).astype(np.float32)
    assert gradients.curl_rms(slopes, np.zeros((1, 5, 6), bool)) == 0 < gradients.curl_rms(slopes, None)


def test_smoothing_takes_noise_and_keeps_an_edge():
    """On a smooth surface most of the noise goes; a step of the slope by twenty times the texture stays: a plain blur
    would be 0.2 off at its foot, and by half of that over 3 px."""
    rng = np.random.default_rng(0)
    x = np.linspace(-1, 1, 160)[None, :, None] * np.ones((120, 1, 2))
    noise = rng.normal(0, 0.01, x.shape)
    smooth = 0.3 * np.sin(2 * x)
    left = gradients.smoothed_gradients(smooth + noise) - smooth
    assert left[8:-8, 8:-8].std() < 0.35 * noise.std()
    edge = np.where(x > 0, 0.2, -0.2)
    kept = gradients.smoothed_gradients(edge)
    off = np.abs(kept - edge).max(axis=(0, 2))
    assert off.max() < 0.05
    assert np.count_nonzero(off > 0.01) <= 4


def test_the_texture_says_which_detail_goes():
    """A ripple of 12 px: less than half where the texture is much larger than it, there where it is much smaller."""
    x = np.arange(320)[None, :, None] * np.ones((240, 1, 2))
    ripple = 0.05 * np.sin(2 * np.pi * x / 12)
    sizes = [np.abs(gradients.smoothed_gradients(ripple, texture=t)[:, 20:-20]).max() for t in (1.0, 0.001)]
    assert sizes[0] < 0.5 * 0.05
    assert sizes[1] == pytest.approx(0.05, rel=0.02)
    with pytest.raises(ValueError, match="texture"):
        gradients.smoothed_gradients(np.zeros((4, 5, 2)), texture=0.0)
    with pytest.raises(ValueError, match="one frame"):
        gradients.smoothed_gradients(np.zeros((3, 4, 5, 2)))
