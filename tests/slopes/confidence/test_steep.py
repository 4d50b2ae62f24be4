"""Steep slopes that presses have not shown: never sure, on a unit's own calibration and on one of other units."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import edges_of_cube
import gelform
from gelform.calibration.starters import load_starter
from gelform.simulate import Ball, simulate_press
from gelform.slopes.confidence import SteepSlopes, all_shown, steep, with_steep
from gelform.slopes.confidence.slope_sigma import SlopeSigma
from gelform.slopes.confidence.steep import PER_EXCESS, STEEPEST_FACE
from gelform.slopes.gradients import STEEPEST_GEL
from kernel_agreement import assert_kernel_agrees

CLEAN = 0.05
SHOWN = SlopeSigma(
    0.01, (0.1, 0.2, 0.3, 0.4, 0.5), (0.02,) * 5, CLEAN, 8.0
)  # their 0.4 quantile is 0.26, their upper quartile 0.4


def along(slopes):
    """Slopes (1, N, 2) of these sizes, in directions all around."""
    turn = np.arange(len(slopes))
    return np.stack([slopes * np.cos(turn), slopes * np.sin(turn)], axis=-1).astype(np.float32)[None]


def deviations(slopes, carried):
    row = np.full((1, len(slopes)), 0.02, np.float32)
    found = SteepSlopes(SHOWN, carried)(along(np.array(slopes)), row, np.ones_like(row))
    return [one[0] for one in found]


def test_a_unit_s_own_slopes_are_known_up_to_the_upper_quartile():
    found, confidence = deviations([0.0, 0.3, 0.4, 0.5, 0.6], carried=0.0)
    np.testing.assert_allclose(found, PER_EXCESS * np.array([0, 0, 0, 0.1, 0.2]), atol=1e-6)
    np.testing.assert_array_equal(confidence[:3], 1)
    np.testing.assert_allclose(confidence[3:], CLEAN**2 / (0.02**2 + found[3:] ** 2), rtol=1e-5)


def test_two_sigma_of_another_unit_s_slopes_reach_the_steepest_face():
    slopes = np.array([0.26, 0.35, 0.4])
    found, confidence = deviations(slopes, carried=1.0)
    np.testing.assert_allclose(slopes + 2 * found, STEEPEST_FACE, rtol=1e-5)
    assert confidence.max() < 0.3, "never sure"
    gentle, sure = deviations([0.0, 0.1, 0.26 - CLEAN], carried=1.0)
    np.testing.assert_allclose(gentle, 0, atol=1e-6)
    np.testing.assert_allclose(sure, 1, rtol=1e-6)


def test_both_kinds_of_ignorance_add_up_and_are_bounded():
    (own,), (other,), (both,) = (deviations([0.8], carried)[0] for carried in (0.0, 1.0, 1.0))
    assert both == other == pytest.approx(np.hypot(own, (STEEPEST_FACE - 0.8) / 2), rel=1e-5)
    assert deviations([50.0], 0.0)[0] == STEEPEST_GEL


def test_confidence_is_never_raised():
    row = np.full((1, 3), 0.02, np.float32)
    low = np.float32([[0.9, 0.2, 0.0]])
    assert (SteepSlopes(SHOWN, 1.0)(along(np.array([0.1, 0.1, 0.1])), row, low)[1] == low).all()
    nothing, same = all_shown(along(np.array([0.9, 2.0, 0.0])), row, low)
    assert not nothing.any()
    assert same is low


def test_it_is_added_in_squares_to_one_map_or_two():
    sigma, more = np.full((2, 3), 3.0, np.float32), np.full((2, 3), 4.0, np.float32)
    np.testing.assert_allclose(with_steep(sigma, more), 5)
    np.testing.assert_allclose(with_steep(np.dstack([sigma, 0 * sigma]), more), np.dstack([sigma + 2, more]))
    assert with_steep(None, more) is None


def numpy_steep_sigma(
    gradients,
    sigma,
    confidence,
    out,
    stated,
    upper,
    per_excess,
    doubted,
    steepest,
    carried,
    most,
    full_confidence_sigma,
):
    slope = np.linalg.norm(gradients.astype(float), axis=-1)
    own = per_excess * np.maximum(slope - upper, 0)
    other = (
        carried
        * np.clip((slope - doubted) / full_confidence_sigma + 1, 0, 1)
        * np.maximum(steepest - slope, 0)
    )
    found = np.where(sigma < most, np.minimum(np.hypot(own, other), most), 0)
    return found, np.minimum(confidence, full_confidence_sigma**2 / (sigma.astype(float) ** 2 + found**2))


def test_the_kernel_agrees_with_numpy():
    rng = np.random.default_rng(0)
    gradients = rng.normal(0, 0.6, (7, 37, 2)).astype(np.float32)
    sigma, confidence = (rng.uniform(low, 1.2, (7, 37)).astype(np.float32) for low in (0.01, 0))
    numbers = 0.4, PER_EXCESS, 0.3, STEEPEST_FACE, 0.5, 1.0, CLEAN
    maps = gradients, sigma, confidence, np.empty_like(sigma), np.empty_like(sigma)
    assert_kernel_agrees(steep._steep_sigma, numpy_steep_sigma, *maps, *numbers)


def test_what_presses_have_shown_follows_from_the_law():
    """Slopes twice as steep, doubts from twice as steep on."""
    wider = replace(SHOWN, slopes=tuple(2 * one for one in SHOWN.slopes))
    row = np.full((1, 2), 0.02, np.float32)
    found = SteepSlopes(wider)(along(np.array([0.8, 0.9])), row, np.ones_like(row))[0]
    np.testing.assert_allclose(found, [[0, 0.1 * PER_EXCESS]], atol=1e-6)


def starter_of(calibration):
    """The same calibration as one of other units."""
    made = {"sensor": "x", "spread": 0.0, "units": ["others"], "findings": []}
    return replace(calibration, settings=replace(calibration.settings, starter=made))


def test_depth_contact_and_slopes_stay_the_same(calibration, sensor):
    """What is stated changes alone: the solver's weights and the contacts are without it."""
    image = simulate_press(sensor, Ball(3.0), depth_mm=0.8, rng=np.random.default_rng(1)).image
    reconstruct = gelform.Reconstructor(starter_of(calibration))
    without = copy(reconstruct)
    without.steep_slopes = all_shown
    doubted, plain = reconstruct.from_image(image), without.from_image(image)
    for name in ("depth", "gradients", "observed_gradients", "contact", "known"):
        np.testing.assert_array_equal(getattr(doubted, name), getattr(plain, name), err_msg=name)
    steeper = np.linalg.norm(plain.gradients, axis=-1) > np.median(calibration.slope_sigma.slopes) + 0.05
    assert steeper.sum() > 100
    assert doubted.confidence[steeper].max() < 0.3 < np.median(plain.confidence[steeper])
    assert (doubted.gradients_sigma > plain.gradients_sigma)[steeper].all()
    top = plain.depth_mm.argmax()
    assert doubted.depth_sigma_mm.flat[top] > 2 * plain.depth_sigma_mm.flat[top]
    found = {one.name: one for one in doubted.health}
    assert "steep" in found
    assert f"at least {plain.peak_mm:.2f} mm" in found["steep"].message
    assert "steep" not in {one.name for one in plain.health}
    assert "steep" in {one.name for one in reconstruct.explain(image).findings}


