"""The benchmark on a cube's edge finds the faces of a roof whose slopes are read too small, and states the truth."""

import numpy as np
import pytest

import edges_of_cube

MM_PER_PX, READ = 0.0625, 0.5
SHAPE = (120, 240)


def roof(roll_deg, turn_deg, read=READ, length_px=160):
    """Depth (mm) of a roof of 90 degrees on flat gel, its slopes as a bad model reads them, and the true ones."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    turn = np.radians(turn_deg)
    u = np.array([-np.sin(turn), np.cos(turn)])  # across the edge
    x, y = x - SHAPE[1] / 2, y - SHAPE[0] / 2
    away, along = x * u[0] + y * u[1], x * u[1] - y * u[0]
    slopes = np.tan(np.radians(45 + np.array([roll_deg, -roll_deg])))
    on = (np.abs(along) < length_px / 2) & (away > -20) & (away < 20)
    true = np.where(away < 0, slopes[0], -slopes[1])
    gradients = read * np.where(on, true, 0)[..., None] * u
    depth = MM_PER_PX * read * np.minimum(away * slopes[0], -away * slopes[1])
    return depth, gradients, slopes, u


@pytest.mark.parametrize(("roll_deg", "turn_deg"), [(0, 0), (8, 5), (-8, 30)])
def test_the_faces_of_a_roof_are_found_and_made_perpendicular(roll_deg, turn_deg):
    _, gradients, slopes, u = roof(roll_deg, turn_deg)
    edge = edges_of_cube.edge_in(gradients, MM_PER_PX)
    np.testing.assert_allclose(edge.true_gradients[0], slopes[0] * u, atol=0.02)
    np.testing.assert_allclose(edge.true_gradients[1], -slopes[1] * u, atol=0.02)
    assert edge.angle_deg == pytest.approx(np.degrees(np.arctan(READ * slopes).sum()), abs=1)
    away = (np.argwhere(edge.faces[0])[:, ::-1] - np.array(SHAPE[::-1]) / 2) @ u
    assert -20 <= away.min() < -18
    assert -5.5 < away.max() <= -edges_of_cube.FROM_EDGE_PX + 0.5


def test_half_the_rise_is_missing_where_slopes_are_read_at_half():
    depth, gradients, slopes, _ = roof(5, 10)
    edge = edges_of_cube.edge_in(gradients, MM_PER_PX)
    missing = edges_of_cube.crest_error_mm(edge, depth, MM_PER_PX, slopes)
    assert missing == pytest.approx((1 - READ) * 19.5 * MM_PER_PX * slopes.mean(), rel=0.05)


def test_a_shorter_edge_is_cut():
    assert edges_of_cube.edge_in(roof(0, 0, length_px=120)[1], MM_PER_PX) is None
    assert edges_of_cube.edge_in(np.zeros((*SHAPE, 2)), MM_PER_PX) is None


@pytest.mark.parametrize("turn_deg", [-7, 4])
def test_the_line_in_the_image_is_where_its_colors_change(turn_deg):
    """Faces 40 gray levels redder or bluer, of unequal shade, their border blurred over a pixel, in noise."""
    rng, turn, beside = np.random.default_rng(3), np.radians(turn_deg), (0.3, -0.4)
    u = np.array([-np.sin(turn), np.cos(turn)])
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    x, y = x - SHAPE[1] / 2 - beside[0], y - SHAPE[0] / 2 - beside[1]
    away, along = x * u[0] + y * u[1], x * u[1] - y * u[0]
    on = (np.abs(along) < 80) & (np.abs(away) < 20)
    face = np.where(on, -np.tanh(away) * (30 + along / 8) - 0.2 * away, 0)
    background = np.full((*SHAPE, 3), 120.0)
    image = background + face[..., None] * (1, 0.2, -1) + rng.normal(0, 2, (*SHAPE, 3))
    line = edges_of_cube.line_in(image, background, MM_PER_PX)
    assert np.degrees(np.arcsin(line.across[0] * u[1] - line.across[1] * u[0])) == pytest.approx(0, abs=0.05)
    off = (line.middle - np.array(SHAPE[::-1]) / 2 - beside) @ u
    assert off == pytest.approx(0, abs=0.08)
    assert line.apart_px < 0.1
    assert np.degrees(line.apart_rad) < 0.05
    assert edges_of_cube.line_in(background, background, MM_PER_PX) is None
