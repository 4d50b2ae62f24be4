"""The design study: light quality against analysis, and designs that are plainly worse."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gelform.calibration.design import (
    VARIATIONS,
    Variation,
    _summed,
    compare_designs,
    design_picture,
    light_quality,
)
from gelform.errors import CalibrationError, SensorError
from gelform.sensors import read_simulated_sensor
from gelform.simulate import LAYOUTS, Led, SimulatedSensor, simulate_background

PAGE = Path(__file__).parents[2] / "docs/simulator.md"

FAR = 1e6
TILT = np.deg2rad(40)


@pytest.fixture(scope="module")
def study():
    """Results of a sensor as given and with eight times the noise, and the progress that was reported."""
    calls = []
    results = compare_designs(
        replace(LAYOUTS["ring-120"], shape=(60, 80), mm_per_px=0.25),
        [Variation("as given"), Variation("eight times the noise", noise=8)],
        presses=6,
        tests=4,
        halved=False,
        progress=lambda *call: calls.append(call[:2]),
    )
    return results, calls


def far_lights(angles_deg, noise_sd=1.0):
    """Distant lights 40 degrees from the view axis, one per channel, level 100 on the flat gel."""
    leds = []
    for c, angle in enumerate(np.deg2rad(angles_deg)):
        place = FAR * np.array([np.sin(TILT) * np.cos(angle), np.sin(TILT) * np.sin(angle), np.cos(TILT)])
        color = tuple(float(v) for v in 100 * FAR**2 / np.cos(TILT) * np.eye(3)[c])
        leds.append(Led(tuple(float(v) for v in place), color))
    return SimulatedSensor(tuple(leds), shape=(12, 16), mm_per_px=0.5, noise_sd=noise_sd)


@pytest.mark.parametrize("noise_sd", [1.0, 4.0])
def test_three_even_lights_have_condition_one_and_the_slope_noise_of_the_formula(noise_sd):
    condition, sigma = light_quality(far_lights((0, 120, 240), noise_sd))
    np.testing.assert_allclose(condition, 1, rtol=1e-4)
    # level = 100 (1 - p tan cos a - q tan sin a): J^T J = (100 tan)^2 3/2 1, the camera's noise and rounding
    expected = np.sqrt(noise_sd**2 + 1 / 12) / (100 * np.tan(TILT) * np.sqrt(1.5))
    np.testing.assert_allclose(sigma, expected, rtol=1e-4)


def test_lights_from_one_side_are_badly_conditioned():
    even, _ = light_quality(far_lights((0, 120, 240)))
    narrow, _ = light_quality(far_lights((0, 20, 40)))
    assert narrow.min() > 2 * even.max()
    blind, _ = light_quality(far_lights((0, 0, 180)))
    assert blind.min() > 1e3


def test_a_variation_changes_what_it_says_and_keeps_the_levels():
    sensor = LAYOUTS["three-edges"]
    design = Variation("x", led_height=2, led_distance=0.9, noise=3, crosstalk=0, relaxation=2).of(sensor)
    x, y, z = sensor.leds[0].position_mm
    assert design.leds[0].position_mm == pytest.approx((0.9 * x, 0.9 * y, 2 * z))
    assert design.noise_sd == 3 * sensor.noise_sd
    assert design.noise_gain == pytest.approx(9 * sensor.noise_gain)
    np.testing.assert_array_equal(design.crosstalk, np.diag(np.diag(sensor.crosstalk)))
    assert design.relaxation_mm == 2 * sensor.relaxation_mm
    levels = [simulate_background(one, None, quantise=False).mean((0, 1)) for one in (sensor, design)]
    np.testing.assert_allclose(levels[1], levels[0], rtol=1e-6)


def test_white_lights_are_blind_and_half_white_ones_see_less():
    sensor = far_lights((0, 120, 240))
    conditions, sigmas = zip(*(light_quality(Variation("x", whiteness=w).of(sensor)) for w in (0, 0.5, 1)))
    np.testing.assert_allclose(conditions[:2], 1, rtol=1e-3)
    assert np.all(sigmas[1] > 1.5 * sigmas[0])
    assert sigmas[2].min() > 100 * sigmas[0].max()


def test_errors_are_mapped_where_they_are():
    where = np.array([[0, 0], [0, 5], [59, 79], [31, 70]])  # row, column
    depth = np.array([0.001, 0.001, 0.003, 0.002])
    total, _, found, angle = _summed([(where, depth, np.array([1.0, 2.0, 3.0, 6.0]))], (60, 80))
    assert found[0, 0] == pytest.approx(1.0)
    assert found[5, 7] == pytest.approx(3.0)
    assert found[3, 7] == pytest.approx(2.0)
    assert np.count_nonzero(~np.isnan(found)) == 3
    assert total == pytest.approx(1000 * np.sqrt(np.mean(depth**2)))
    assert angle == 3.0


def test_much_noise_is_found_to_be_worse(study):
    (good, bad), calls = study
    assert good.normal_deg < bad.normal_deg
    assert np.median(bad.slope_sigma) > 7 * np.median(good.slope_sigma)
    assert 0 < good.depth_rmse_um < 200
    assert 0 < good.depth_rmse_se_um < good.depth_rmse_um
    assert np.nanmax(good.depth_map_um) > good.depth_rmse_um > np.nanmin(good.depth_map_um)
    assert calls == [(0, 2), (1, 2), (2, 2)]


def test_a_study_can_be_drawn(study):
    pytest.importorskip("matplotlib")
    results, _ = study
    picture = design_picture(results)
    assert (picture.dtype, picture.shape[2]) == (np.uint8, 3)
    assert picture.std() > 20
    assert design_picture(results[:1]).shape[1] < picture.shape[1]


def test_bad_studies_are_refused():
    for make, message in (
        (lambda: Variation("x", led_height=0), "led_height"),
        (lambda: Variation("x", noise=-1), "noise"),
        (lambda: Variation("x", whiteness=2), "whiteness in 0-1"),
        (lambda: compare_designs(LAYOUTS["ring-120"], [], presses=8), "a variation"),
        (lambda: compare_designs(LAYOUTS["ring-120"], presses=2), "presses >= 4"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


@pytest.mark.slow
def test_the_sensor_of_the_documentation_can_be_studied(tmp_path):
    (tmp_path / "mine.toml").write_text(re.search(r"```toml\n(.*?)```", PAGE.read_text(), re.DOTALL)[1])
    sensor = read_simulated_sensor(tmp_path / "mine.toml")
    height, width = sensor.shape
    small = replace(sensor, shape=(height // 3, width // 3), mm_per_px=3 * sensor.mm_per_px)
    # few and coarse: that each can be made is the question
    results = compare_designs(small, presses=8, tests=2)
    assert [result.name for result in results] == [variation.name for variation in VARIATIONS]
    assert max(result.depth_rmse_um for result in results) < 800


@pytest.mark.parametrize(
    ("color", "error", "message"),
    [
        ((900.0, 20.0, 0.0), SensorError, "'no crosstalk' cannot be made. Expected light in every channel"),
        ((900.0, 900.0, 900.0), CalibrationError, "got 'no crosstalk', .*three colors from three sides"),
    ],
)
def test_a_design_that_shows_no_slopes_is_refused_by_name(color, error, message):
    ring = replace(LAYOUTS["ring-120"], shape=(60, 80), mm_per_px=0.25)
    one_light = replace(ring, leds=(replace(ring.leds[0], color=color),))
    with pytest.raises(error, match=message):
        compare_designs(one_light, [Variation("no crosstalk", crosstalk=0)], presses=6, tests=1, halved=False)
