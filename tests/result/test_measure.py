"""Figures of an inspector against analytic surfaces, and what they say where they do not hold."""

from dataclasses import replace

import numpy as np
import pytest

import gelform
from gelform.result import Reconstruction, ShapeErrors
from gelform.result.metrics import areal_roughness

SHAPE, PITCH, SLOPE_SIGMA, GAIN = (120, 160), 0.05, 0.02, 0.03
Y, X = np.indices(SHAPE).astype(float)


def result_of(depth, *, sigma=SLOPE_SIGMA, contact=True, known=True, gain=GAIN, blur_px=0.0, scale=0.0):
    """A result of a depth map whose errors are stated; by default all of it is in contact."""
    grid = (1, SHAPE[0] // 4, SHAPE[1] // 4)
    zeros = np.zeros(grid, np.float32)
    maps = [np.broadcast_to(one, SHAPE).copy() for one in (contact, known)]
    gradients = gelform.gradients_from_depth(depth, mm_per_px=PITCH).astype(np.float32)
    return Reconstruction(
        depth=depth.astype(np.float32), depth_sigma_mm=np.full(SHAPE, 0.01, np.float32), gradients=gradients,
        gradients_sigma=np.full((*SHAPE, 2), sigma, np.float32), confidence=np.ones(SHAPE, np.float32),
        contact=maps[0], known=maps[1], mm_per_px=PITCH, mm_per_px_sigma=scale * PITCH,
        shape_errors=ShapeErrors(zeros, zeros, gain, 2.0, 0.6, blur_px),
    )  # fmt: skip


def figures(measured):
    return {f"{one.of}, {one.name}": one for one in measured.quantities}


def across(angle_deg=30.0):
    """Distance (H, W), mm, from a line through the middle; and a line across it, px, of 2 x 40 px."""
    turn = np.deg2rad(angle_deg)
    u = ((X - 80) * np.cos(turn) + (Y - 60) * np.sin(turn)) * PITCH
    reach = 40 * np.array([np.cos(turn), np.sin(turn)])
    return u, (80 - reach[0], 60 - reach[1], 80 + reach[0], 60 + reach[1])


@pytest.mark.parametrize(("sign", "name"), [(-1, "depth"), (1, "height")])
def test_a_groove_and_a_ridge_on_a_tilted_face(sign, name):
    """A trapezoid .2 mm high, .8 mm wide at half height, flanks of 45 degrees, on a face that is tilted along the line."""
    u, line = across()
    trapezoid = np.clip(0.5 - (np.abs(u) - 0.4) / 0.2, 0, 1)
    found = figures(gelform.measure(result_of(0.5 + sign * 0.2 * trapezoid + 0.02 * u), lines=[line]))
    assert found["line 1, length"].value == pytest.approx(80 * PITCH)
    assert found["line 1, rise"].value == pytest.approx(0.02 * 4, abs=1e-4)
    assert found[f"line 1, {name}"].value == pytest.approx(0.2, abs=0.002)
    assert found["line 1, width"].value == pytest.approx(0.8, abs=0.01)
    for side in ("left", "right"):
        tilt = np.rad2deg(np.arctan(0.02))
        assert found[f"line 1, {side} flank"].value == pytest.approx(45, abs=2 + tilt)
    assert all(one.sigma > 0 for one in found.values() if one.name != "length")
    assert not any(one.doubts for one in found.values())


def test_a_rounded_groove_has_the_depth_of_its_deepest_point():
    u, line = across(0.0)
    depth = 0.6 - np.sqrt(np.maximum(0.5**2 - u**2, 0)) * 0.4
    found = figures(gelform.measure(result_of(depth), lines=[line]))
    assert found["line 1, depth"].value == pytest.approx(0.2, abs=0.002)


def test_a_line_that_is_not_perpendicular_says_how_much_too_wide():
    u, line = across(0.0)
    shape = result_of(0.2 * np.clip(0.5 - (np.abs(u) - 0.5) / 0.2, 0, 1), sigma=1e-4, gain=0.0)
    turn = np.deg2rad(30)
    slanted = (80 - 45 * np.cos(turn), 60 - 45 * np.sin(turn), 80 + 45 * np.cos(turn), 60 + 45 * np.sin(turn))
    straight, found = (figures(gelform.measure(shape, lines=[one])) for one in (line, slanted))
    width = found["line 1, width"]
    assert width.value * np.cos(turn) == pytest.approx(straight["line 1, width"].value, rel=0.01)
    (said,) = width.doubts
    assert said.startswith("The line is 30° off perpendicular")


def test_a_groove_that_nothing_touches_in_its_middle_is_deeper():
    u, line = across(0.0)
    contact = np.abs(u) > 0.3
    found = figures(gelform.measure(result_of(-0.1 * np.exp(-(u**2) / 0.05), contact=contact), lines=[line]))
    (said,) = found["line 1, depth"].doubts
    assert said.startswith("Nothing touches its middle")


@pytest.mark.parametrize("depth", [np.zeros(SHAPE), 0.01 * X, np.tanh((X - 80) / 10)])
def test_without_both_shoulders_there_is_no_groove(depth):
    found = figures(gelform.measure(result_of(depth), lines=[(40, 60, 120, 60)]))
    missing = found["line 1, depth"]
    assert missing.value is missing.sigma is None
    assert "shoulder" in missing.doubts[0]
    assert found["line 1, rise"].value == pytest.approx(depth[60, 120] - depth[60, 40], abs=1e-6)


def test_a_step_and_the_angle_between_two_faces():
    """A roof of 120 degrees; and a step of .15 mm, whose faces are parallel."""
    slope = 1 / np.tan(np.deg2rad(60))
    roof, boxes = 2.0 - np.abs(X - 80) * PITCH * slope, [(40, 30, 70, 90), (90, 30, 120, 90)]
    found = figures(gelform.measure(result_of(roof), regions=boxes))
    angle = found["region 2 - region 1, angle"]
    assert angle.value == pytest.approx(120, abs=0.01)
    step = figures(gelform.measure(result_of(0.15 * (X > 80)), regions=boxes))["region 2 - region 1, step"]
    assert step.value == pytest.approx(0.15, abs=1e-6)
    assert step.sigma == pytest.approx(np.hypot(0.15 * GAIN, 0.001), abs=0.0015)
    assert step.sigma > 0.15 * GAIN


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("kind", ["ball", "cylinder"])
def test_the_radius_of_a_ball_and_of_a_tilted_cylinder(kind, sign):
    u, _ = across(25.0)
    if kind == "ball":
        square = ((X - 75) ** 2 + (Y - 62) ** 2) * PITCH**2
        depth = np.sqrt(3.0**2 - np.minimum(square, 8)) - 2.5
    else:  # rising by .1 along its axis, so the section across it in the image is an ellipse
        along = (-(X - 80) * np.sin(np.deg2rad(25)) + (Y - 60) * np.cos(np.deg2rad(25))) * PITCH
        depth = np.sqrt(3.0**2 - np.minimum(u**2, 8)) * np.hypot(1, 0.1) + 0.1 * along - 2.5
    found = figures(gelform.measure(result_of(sign * depth), regions=[(60, 45, 95, 80)], radius=kind))
    radius = found[f"region 1, {kind} radius"]
    assert radius.value == pytest.approx(3.0, rel=1e-3)
    assert radius.sigma > 3.0 * GAIN * 0.9
    other = {"ball": "cylinder", "cylinder": "ball"}[kind]
    doubted = figures(gelform.measure(result_of(sign * depth), regions=[(60, 45, 95, 80)], radius=other))
    assert "more than its errors explain" in doubted[f"region 1, {other} radius"].doubts[0]


def test_a_flat_face_is_as_flat_as_its_errors_let_see():
    rng = np.random.default_rng(2)
    slopes = rng.normal(0, SLOPE_SIGMA, (*SHAPE, 2)).astype(np.float32)
    noise = gelform.depth_from_gradients(slopes, mm_per_px=PITCH)
    found = figures(gelform.measure(result_of(0.3 + 0.1 * X * PITCH + noise), regions=[(30, 30, 110, 90)]))
    flat = found["region 1, flatness"]
    assert flat.value <= 2 * flat.sigma, "0 is within two deviations"
    assert "Errors alone give" in flat.doubts[0]
    wavy = result_of(0.3 + 0.05 * np.sin(X / 5), sigma=1e-3)
    rough = figures(gelform.measure(wavy, regions=[(30, 30, 110, 90)]))
    assert rough["region 1, flatness"].value == pytest.approx(100, rel=0.05)
    assert rough["region 1, flatness"].sigma < 5
    mask = (np.abs(X - 70) <= 40) & (np.abs(Y - 60) <= 30)
    assert rough["region 1, Sq"].value == areal_roughness(wavy.depth_mm, mm_per_px=PITCH, mask=mask).Sq_um


def test_scale_blur_and_gain_widen_what_they_concern():
    u, line = across(0.0)
    depth = 0.2 * np.exp(-(u**2) / 0.02)
    plain, scaled, blurred, unsure = (
        figures(gelform.measure(result_of(depth, sigma=1e-4, **how), lines=[line]))
        for how in (
            {"gain": 0.0},
            {"gain": 0.0, "scale": 0.02},
            {"gain": 0.0, "blur_px": 1.25},
            {"gain": 0.1},
        )
    )
    of = "line 1, height"
    assert scaled[of].sigma == pytest.approx(0.02 * plain[of].value, rel=0.05)
    assert scaled["line 1, left flank"].sigma == plain["line 1, left flank"].sigma
    assert unsure[of].sigma == pytest.approx(0.1 * plain[of].value, rel=0.05)
    lost = 1 - 1 / np.sqrt(1 + 2 * 2 * 1.25**2 * PITCH**2 / 0.02)  # a Gaussian, blurred by sqrt(2) 1.25 px
    assert blurred[of].sigma == pytest.approx(lost * plain[of].value, rel=0.15)
    assert "as narrow as the image is sharp" in blurred[of].doubts[0]
    fine, lost = 0.01 * np.sin(X / 2), 1 - np.exp(-(1.25**2) / 4)  # of a wave of 4 pi px
    plain, blurred = (
        figures(
            gelform.measure(result_of(fine, sigma=1e-5, gain=0.0, blur_px=px), regions=[(30, 30, 110, 90)])
        )
        for px in (0.0, 1.25)
    )
    assert plain["region 1, Sq"].sigma < 0.05 * plain["region 1, Sq"].value
    assert blurred["region 1, Sq"].sigma == pytest.approx(lost * plain["region 1, Sq"].value, rel=0.1)


def test_without_regions_and_lines_the_contact_is_measured():
    contact = np.hypot(X - 70, Y - 60) < 25
    result = result_of(0.2 * contact, contact=contact)
    (of,) = {one.of for one in gelform.measure(result).quantities}
    assert of == "contact"
    assert gelform.measure(replace(result, contact=np.zeros(SHAPE, bool))).quantities == ()


def test_figures_without_a_known_sigma():
    bare = replace(
        result_of(0.1 * X), mm_per_px_sigma=None, shape_errors=None, gradients_sigma=None, depth_sigma_mm=None
    )
    found = gelform.measure(bare, lines=[(10, 10, 60, 10)], regions=[(10, 10, 40, 40), (60, 10, 90, 40)])
    assert {one.sigma for one in found.quantities} == {None}


def test_steep_and_unknown_pixels_are_doubted():
    u, line = across(0.0)
    depth = 0.2 * np.clip(0.5 - (np.abs(u) - 0.4) / 0.2, 0, 1)
    steep = figures(gelform.measure(result_of(depth, sigma=0.4), lines=[line]))
    assert "steeper than presses have shown" in steep["line 1, left flank"].doubts[0]
    unknown = figures(gelform.measure(result_of(depth, known=X > 50), lines=[line]))
    assert any("not known on 1" in said for said in unknown["line 1, height"].doubts)
    assert "not known on" in unknown["line 1, rise"].doubts[0]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"lines": [(1, 2, 3)]}, "4 finite numbers"),
        ({"lines": [(1, 2, 1, 3)]}, "at least 2 px"),
        ({"lines": [(1, 2, 500, 3)]}, "in pixels of the image, 0-159 and 0-119, got 1,2,500,3"),
        ({"regions": [(1, 2, 1, 3)]}, "at least 10 known pixels"),
        ({"regions": [np.zeros((3, 3), bool)]}, "region"),
        ({"regions": [(1, 2, 30, 30)], "radius": "cone"}, "ball"),
    ],
)
def test_what_cannot_be_measured_is_refused(given, said):
    with pytest.raises(ValueError, match=said):
        gelform.measure(result_of(0.1 * X), **given)


def test_results_without_a_scale_are_refused():
    bare = replace(result_of(0.1 * X), mm_per_px=None, mm_per_px_sigma=None)
    with pytest.raises(gelform.GelformError, match="scale"):
        gelform.measure(bare)
    with pytest.raises(gelform.GelformError, match="square pixels"):
        gelform.measure(replace(result_of(0.1 * X), mm_per_px=(0.05, 0.06)))
