"""Forces of touches by a model that is written out: their values, their standard deviations, and each refusal."""

import json
from dataclasses import replace

import numpy as np
import pytest

from depth.force.test_touch import GRID, dotted, pressed
from gelform.depth.force.model import (
    ForceModel,
    ForcePart,
    force_from_result,
)
from gelform.depth.force.touch import Touch, touch_from_dots, touch_from_result

NORMAL = ForcePart(((2.0,),), (0.5, 10.0), 0.3, 0.4, 12)
SHEAR = ForcePart(((-1.5, 0, 0, 0, 0, 0.1), (0, -1.5, 2.0, 0, 0, 0)), (0.1, 2.0), 0.1, 0.2, 40)
TORSION = ForcePart(((0, 0, 50, 0, 0, 0),), (0.1, 5.0), 0.0, 1.0, 40)
MODEL = ForceModel(NORMAL, SHEAR, TORSION, tuple(map(tuple, GRID.tolist())), ("ball",), "a", "2026-11-26")


def test_the_forces_of_a_block_and_its_dots():
    force = force_from_result(dotted((0.4, -0.2)), MODEL)
    assert force.normal_n == pytest.approx(2.0)
    assert force.normal_sigma_n == pytest.approx(np.hypot(0.6, 0.4))
    assert force.shear_n == pytest.approx((-0.5, 0.3), abs=1e-4)
    assert force.shear_sigma_n == pytest.approx(np.hypot(0.1 * np.hypot(0.5, 0.3), 0.2), rel=1e-3)
    assert force.torsion_n_mm == pytest.approx(0, abs=1e-3)
    assert force.torsion_sigma_n_mm == pytest.approx(1)
    assert force.reason == ""


def test_sigma_has_that_of_the_volume_and_half_of_a_falling_force():
    touch = touch_from_result(pressed())
    unsure = force_from_result(replace(touch, volume_sigma_mm3=0.2), MODEL)
    assert unsure.normal_sigma_n == pytest.approx(np.sqrt(0.6**2 + 0.4**2 + 0.4**2))
    falling = force_from_result(replace(touch, falling=True), MODEL)
    assert falling.normal_sigma_n == pytest.approx(np.hypot(1.0, 0.4))


def test_torsion_is_none_of_the_volume():
    at = GRID - GRID.mean(axis=0)
    touch = touch_from_result(dotted(0.05 * at[:, ::-1] * (-1, 1)))
    for one in (touch, replace(touch, volume_sigma_mm3=0.3), replace(touch, falling=True)):
        force = force_from_result(one, replace(MODEL, torsion=replace(TORSION, relative=0.1)))
        assert force.torsion_sigma_n_mm == pytest.approx(np.hypot(0.1 * 2.5, 1.0), rel=1e-3)


def test_torsion_has_the_sign_of_the_turn():
    at = GRID - GRID.mean(axis=0)
    force = force_from_result(dotted(0.05 * at[:, ::-1] * (-1, 1)), MODEL)
    assert force.torsion_n_mm == pytest.approx(2.5, rel=1e-3)


REFUSED = {
    "soft": (pressed(outside_change=0.4), "soft"),
    "low confidence": (pressed(confidence=np.full((60, 80), 0.49, np.float32)), "confidence"),
    "an uncertain volume": (
        replace(pressed(), depth_sigma_mm=np.full((60, 80), 0.21, np.float32)),
        "uncertain",
    ),
    "at the border": (pressed(np.s_[0:10, 30:50]), "border"),
    "beyond the range": (pressed(depth_mm=3.1), "range"),
    "no contact": (pressed(depth_mm=0), "no contact"),
    "no scale": (pressed(mm_per_px=None), "scale"),
    "a zero that was set": (pressed(zero="set"), "zero"),
    "another gel": (replace(pressed(), calibration_digest="b"), "another gel"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_where_no_normal_force_is_stated(name):
    result, reason = REFUSED[name]
    force = force_from_result(result, MODEL)
    assert force.normal_n is None is force.normal_sigma_n
    assert reason in force.normal_reason
    assert force.normal_reason in force.reason


def test_just_within_the_limits_it_is_stated():
    result = pressed(depth_mm=2.9, outside_change=0.39, confidence=np.full((60, 80), 0.51, np.float32))
    assert force_from_result(result, MODEL).normal_n == pytest.approx(11.6, rel=1e-5)


@pytest.mark.parametrize(
    ("result", "reason"),
    [
        (pressed(), "no dots"),
        (dotted((0.1, 0), np.arange(len(GRID)) < 5), "few dots"),
        (dotted((2.0, 0)), "range"),
        (replace(dotted((0.1, 0)), calibration_digest="b"), "another gel"),
    ],
)
def test_where_no_shear_is_stated(result, reason):
    force = force_from_result(result, MODEL)
    assert force.shear_n is None is force.shear_sigma_n
    assert reason in force.shear_reason


def test_the_dots_of_another_gel():
    touch = touch_from_result(dotted((0.1, 0)))
    other = replace(MODEL, rest_mm=tuple(map(tuple, (GRID + 0.5).tolist())))
    assert force_from_result(touch, MODEL).shear_n is not None
    assert "another gel" in force_from_result(touch, other).torsion_reason


def test_dots_alone_tell_no_normal_force():
    touch = touch_from_dots(GRID, np.zeros((len(GRID), 3)))
    force = force_from_result(replace(touch, calibration_digest="a"), MODEL)
    assert force.normal_n is None
    assert force.shear_n == pytest.approx((0.1, 0))


@pytest.mark.parametrize("model", [None, replace(MODEL, normal=None, shear=None, torsion=None)])
def test_without_loads_nothing_is_stated(model):
    force = force_from_result(Touch(1.0, 0.9, 0.1, calibration_digest="a"), model)
    assert (force.normal_n, force.shear_n, force.torsion_n_mm) == (None, None, None)
    assert "gelform force calibrate" in force.reason
    assert force.reason.count("no loads") == 1


def test_a_model_comes_back_from_json():
    stored = json.loads(json.dumps(MODEL.to_dict()))
    assert ForceModel.from_dict(stored).to_dict() == MODEL.to_dict()
    bare = replace(MODEL, normal=None, torsion=None)
    assert ForceModel.from_dict(json.loads(json.dumps(bare.to_dict()))).to_dict() == bare.to_dict()
    assert stored["unit"] == "N"


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("unit", "g"), ("normal", {}), ("normal", {**NORMAL.__dict__, "range": [0, -1]}), ("rest_mm", [[0, float("nan")]]),
        ("shear", TORSION.__dict__), ("normal", {**NORMAL.__dict__, "floor": -1}), ("objects", [3]), ("created_utc", None),
    ],
)  # fmt: skip
def test_an_altered_model_is_refused(name, value):
    with pytest.raises((KeyError, TypeError, ValueError)):
        ForceModel.from_dict({**MODEL.to_dict(), name: value})
