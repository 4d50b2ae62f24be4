"""Angles and errors of a press against what they must be."""

import numpy as np
import pytest

from gelform.result.metrics.ball import ball_gradients
from gelform.result.metrics.depth_errors import angle_deg, press_errors, score_slopes

MM_PER_PX = 0.06
BALL_MM = 3.0
SHAPE = (120, 160)


CIRCLE = (80.3, 59.6, 30.0)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
away_px = np.hypot(X - CIRCLE[0], Y - CIRCLE[1])  # from the center


def pressed_ball(contact_px=30.0):
    """Depth and gradients of a ball's cap on a flat gel."""
    radius, inside = BALL_MM / MM_PER_PX, away_px < contact_px
    height = np.sqrt(np.where(inside, radius**2 - away_px**2, 1))
    depth = np.where(inside, (height - np.sqrt(radius**2 - contact_px**2)) * MM_PER_PX, 0)
    return depth, ball_gradients(X, Y, CIRCLE[:2], radius) * inside[..., None]


def errors_of(depth, gradients, circle=CIRCLE, **more):
    return press_errors(
        depth, gradients, circle_px=circle, ball_radius_mm=BALL_MM, mm_per_px=MM_PER_PX, **more
    )


def test_angles():
    assert angle_deg([0.0, 0.0], [1.0, 0.0]) == pytest.approx(45)
    assert angle_deg([1.0, 0.0], [-1.0, 0.0]) == pytest.approx(90)
    assert angle_deg([0.3, -0.2], [0.3, -0.2]) == pytest.approx(0, abs=1e-12)
    assert angle_deg([1e-5, 0.0], [0.0, 0.0]) == pytest.approx(np.degrees(1e-5))


def test_perfect_press_has_no_error():
    errors = errors_of(*pressed_ball())
    assert errors.normal_deg < 1e-3
    assert errors.normal_free_deg < 1e-2
    assert errors.cap_um < 1e-3
    assert abs(errors.radius_percent) < 0.1
    assert errors.off_contact_um == 0


def test_errors_are_those_put_in():
    depth, gradients = pressed_ball()
    scaled, lifted = errors_of(1.1 * depth, 1.1 * gradients), errors_of(depth + 0.02, gradients)
    assert scaled.radius_percent == pytest.approx(-8.0, abs=2.0)  # too deep: the sphere is too small
    assert scaled.cap_um > 5
    assert scaled.normal_deg > 0.5
    assert lifted.off_contact_um == pytest.approx(20.0)
    assert lifted.cap_um < 1e-3  # the offset is free, the scale is not


def test_a_flat_rim_is_left_out_inside_the_edge():
    """Beyond it the gel has left the ball: the rim's error alone counts it, and without an edge all are up to the rim."""
    depth, gradients = pressed_ball()
    for ratio in [0.7, 0.85]:
        flat = np.where((away_px > (ratio + 0.02) * 30.0)[..., None], 0.5 * gradients, gradients)
        errors = errors_of(depth, flat, contact_radius_ratio=ratio)
        assert max(errors.normal_deg, errors.normal_free_deg) < 0.3 < 0.7 < errors.normal_rim_deg
        whole = errors_of(depth, flat)
        assert whole.normal_free_deg == whole.normal_rim_deg > 0.7


def test_depth_is_compared_inside_the_edge_too():
    """A gel that stands off the ball beyond it is neither a wrong cap nor a wrong radius."""
    depth, gradients = pressed_ball()
    lower = depth - 0.002 * np.maximum(away_px - 0.7 * 30, 0) ** 2 * (away_px < 30)
    inside, whole = (errors_of(lower, gradients, contact_radius_ratio=ratio) for ratio in (0.7, 1.0))
    assert inside.cap_um < 1 < 10 < whole.cap_um
    assert abs(inside.radius_percent) < 0.5 < 3 < abs(whole.radius_percent)


def test_the_edge_is_3_px_inside_the_visible_rim_at_least():
    near, at = (errors_of(*pressed_ball(), contact_radius_ratio=ratio) for ratio in (0.99, 1.0))
    assert near == at
    with pytest.raises(ValueError, match="contact_radius_ratio"):
        errors_of(*pressed_ball(), contact_radius_ratio=1.1)


def test_a_deep_press_is_scored_where_the_gel_follows_the_ball():
    """A visible circle wider than the ball: slopes beyond 0.75 of its radius are not the ball's and count for nothing."""
    depth, gradients = pressed_ball(contact_px=40.0)
    followed = np.where((away_px > 0.75 * BALL_MM / MM_PER_PX)[..., None], 0, gradients)
    errors = errors_of(depth, followed, (*CIRCLE[:2], 55.0))
    assert max(errors.normal_deg, errors.normal_rim_deg, errors.normal_free_deg) < 0.01


def test_wrong_circle_costs_the_label_but_not_the_free_center():
    errors = errors_of(*pressed_ball(), (81.8, 59.6, 28.0))
    assert errors.normal_deg > 1.0
    assert errors.normal_free_deg < 0.2
    assert errors.cap_free_um < 1 < errors.cap_um


def test_a_score_finds_its_center_and_reads_the_errors_put_in():
    y, x = (axis.ravel() for axis in np.mgrid[40:80, 60:100])
    truth = ball_gradients(x, y, (80.3, 59.6), 50.0)
    score = score_slopes(truth, x, y, (78.0, 61.0), 50.0)
    np.testing.assert_allclose(score.center_px, (80.3, 59.6), atol=1e-3)
    assert score.normal_deg < 1e-3
    np.testing.assert_allclose(score.errors, 0, atol=1e-4)
    steeper = score_slopes(1.1 * truth, x, y, (78.0, 61.0), 50.0)
    np.testing.assert_allclose(steeper.errors, 0.1 * truth, atol=5e-3)
    assert steeper.normal_deg == pytest.approx(angle_deg(1.1 * truth, truth).mean(), rel=0.05)


def test_arguments_of_press_errors_are_checked():
    for changed, said in [
        ({"depth_mm": [[1, 2], [3]]}, "depth_mm as an array"),
        ({"depth_mm": np.zeros((2, 9, 9))}, r"depth_mm of shape \(H, W\)"),
        ({"gradients": np.zeros((8, 9, 2))}, r"gradients of shape \(9, 9, 2\), got \(8, 9, 2\)"),
        ({"gradients": np.zeros((1, 9, 9, 2))}, "gradients of one frame"),
        ({"circle_px": (4, 4)}, "circle_px as 3 finite numbers"),
        ({"ball_radius_mm": 1e300}, "ball_radius_mm between"),
        ({"mm_per_px": np.ones(4)}, "mm_per_px as a number"),
    ]:
        right = {"depth_mm": np.zeros((9, 9)), "gradients": np.zeros((9, 9, 2)), "circle_px": (4.0, 4.0, 3.0)}
        arguments = {**right, "ball_radius_mm": 4.0, "mm_per_px": 0.1, **changed}
        with pytest.raises((ValueError, TypeError), match=said):
            press_errors(**arguments)
