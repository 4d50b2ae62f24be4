"""A ball's slopes, its center found from slopes, and the sphere through its depth. Angles and errors of a press against
what they must be. Areal roughness of surfaces whose figures are known, and against the standard's formulas written out.
"""

import numpy as np
import pytest
from scipy import integrate

from gelform.result import metrics
from gelform.result.metrics import (
    angle_deg,
    areal_roughness,
    ball_center,
    ball_gradients,
    center_jacobian,
    fit_sphere,
    followed_radius,
    gaussian_areal_filter,
    press_errors,
    score_slopes,
)
from kernel_agreement import assert_kernel_agrees

pytestmark = pytest.mark.linear_algebra

MM_PER_PX = 0.06
BALL_MM = 3.0
SHAPE = (120, 160)
CENTER = (80.3, 59.6)


CIRCLE = (*CENTER, 30.0)
Y, X = np.mgrid[: SHAPE[0], : SHAPE[1]]
away_px = np.hypot(X - CENTER[0], Y - CENTER[1])


def pressed_ball(contact_px=30.0):
    """Depth and gradients of a ball's cap on a flat gel."""
    radius, inside = BALL_MM / MM_PER_PX, away_px < contact_px
    height = np.sqrt(np.where(inside, radius**2 - away_px**2, 1))
    depth = np.where(inside, (height - np.sqrt(radius**2 - contact_px**2)) * MM_PER_PX, 0)
    return depth, ball_gradients(X, Y, CENTER, radius) * inside[..., None]


def test_ball_slopes_are_those_of_its_depth():
    depth, gradients = pressed_ball()
    numeric = np.stack(np.gradient(depth, MM_PER_PX)[::-1], axis=-1)
    np.testing.assert_allclose(gradients[away_px < 25], numeric[away_px < 25], atol=5e-4)


def test_center_is_found_despite_a_bad_third():
    y, x = (axis.ravel() for axis in np.mgrid[40:80, 60:100])
    gradients = ball_gradients(x, y, (80.3, 59.6), 50.0)
    gradients[x > 90] += 0.4
    found, plain = ball_center(gradients, x, y, (77.0, 62.0), 50.0), np.array((77.0, 62.0))
    metrics._ball_center(
        gradients, x.astype(float), y.astype(float), plain, 50.0, 100.0, 0.97, 30
    )  # least squares
    off, plainly = (np.hypot(*np.subtract(one, (80.3, 59.6))) for one in (found, plain))
    assert off < min(0.8, 0.25 * plainly)
    exact = ball_center(ball_gradients(x, y, (80.3, 59.6), 50.0), x, y, (77.0, 62.0), 50.0)
    np.testing.assert_allclose(exact, (80.3, 59.6), atol=1e-3)


def test_sphere_fit_recovers_the_ball():
    center_mm, radius_mm = fit_sphere(pressed_ball()[0], away_px < 30, mm_per_px=MM_PER_PX, radius_mm=2.0)
    assert radius_mm == pytest.approx(BALL_MM, rel=1e-3)
    np.testing.assert_allclose(center_mm[:2], (80.3 * MM_PER_PX, 59.6 * MM_PER_PX), atol=1e-3)


def test_the_gel_follows_the_visible_circle_unless_that_is_as_wide_as_the_ball():
    assert followed_radius(60.0, 100.0) == 60
    assert followed_radius(96.0, 100.0) == 96
    assert followed_radius(97.0, 100.0) == followed_radius(150.0, 100.0) == 75
    steepest = np.linalg.norm(ball_gradients(0.8 * 75, 0.0, (0, 0), 100.0))
    assert steepest == pytest.approx(0.75)


def center_by_numpy(gradients, x, y, center, radius, scale, _, rounds):
    """Gauss-Newton with the derivatives of the slopes by the center, each step on all pixels."""
    found = center.copy()
    for _ in range(rounds):
        slopes = ball_gradients(x, y, tuple(found), radius)
        residual = gradients - slopes
        weight = np.repeat(1 / np.sqrt(1 + np.sum(residual**2, axis=-1) / scale**2), 2)
        jacobian = center_jacobian(slopes, radius).reshape(-1, 2)
        weighted = jacobian * weight[:, None]
        move = np.linalg.solve(weighted.T @ jacobian + 1e-12 * np.eye(2), weighted.T @ residual.ravel())
        found += np.clip(move, -0.2 * radius, 0.2 * radius)
        if np.hypot(*move) < 1e-3:
            break
    return found


