"""Slopes that a ball in the frame shows: exact balls, readings that bend, and what is no ball."""

import numpy as np
import pytest

from gelform.result.metrics.ball import ball_gradients
from gelform.slopes.confidence.ball import FOLLOWED, GEL_RADII, slopes_of_ball

SHAPE, RADIUS_PX, GENTLE = (120, 160), 50.0, 0.35


def ball_at(center, contact_px=35.0):
    """Slopes (H, W, 2) of a ball, which fall off where the gel leaves it; and its top."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    away = np.hypot(x - center[0], y - center[1])
    edge = np.minimum(1, contact_px / np.maximum(away, 1e-9))
    inside = ball_gradients(
        center[0] + (x - center[0]) * edge, center[1] + (y - center[1]) * edge, center, RADIUS_PX
    )
    fall = np.exp(-np.maximum(away - contact_px, 0) / 5)
    return (inside * fall[..., None]).astype(np.float32), (round(center[1]), round(center[0]))


@pytest.mark.parametrize("center", [(80, 60), (70.4, 51.7), (30, 112)])
def test_a_ball_is_followed_to_where_the_gel_leaves_it(center):
    """At (30, 112) the border cuts it."""
    slopes, top = ball_at(center)
    steepest = float(np.hypot(*ball_gradients(center[0] + 35.0, center[1], center, RADIUS_PX)))
    for place in (top, (top[0] + 2, top[1] - 2)):  # noise moves the top
        found = slopes_of_ball(slopes, place, GENTLE)
        assert found.of_ball == pytest.approx(steepest, rel=0.12)
        assert found[:2] == pytest.approx(center, abs=1.5)
        assert found.ball_radius == pytest.approx(GEL_RADII * 35.0, rel=0.1)


def test_readings_that_bend_are_followed_until_they_miss_a_seventh():
    slopes, top = ball_at((80, 60), contact_px=45.0)
    size = np.linalg.norm(slopes, axis=-1, keepdims=True)
    bent = slopes * np.where(size > 0.4, (0.4 + 0.2 * (size - 0.4)) / np.maximum(size, 1e-9), 1).astype(
        np.float32
    )
    found = slopes_of_ball(bent, top, GENTLE).of_ball
    sine = found / np.sqrt(1 + found**2)
    read = 0.4 + 0.2 * (found - 0.4)
    assert read / np.sqrt(1 + read**2) == pytest.approx(FOLLOWED * sine, rel=0.05)


def test_a_roof_a_cone_a_cylinder_and_gentle_gel_show_no_ball():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    u, v = x - 80, y - 60
    away = np.maximum(np.hypot(u, v), 1)
    round_ = ball_gradients(x, 60 + 0 * y, (80, 60), RADIUS_PX)
    cone = -0.5 * np.stack([u, v], axis=-1) / away[..., None] * np.minimum(1, away / 3)[..., None]
    roof = np.stack([-0.45 * np.tanh(u / 4), 0 * v], axis=-1)
    for face in (roof, cone, round_, 0 * roof):
        assert slopes_of_ball(face.astype(np.float32), (60, 80), GENTLE) is None
