"""Frames that say nothing, or only in part: findings, large sigma, bounded depth; never an exception, never NaN."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.depth.solvers import SOLVERS
from made.small_gel import (
    MM_PER_PX,
    SHAPE,
    Touch,
    background,
    calibration,
    depth_of,
    image_of,
)

TOUCH = Touch(depth_mm=0.4, x_px=40, y_px=40)


@pytest.fixture(scope="module")
def reconstruct():
    return gelform.Reconstructor(calibration())


def names(result):
    return [finding.name for finding in result.health]


def test_a_dead_frame_is_depth_0_of_which_nothing_is_known(reconstruct):
    for level, name in [(0, "dark"), (255, "saturated"), (200, "torn")]:
        result = reconstruct(np.full((*SHAPE, 3), level, dtype=np.uint8))
        assert name in names(result)
        assert np.abs(result.depth_mm).max() < 5e-3
        uniform = min(SHAPE) * MM_PER_PX / 12**0.5  # any depth as likely as any other
        np.testing.assert_allclose(result.depth_sigma_mm, uniform, rtol=1e-5)
        assert result.gradients_sigma.min() >= 0.999
        assert result.confidence.max() < 1e-5
        assert not result.known.any()
        assert not result.contact.any()


def test_every_kind_of_solver_survives_a_dead_frame():
    for solver in ["auto", *SOLVERS]:
        result = gelform.Reconstructor(calibration(), solver=solver)(np.zeros((*SHAPE, 3), dtype=np.uint8))
        assert np.isfinite(result.depth_mm).all()
        assert np.abs(result.depth_mm).max() < 0.01
        assert "dark" in names(result)


def test_what_is_left_of_a_torn_frame_is_measured(reconstruct):
    frame = image_of(TOUCH)
    frame[:8] = 0
    result = reconstruct(frame)
    assert names(result) == ["torn"]
    assert not result.known[:8].any()
    assert result.known[24:].all()
    assert result.depth_sigma_mm[:8].min() > 1.0
    assert result.depth_sigma_mm[24:].max() < 0.5
    below = slice(24, None)
    assert np.abs(result.depth_mm[below] - depth_of(TOUCH)[below]).max() < 0.03


def test_a_background_that_is_none_is_refused():
    for level in [0, 255, 128]:
        with pytest.raises(gelform.CalibrationError, match="This image cannot be a background"):
            gelform.Reconstructor(calibration(), background=np.full((*SHAPE, 3), level, dtype=np.uint8))


def test_a_stream_that_starts_pressed_says_so(reconstruct):
    """Its background image has a contact, which lies in the depth turned over once the object is gone."""
    pressed = reconstruct.with_background(image_of(TOUCH).astype(np.float32))
    result = pressed(background().astype(np.uint8))
    found = {finding.name: finding.figure for finding in result.health}
    assert found["background_pressed"] == pytest.approx(0.4, abs=0.1)
    assert "background_pressed" not in names(reconstruct(image_of(TOUCH)))


def test_depth_ends_where_the_gel_does(reconstruct):
    """A color change that means slopes of 5 all over: no gel does that, and the result says so."""
    ramp = np.clip(background() * np.array([0.75, 1.3, 1.0]), 0, 255)
    ramp[:, :4] = background()[:, :4]
    result = reconstruct(ramp.astype(np.float32))
    assert np.abs(result.depth_mm).max() <= min(SHAPE) * MM_PER_PX + 1e-6
    assert np.abs(result.depth_mm).max() < 1e-3 or result.health


def test_depth_stays_within_the_gel_where_its_thickness_is_known():
    """The field of view alone would allow 6.4 mm."""
    thin = replace(calibration(), settings={"gel_thickness_mm": 0.3})
    result = gelform.Reconstructor(thin)(image_of(TOUCH))
    assert "beyond_gel" in names(result)
    assert result.depth_mm.max() == np.float32(0.3)
    assert "beyond_gel" not in names(gelform.Reconstructor(calibration())(image_of(TOUCH)))


def test_a_seam_right_at_a_contact_is_found(reconstruct):
    """The row below it jumps too, as the displaced ball begins there."""
    frame = image_of(Touch(radius_mm=3.5, depth_mm=0.27, x_px=50, y_px=41.4, seed=216))
    frame[28:] = np.roll(frame[28:], 40, axis=1)
    result = reconstruct(frame)
    assert names(result) == ["torn"]
    assert not result.known[30:60].any()
    assert np.abs(result.depth_mm).max() < 0.1