def test_a_ball_on_its_own_unit_is_not_called_steep(calibration, sensor):
    image = simulate_press(sensor, Ball(4.0), depth_mm=0.5, rng=np.random.default_rng(2)).image
    reconstruct = gelform.Reconstructor(calibration)
    assert "steep" not in {one.name for one in reconstruct.from_image(image).health}
    assert "steep" not in {one.name for one in reconstruct.explain(image).findings}


@pytest.mark.slow
def test_the_faces_of_a_cube_are_never_sure_by_a_starter(data):
    """They stand at some 45 degrees and are read at half of that; the edge is as much too low."""
    background, images = edges_of_cube.frames()
    calibration = load_starter("gelsight-mini").for_unit(background)
    reconstruct, pitch = gelform.Reconstructor(calibration), calibration.known_mm_per_px
    rows = []
    for name in ("0.png", "24.png", "50.png"):
        result = reconstruct.from_image(images[name])
        edge = edges_of_cube.edge_in(result.gradients, pitch)
        error = edges_of_cube.crest_error_mm(edge, result.depth_mm, pitch)
        assert error > 0.2
        assert error < 2.5 * result.depth_sigma_mm[edge.crest].mean()
        assert "steep" in {one.name for one in result.health}
        for face, true in zip(edge.faces, edge.true_gradients):
            off = np.abs((result.gradients[face] - true) @ edge.across)
            assert np.median(off) > 0.2
            rows.append(
                [
                    (off < 2 * result.gradients_sigma[face][:, 0]).mean(),
                    (result.confidence[face] > 0.3).mean(),
                ]
            )
    within, sure = np.mean(rows, axis=0)
    assert within > 0.85
    assert sure < 0.15
