"""The scale of simulated sensors from a step of a stage: within 0.6 %, and within three of its own sigmas."""

import numpy as np
import pytest

from gelform.calibration.geometry.scale_images import scale_from_stage
from gelform.errors import DataError
from gelform.simulate import LAYOUTS, Ball, Coin, Punch, simulate_background, simulate_press
from gelform.simulate.presets import gelsight_mini

SENSORS = {"three-edges": LAYOUTS["three-edges"], "gelsight-mini": gelsight_mini()}


@pytest.fixture(scope="module", params=SENSORS)
def sensor(request):
    return SENSORS[request.param]


@pytest.fixture(scope="module")
def rest(sensor):
    return simulate_background(sensor, np.random.default_rng(0))


def pressed(sensor, indenter, seed=1, **how):
    return simulate_press(sensor, indenter, rng=np.random.default_rng(seed), oversample=1, **how).image


STEP_MM = (3.5, 1.2)


@pytest.mark.parametrize(("indenter", "depth"), [(Ball(3.0), 0.5), (Coin(4.0, 0.15), 0.2), (Punch(3.0), 0.3)])
def test_a_step_tells_the_scale(sensor, rest, indenter, depth):
    first = pressed(sensor, indenter, 8, depth_mm=depth, center_mm=(-2.0, -0.5))
    second = pressed(sensor, indenter, 11, depth_mm=depth, center_mm=np.add((-2.0, -0.5), STEP_MM))
    scale = scale_from_stage(first, second, rest, float(np.hypot(*STEP_MM)))
    assert abs(scale.mm_per_px / sensor.mm_per_px - 1) < 0.006
    assert abs(scale.mm_per_px - sensor.mm_per_px) < 3 * scale.sigma
    dx, dy = (float(text) for text in scale.source.split("(")[1].split(")")[0].split(","))
    assert (dx, dy) == pytest.approx(np.array(STEP_MM) / sensor.mm_per_px, abs=0.4)


def test_no_step_and_no_one_thing_are_refused(sensor, rest):
    first = pressed(sensor, Ball(3.0), 8, depth_mm=0.5, center_mm=(-2.0, -0.5))
    with pytest.raises(DataError, match="long against its uncertainty"):
        scale_from_stage(first, first, rest, 1.0)
    with pytest.raises(DataError, match="no shift aligns"):
        scale_from_stage(first, rest, rest, 1.0)
