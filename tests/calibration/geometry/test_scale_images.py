"""The scale of simulated sensors from pressed things: within about 1 %, and within three of its own sigmas."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.geometry.scale_images import scale_from_punch, scale_from_stage, scale_from_thread
from gelform.errors import DataError
from gelform.simulate import LAYOUTS, Ball, BoxEdge, Coin, Punch, Screw, simulate_background, simulate_press
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


def holds(scale, truth, within=0.01):
    assert abs(scale.mm_per_px / truth - 1) < within
    assert abs(scale.mm_per_px - truth) < 3 * scale.sigma
    assert 0.001 < scale.sigma / scale.mm_per_px < 0.015


@pytest.mark.parametrize(
    ("diameter", "depth", "center"), [(5.0, 0.4, (0.3, -0.4)), (7.0, 0.3, (0, 0.2)), (4.0, 0.6, (1.5, 1))]
)
def test_a_punch_tells_the_scale(sensor, rest, diameter, depth, center):
    image = pressed(sensor, Punch(diameter), depth_mm=depth, center_mm=center)
    scale = scale_from_punch(image, rest, diameter)
    holds(scale, sensor.mm_per_px)
    assert f"a punch of {diameter:g} mm" in scale.source


@pytest.mark.parametrize(
    ("screw", "spin", "depth"),
    [(Screw(8, 1.25, 30), 0, 0.4), (Screw(6, 1.0, 30), 20, 0.4), (Screw(4, 0.7, 30), 75, 0.25)],
)
def test_a_thread_tells_the_scale(sensor, rest, screw, spin, depth):
    image = pressed(sensor, screw, depth_mm=depth, spin_deg=spin)
    scale = scale_from_thread(image, rest, screw.pitch_mm)
    holds(scale, sensor.mm_per_px)


def test_the_helix_is_reckoned_with():
    """Coarse, thin screws: crests that lean by 7 degrees lie 0.8 % closer than their pitch along the screw."""
    sensor = replace(LAYOUTS["three-edges"], noise_sd=0.5)
    rest = simulate_background(sensor, np.random.default_rng(0))
    for spin in (0, 30):
        image = pressed(sensor, Screw(4.0, 1.6, 30), depth_mm=0.3, spin_deg=spin)
        assert abs(scale_from_thread(image, rest, 1.6).mm_per_px / sensor.mm_per_px - 1) < 0.005


def test_another_exposure_is_the_same_scale(sensor, rest):
    image = pressed(sensor, Punch(5.0), depth_mm=0.4)
    brighter = np.clip(np.rint(image * 1.07), 0, 255).astype(np.uint8)
    a, b = (scale_from_punch(one, rest, 5.0).mm_per_px for one in (image, brighter))
    assert b == pytest.approx(a, rel=0.002)


def test_what_is_no_punch_is_refused(sensor, rest):
    with pytest.raises(DataError, match="hardly changes"):
        scale_from_punch(rest, rest, 5.0)
    bar = pressed(sensor, Punch(7.0, 2.5), depth_mm=0.4)
    with pytest.raises(DataError, match=r"px off a circle"):
        scale_from_punch(bar, rest, 5.0)


def test_what_is_no_thread_is_refused(sensor, rest):
    for thing, depth in ((Ball(3.0), 0.5), (BoxEdge(8.0), 0.4)):
        with pytest.raises(DataError, match=r"no wave stands out|lies across"):
            scale_from_thread(pressed(sensor, thing, depth_mm=depth), rest, 1.0)


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