@pytest.mark.parametrize("start", [(77.0, 62.0), (40.0, 20.0), (130.0, 59.0)])
@pytest.mark.parametrize("rounds", [1, 3, 30])
def test_the_kernel_finds_the_center_as_numpy_does(start, rounds):
    """From far off too, where slopes are held and steps are cut."""
    y, x = (v.ravel().astype(float) for v in np.mgrid[20:100:3, 30:130:3])
    noise = np.random.default_rng(0).normal(0, 0.1, (x.size, 2))
    gradients = ball_gradients(x, y, (80.3, 59.6), 50.0) + noise
    arguments = gradients, x, y, np.array(start), 50.0, 0.05, metrics.STEEPEST_FRACTION, rounds
    assert_kernel_agrees(metrics._ball_center, center_by_numpy, *arguments, tolerance=1e-10)


def errors_of(depth, gradients, circle=CIRCLE, **more):
    usual = {"circle_px": circle, "ball_radius_mm": BALL_MM, "mm_per_px": MM_PER_PX}
    return press_errors(depth, gradients, **usual, **more)


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


PITCH = 0.02
SHAPE_ROUGHNESS = (200, 250)  # whole waves of 25 and 50 px
PLAIN = {"mm_per_px": PITCH, "form": "none", "s_filter_mm": None, "l_filter_mm": None}
Y_ROUGHNESS, X_ROUGHNESS = np.mgrid[: SHAPE_ROUGHNESS[0], : SHAPE_ROUGHNESS[1]] * PITCH


def wave(amplitude_mm=0.01, length_px=50):
    return amplitude_mm * np.sin(2 * np.pi * X_ROUGHNESS / (length_px * PITCH) + 0.3)


def test_a_sinusoid():
    found, amplitude_um = areal_roughness(wave(), **PLAIN), 10.0
    assert found.Sa_um == pytest.approx(2 * amplitude_um / np.pi, rel=2e-3)
    assert found.Sq_um == pytest.approx(amplitude_um / np.sqrt(2), rel=1e-6)
    assert found.Sz_um == pytest.approx(2 * amplitude_um, rel=2e-3)
    assert found.Ssk == pytest.approx(0, abs=1e-6)
    assert found.Sku == pytest.approx(1.5, rel=1e-6)
    assert found.area_mm2 == pytest.approx(SHAPE_ROUGHNESS[0] * SHAPE_ROUGHNESS[1] * PITCH**2)


def test_the_area_of_a_steep_sinusoid():
    """Its arc length, an elliptic integral."""
    amplitude, length = 0.2, 1.0
    slope = 2 * np.pi * amplitude / length
    arc, _ = integrate.quad(lambda t: np.sqrt(1 + (slope * np.cos(t)) ** 2), 0, 2 * np.pi)
    found = areal_roughness(wave(amplitude), **PLAIN)
    assert found.Sdr_percent == pytest.approx(100 * (arc / (2 * np.pi) - 1), rel=5e-3)


def test_a_tilted_plane_has_the_area_of_its_slope_and_no_height_once_it_is_removed():
    level = areal_roughness(np.full(SHAPE_ROUGHNESS, 0.7), **PLAIN)
    assert (level.Sa_um, level.Sq_um, level.Sku, level.Sdr_percent) == (0, 0, 0, 0)
    plane = 0.3 * X_ROUGHNESS + 0.4 * Y_ROUGHNESS
    known = np.ones(SHAPE_ROUGHNESS, dtype=bool)
    known[100, 120] = False
    for heights, mask in ((plane, None), (plane + 5.0 * ~known, known)):  # the peak lies outside
        found = areal_roughness(heights, mask=mask, **PLAIN)
        assert found.Sdr_percent == pytest.approx(100 * (np.sqrt(1.25) - 1))
    found = areal_roughness(plane, **{**PLAIN, "form": "plane"})
    assert max(found.Sa_um, found.Sz_um, found.Sdr_percent) < 1e-6


