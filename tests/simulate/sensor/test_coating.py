"""The gel's coating: texture, markers, dust, albedo."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.simulate import Ball, Coating, Pose, simulate_background, simulate_pose, simulate_press
from gelform.simulate.sensor.coating import texture_gradients
from made.sensors import PLAIN


def test_the_texture_is_the_slope_of_one_surface():
    slopes = texture_gradients(Coating(roughness=0.05, scratches=4, grain_mm=0.4, seed=3), (60, 80), 0.1, 1)
    along_y, along_x = np.gradient(slopes[..., 0], axis=0), np.gradient(slopes[..., 1], axis=1)
    inner = (slice(2, -2), slice(2, -2))
    np.testing.assert_allclose(along_y[inner], along_x[inner], atol=1e-4)
    assert np.abs(along_y).max() > 0.01


def test_markers_are_as_large_as_said():
    coating = Coating(marker_pitch_mm=2.0, marker_radius_mm=0.3)
    press = simulate_pose(replace(PLAIN, coating=coating), Ball(2), Pose(0), rng=None)
    dark = (1 - press.albedo).sum() / 0.9 * 0.1**2
    assert dark / (60 * 80 * 0.1**2) == pytest.approx(np.pi * 0.3**2 / 2.0**2, rel=0.1)


def test_roughness_shades_but_is_no_depth():
    press, other, smooth = (
        simulate_press(replace(PLAIN, coating=coating), Ball(2), depth_mm=0.5, rng=None)
        for coating in (*(Coating(roughness=0.05, scratches=3, seed=k) for k in (1, 2)), Coating())
    )
    np.testing.assert_array_equal(press.depth_mm, smooth.depth_mm)
    assert 0.5 < (press.image.astype(float) - smooth.image).std() < 30
    assert np.any(other.image != press.image)


def test_albedo_and_dust_multiply_the_light():
    albedo = np.linspace(0.5, 1, 60 * 80).reshape(60, 80)
    painted = simulate_background(replace(PLAIN, coating=Coating(albedo=albedo)), None, quantise=False)
    np.testing.assert_allclose(
        painted, simulate_background(PLAIN, None, quantise=False) * albedo[..., None], rtol=1e-6
    )
    dusty = simulate_pose(replace(PLAIN, coating=Coating(dust=5)), Ball(2), Pose(0), rng=None)
    assert 0 < np.count_nonzero(dusty.albedo != 1) < 200