def test_two_levels():
    """A step at a quarter: Sq, skewness and kurtosis of a coin with chances 1/4 and 3/4."""
    found = areal_roughness(np.where(SHAPE_ROUGHNESS[0] * PITCH / 4 > Y_ROUGHNESS, 0.04, 0.0), **PLAIN)
    chance = 0.25
    spread = np.sqrt(chance * (1 - chance))
    assert found.Sq_um == pytest.approx(40 * spread)
    assert found.Sa_um == pytest.approx(2 * 40 * chance * (1 - chance))
    assert found.Ssk == pytest.approx((1 - 2 * chance) / spread)
    assert found.Sku == pytest.approx(1 + (1 - 2 * chance) ** 2 / spread**2)


def test_a_wave_of_the_cutoffs_length_keeps_half_of_its_height():
    """The transmission of ISO 16610-61 is exp(-pi (alpha cutoff / length)^2); measured away from the ends."""
    wide, middle = np.tile(wave(), (1, 3)), np.s_[:, SHAPE_ROUGHNESS[1] : 2 * SHAPE_ROUGHNESS[1]]
    for cutoff_mm, passed in ((1.0, 0.5), (0.5, 0.5**0.25), (2.0, 0.5**4)):
        low = gaussian_areal_filter(wide, cutoff_mm / PITCH, np.ones(wide.shape, dtype=bool))
        assert low[middle].std() / wide[middle].std() == pytest.approx(passed, rel=2e-3)
        assert (wide - low)[middle].std() / wide[middle].std() == pytest.approx(1 - passed, rel=2e-3)


def test_against_the_standards_weights_summed_pixel_by_pixel():
    """A rough patch with an odd outline: the same figures by sums that share nothing with the code."""
    rng, shape, cutoff = np.random.default_rng(1), (34, 30), 9.0
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = 0.01 * rng.normal(size=shape) + 1e-4 * (x - 12) ** 2 + 2e-3 * y
    mask = np.hypot(x - 14, (y - 16) / 1.2) < 13
    alpha = 0.4697186
    low = np.zeros(shape)
    for row, col in zip(*np.nonzero(mask)):
        weight = np.exp(-np.pi * ((x - col) ** 2 + (y - row) ** 2) / (alpha * cutoff) ** 2) * mask
        low[row, col] = (weight * heights).sum() / weight.sum()
    residual = heights[mask] - low[mask]
    residual -= residual.mean()
    settings = {**PLAIN, "l_filter_mm": cutoff * PITCH}
    found = areal_roughness(heights, mask=mask, **settings)
    assert found.Sq_um == pytest.approx(1e3 * residual.std(), rel=1e-4)
    assert found.Sa_um == pytest.approx(1e3 * np.abs(residual).mean(), rel=1e-4)
    assert found.Sku == pytest.approx((residual**4).mean() / residual.var() ** 2, rel=1e-4)


def test_the_roughness_of_a_ball_is_that_of_its_face():
    """Form and waviness of a cap go, a fine wave on it stays."""
    cap = np.sqrt(15.0**2 - (X_ROUGHNESS - X_ROUGHNESS.mean()) ** 2 - (Y_ROUGHNESS - Y_ROUGHNESS.mean()) ** 2)
    fine = wave(0.004, 25)
    settings = {"mm_per_px": PITCH, "l_filter_mm": 2.5}
    assert areal_roughness(cap, **settings).Sq_um < 0.05 * 4 / np.sqrt(2)
    both = areal_roughness(cap + fine, **settings)
    assert both.Sq_um == pytest.approx(areal_roughness(fine, **settings).Sq_um, rel=0.02)
    assert (both.form, both.l_filter_mm) == ("quadratic", 2.5)
    assert both.s_filter_mm == pytest.approx(3 * PITCH)


def test_refused():
    for wrong, said in [
        ({"form": "cubic"}, "Expected a form among none, plane, quadratic"),
        ({"mask": np.ones((2, 2), dtype=bool)}, "Expected mask of shape"),
        ({"mask": np.zeros(SHAPE_ROUGHNESS, dtype=bool)}, "at least 100 pixels"),
        ({"s_filter_mm": 3.0, "l_filter_mm": 2.5}, "Expected the L-filter above"),
        ({"l_filter_mm": -1.0}, "l_filter_mm"),
        ({"depth_mm": np.zeros((2, *SHAPE_ROUGHNESS))}, r"shape \(H, W\)"),
    ]:
        arguments = {"depth_mm": wave(), "mm_per_px": PITCH, **wrong}
        with pytest.raises(ValueError, match=said):
            areal_roughness(arguments.pop("depth_mm"), **arguments)
