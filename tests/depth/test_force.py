"""The numbers of a touch: its volume, its place, and the motion of the dots, on maps and motions that are written out.
Forces of touches by a model that is written out: their values, their standard deviations, and each refusal. Models
fitted to touches whose forces are written out, what is refused, and the real recordings of dots.
"""

import json
import re
from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelform
from gelform.depth.force import (
    DotMotion,
    Dots,
    ForceModel,
    ForcePart,
    Load,
    Touch,
    calibrate_force,
    evaluate_force,
    force_from_result,
    touch_from_dots,
    touch_from_result,
    touches_in_order,
)
from gelform.errors import DataError
from gelform.image.markers import MarkerFlow
from gelform.result import Reconstruction

pytestmark = pytest.mark.linear_algebra

SHAPE, PITCH = (60, 80), 0.1
GRID = np.stack(np.meshgrid(np.arange(6.0), np.arange(5.0)), axis=-1).reshape(-1, 2) * 1.2 + 0.8
STILL = DotMotion(0, 0, 0, 0, 0)


def pressed(where=np.s_[20:30, 30:50], depth_mm=0.5, **known):
    """A block, pressed into the gel."""
    depth = np.zeros(SHAPE, dtype=np.float32)
    depth[where] = depth_mm
    gradients = np.zeros((*SHAPE, 2), dtype=np.float32)
    more = {"confidence": np.full(SHAPE, 0.8, np.float32), "outside_change": 0.1, "mm_per_px": PITCH} | known
    return Reconstruction(
        depth=depth, depth_sigma_mm=None, gradients=gradients, gradients_sigma=None, contact=depth > 0,
        known=np.ones(SHAPE, dtype=bool), calibration_digest="a", **more,
    )  # fmt: skip


def dotted(moved_mm, seen=None, **known):
    """The block beside a grid of dots that moved."""
    rest = (GRID / PITCH).astype(np.float32)
    seen = np.ones(len(GRID), dtype=bool) if seen is None else seen
    now = (rest + np.asarray(moved_mm) / PITCH).astype(np.float32)
    flow = MarkerFlow(rest, now, seen, np.full(len(GRID), 0.1, np.float32), PITCH)
    return pressed(markers=flow, **known)


def test_the_volume_of_a_block():
    touch = touch_from_result(pressed())
    assert touch.volume_mm3 == pytest.approx(1.0 * 2.0 * 0.5, rel=1e-6)
    assert touch.confidence == pytest.approx(0.8)
    assert (touch.outside_change, touch.border_share, touch.calibration_digest) == (0.1, 0, "a")
    assert touch.dots is None is touch.rest_mm
    uneven = pressed(mm_per_px=(0.1, 0.2))
    uneven.depth[:10] = -0.3  # outside the contact
    assert touch_from_result(uneven).volume_mm3 == pytest.approx(2.0, rel=1e-6)


def test_a_volume_is_as_uncertain_as_its_depth():
    """Whose deviation has what depth below 0 shows beside the contact."""
    sigma = np.full(SHAPE, 0.03, np.float32)
    sigma[20:30, 30:50] = 0.1
    stated = replace(pressed(), depth_sigma_mm=sigma)
    stated.depth[~stated.contact] = -0.2
    assert touch_from_result(stated).volume_sigma_mm3 == pytest.approx(0.1 * 2, rel=1e-5)
    assert touch_from_result(pressed()).volume_sigma_mm3 == 0, "nothing is stated of the depth"


def test_a_force_falls_from_a_tenth_below_the_largest_volume_of_a_contact():
    touches = [Touch(volume_mm3=volume) for volume in (0, 1, 2, 1.9, 1.7, 0, 1, None, 0.5)]
    falling = [touch.falling for touch in touches_in_order(touches)]
    assert falling == [False, False, False, False, True, False, False, False, False]


def test_the_part_of_a_contact_at_the_border():
    assert touch_from_result(pressed(np.s_[0:20, 30:50])).border_share == pytest.approx(2 / 20)
    assert touch_from_result(pressed(np.s_[20:30, -1:])).border_share == 1
    assert touch_from_result(pressed(np.s_[2:58, 2:78])).border_share == 0


def test_dots_that_turn_slide_and_tilt():
    angle, middle = 0.02, GRID.mean(axis=0)
    at = GRID - middle
    turned = at @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) - at
    moved = np.column_stack([turned + np.array([0.3, -0.2]), 0.1 + at @ (0.05, -0.04)])
    motion = touch_from_dots(GRID, moved).dots
    assert motion == pytest.approx((0.3, -0.2, np.sin(angle), 0.05, -0.04), abs=1e-12)
    flat = touch_from_dots(np.column_stack([GRID, 0 * at[:, 0]]), moved[:, :2])
    assert flat.dots == pytest.approx((0.3, -0.2, np.sin(angle), 0, 0), abs=1e-12)
    np.testing.assert_array_equal(flat.rest_mm, GRID)


def test_the_dots_of_a_result_rise_with_its_depth():
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32) * PITCH
    result = dotted((0.3, -0.2))
    result.depth[:] = 0.03 * x - 0.02 * y
    motion = touch_from_result(result).dots
    assert motion == pytest.approx((0.3, -0.2, 0, 0.03, -0.02), abs=1e-4)


def test_unseen_dots_do_not_count_and_too_few_say_nothing():
    seen = np.arange(len(GRID)) % 2 == 0
    moved = np.where(seen[:, None], (0.3, -0.2), (9.0, 9.0))
    assert touch_from_result(dotted(moved, seen)).dots[:2] == pytest.approx((0.3, -0.2), abs=1e-5)
    few = touch_from_result(dotted(moved, np.arange(len(GRID)) < 4))
    assert few.dots is None
    assert few.rest_mm.shape == GRID.shape


@pytest.mark.parametrize(
    ("rest", "same"),
    [(GRID + 0.05, True), (GRID[3:], True), (GRID + 0.5, False), (GRID * 1.4, False), (GRID[:10], False)],
)
def test_the_same_dots_and_others(rest, same):
    assert (Dots(GRID).why_none(Touch(rest_mm=rest, dots=STILL)) == "") is same


@pytest.mark.parametrize(
    ("rest", "moved"), [(GRID, GRID[:4]), (GRID[:2], GRID[:2]), (GRID[:6], GRID[:6]), (GRID[0], GRID[0])]
)
def test_dots_that_tell_no_motion(rest, moved):
    with pytest.raises(ValueError, match="Expected"):
        gelform.touch_from_dots(rest, moved)


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
        assert force.torsion_n_mm == pytest.approx(2.5, rel=1e-3), "with the sign of the turn"
        assert force.torsion_sigma_n_mm == pytest.approx(np.hypot(0.1 * 2.5, 1.0), rel=1e-3)


REFUSED = [
    (
        "normal",
        pressed(outside_change=0.3, inside_change=0.1),
        "a soft object: .* by 0.30 of the 0.100 inside",
    ),
    ("normal", pressed(outside_change=0.6, inside_change=0.03), "a light and wide contact: .* Press harder"),
    ("normal", pressed(outside_change=None, inside_change=0.1), "cut by the view"),
    ("normal", pressed(outside_change=None), "no contact"),
    ("normal", pressed(confidence=np.full(SHAPE, 0.49, np.float32)), "in the contact is 0.49"),
    ("normal", replace(pressed(), depth_sigma_mm=np.full(SHAPE, 0.21, np.float32)), "is 42 % of it"),
    ("normal", pressed(np.s_[0:10, 30:50]), "cut by the view: .* % of it lies at the border"),
    ("normal", pressed(depth_mm=3.1), "beyond the calibrated range"),
    ("normal", pressed(depth_mm=0), "no contact"),
    ("normal", pressed(mm_per_px=None), "no scale"),
    ("normal", pressed(zero="set"), "a zero that was set"),
    ("normal", replace(pressed(), calibration_digest="b"), "another gel"),
    ("shear", pressed(), "no dots"),
    ("shear", dotted((0.1, 0), np.arange(len(GRID)) < 5), "few dots"),
    ("shear", dotted((2.0, 0)), "beyond the calibrated range"),
    ("shear", replace(dotted((0.1, 0)), calibration_digest="b"), "another gel"),
]


@pytest.mark.parametrize(("kind", "result", "reason"), REFUSED)
def test_where_no_force_is_stated(kind, result, reason):
    force = force_from_result(result, MODEL)
    assert getattr(force, f"{kind}_n") is None is getattr(force, f"{kind}_sigma_n")
    assert re.search(reason, getattr(force, f"{kind}_reason"))
    assert getattr(force, f"{kind}_reason") in force.reason


def test_just_within_the_limits_it_is_stated():
    result = pressed(depth_mm=2.9, outside_change=0.29, confidence=np.full((60, 80), 0.51, np.float32))
    assert force_from_result(result, MODEL).normal_n == pytest.approx(11.6, rel=1e-5)


def test_dots_alone_tell_no_normal_force_and_those_of_another_gel_none():
    touch = replace(touch_from_dots(GRID, np.zeros((len(GRID), 3))), calibration_digest="a")
    force = force_from_result(touch, MODEL)
    assert force.normal_n is None
    assert force.shear_n == pytest.approx((0.1, 0))
    other = replace(MODEL, rest_mm=tuple(map(tuple, (GRID + 0.5).tolist())))
    assert "another gel" in force_from_result(touch, other).torsion_reason


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


K = {"ball": 0.04, "cube": 0.05, "pen": 0.045}
VOLUMES = np.array([20.0, 60, 120, 250])


def pressed_fit(volume, **known):
    usual = {"confidence": 0.9, "outside_change": 0.1, "calibration_digest": "a"}
    return Touch(float(volume), **usual | known)


def weighed(k=K, volumes=VOLUMES):
    """Touches and loads of objects with their own stiffness."""
    loads = [Load(name, float(stiffness * volume)) for name, stiffness in k.items() for volume in volumes]
    return [pressed_fit(volume) for _ in k for volume in volumes], loads


def dragged(count, rng, weights, object="recording"):
    """Touches of dots that move at random, and loads that are linear in it."""
    motions = rng.normal(size=(count, 5)) * (0.5, 0.5, 0.02, 0.03, 0.03)
    loads = np.column_stack([motions, np.ones(count)]) @ weights
    touches = [Touch(dots=DotMotion(*m), rest_mm=GRID, calibration_digest="a") for m in motions]
    return touches, [Load(object, shear_n=(x, y), torsion_n_mm=t) for x, y, t in loads.tolist()]


def joined(parts):
    """Touches and loads of several recordings."""
    return [[*chain.from_iterable(one)] for one in zip(*parts)]


WEIGHTS = np.array([[-1.5, 0.1, 3], [0.1, -1.4, 0], [1, 2, 150], [3, 0, 0], [0, 3, 0], [0.05, -0.1, 1]])


def test_the_stiffness_is_the_median_and_sigma_that_of_left_out_objects():
    assert calibrate_force(*weighed({"ball": 0.04})).normal.relative == 0.3, "one object does not show others"
    assert calibrate_force(*weighed({"ball": 0.04, "pen": 0.041})).normal.relative == 0.3, (
        "nor do two that agree"
    )
    model = calibrate_force(*weighed())
    assert model.normal.weights[0][0] == pytest.approx(0.045)
    assert model.normal.range == pytest.approx((0.8, 12.5))
    assert model.objects == ("ball", "cube", "pen")
    # Left out, the ball is predicted by 0.0475 and the cube by 0.0425 N/mm^3.
    assert 0.14 < model.normal.relative < 0.16
    force = force_from_result(pressed_fit(100), model)
    assert force.normal_n == pytest.approx(4.5)
    assert force.normal_sigma_n >= 4.5 * model.normal.relative
    assert force.shear_n is None


def test_sigma_is_that_of_left_out_grasps():
    """Two objects of the same stiffness on average, each with a stiff and a soft grasp."""
    touches, loads = weighed({"ball": 0.04, "cube": 0.04})
    grasps = [replace(load, grasp=str(k % 2)) for k, load in enumerate(loads)]
    unlike = [replace(load, normal_n=load.normal_n * (0.8, 1.25)[k % 2]) for k, load in enumerate(grasps)]
    model = calibrate_force([touches[k // 2 * 2] for k in range(8)], unlike)
    assert model.normal.relative > 0.3
    alike = dict.fromkeys(("ball", "cube", "pen"), 0.04)
    assert calibrate_force(*weighed(alike)).normal.relative < 0.01


def test_refused_and_falling_touches_and_the_gauge_s_zero_do_not_count():
    touches, loads = weighed()
    spoilt = {"outside_change": 0.7}, {"confidence": 0.2}, {"border_share": 0.5}, {"falling": True}
    touches += [*(pressed_fit(100, **one) for one in spoilt), pressed_fit(3)]
    loads += [*[Load("foam", 20.0)] * 4, Load("foam", -0.1)]
    assert calibrate_force(touches, loads).normal == calibrate_force(*weighed()).normal


def of_two_gels():
    touches, loads = dragged(20, np.random.default_rng(5), WEIGHTS)
    return [*touches[1:], replace(touches[0], rest_mm=GRID + 0.6)], loads


BAD = {
    "two loads": (weighed({"ball": 0.04}, VOLUMES[:2]), "at least 3 loads"),
    "a narrow range": (weighed(volumes=[100, 120, 200]), "range of 1 to 3"),
    "negative loads": (weighed({"ball": -0.04}), "0 N or more"),
    "one negative": (([*map(pressed_fit, VOLUMES)], [Load("a", f) for f in (1.0, -2, 5, 9)]), "0 N or more"),
    "grams": (weighed({n: k / 9.80665e-3 for n, k in K.items()}), "grams.*0.009807"),
    "kilograms": (weighed({n: k / 9.80665 for n, k in K.items()}), "kilograms.*9.807"),
    "NaN": (([pressed_fit(1)], [Load("a", float("nan"))]), "finite"),
    "no contact": (([Touch(0.0)] * 4, [Load("a", f) for f in (1.0, 2, 4, 9)]), "no contact"),
    "no loads at all": (([pressed_fit(1)], [Load("a")]), "column force_n"),
    "two calibrations": (([pressed_fit(1), Touch(2.0)], [Load("a", 1.0)] * 2), "several calibrations"),
    "no dots": (([pressed_fit(9)] * 4, [Load("a", shear_n=(f, 0.0)) for f in (1.0, 2, 4, 9)]), "dots"),
    "dots of two gels": (of_two_gels(), "another gel"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_gets_a_sentence(name):
    given, said = BAD[name]
    with pytest.raises(DataError, match=said):
        calibrate_force(*given)


def test_other_counts_and_kinds_and_who_is_sure_of_newtons():
    touches, loads = weighed({name: 100 * k for name, k in K.items()})
    assert calibrate_force(touches, loads, sure_of_unit=True).normal.weights[0][0] == pytest.approx(4.5)
    with pytest.raises(ValueError, match="one load for each press"):
        calibrate_force(touches, loads[1:])
    with pytest.raises(TypeError, match="Load"):
        calibrate_force(touches, [1.0] * len(touches))


def test_shear_and_torsion_come_back():
    rng = np.random.default_rng(3)
    parts = [dragged(30, rng, WEIGHTS, f"recording {k}") for k in range(3)]
    model = calibrate_force(*joined(parts))
    assert np.array(model.shear.weights) == pytest.approx(WEIGHTS[:, :2].T, abs=1e-9)
    assert np.array(model.torsion.weights) == pytest.approx(WEIGHTS[:, 2:].T, abs=1e-7)
    assert model.shear.relative < 1e-6
    assert model.normal is None


def test_with_few_loads_only_k_t():
    rng = np.random.default_rng(4)
    model = calibrate_force(*dragged(9, rng, WEIGHTS))
    (kx, *others), (zero, ky, *more) = model.shear.weights
    assert kx == ky == pytest.approx(-1.45, abs=0.2)
    assert not any((*others, zero, *more))
    assert np.flatnonzero(model.torsion.weights).tolist() == [2], "of the turn"
    assert model.shear.relative >= 0.3


def test_errors_stand_beside_those_of_the_best_constant():
    model = calibrate_force(*weighed())
    touches = [pressed_fit(v) for v in (100, 150, 250, 100, 20, 20)]
    touches[3] = replace(touches[3], outside_change=0.8, inside_change=0.1)
    found = evaluate_force(model, touches, [Load("box", f) for f in (5.0, 7.5, 12.5, 5.0, 1.8, 1.8)])
    (box, whole) = found["normal"]
    assert (box["object"], whole["object"], box["presses"]) == ("box", "all", 6)
    assert box["refused"] == pytest.approx(1 / 6)
    assert box["median"] == pytest.approx(0.1), "of loads above 2 N"
    assert box["mae"] == pytest.approx(np.mean([0.5, 0.75, 1.25, 0.9, 0.9]))
    assert box["constant"]["mae"] == pytest.approx(np.mean([0, 2.5, 7.5, 3.2, 3.2]))
    assert (box["within_1"], box["within_2"]) == pytest.approx((0.6, 0.6))
    assert found["reasons"] == {"a soft object": 1}
    assert found["shear"] == []
    assert set(found) == {"normal", "shear", "torsion", "reasons"}


NUMBER = st.one_of(st.floats(-1e6, 1e6), st.floats(0, 30), st.just(0.0))
TOUCHES = st.builds(
    Touch, volume_mm3=st.one_of(st.none(), st.floats(0, 1e4)), confidence=st.floats(0, 1),
    outside_change=st.one_of(st.none(), st.floats(0, 2)), border_share=st.floats(0, 1),
    dots=st.one_of(st.none(), st.builds(DotMotion, *[st.floats(-10, 10)] * 5)), rest_mm=st.sampled_from([None, GRID]),
)  # fmt: skip
LOADS = st.builds(
    Load, st.sampled_from("ab"), st.one_of(st.none(), NUMBER), st.one_of(st.none(), st.tuples(NUMBER, NUMBER))
)


@pytest.mark.slow
@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(TOUCHES, LOADS), min_size=1, max_size=12))
def test_any_input_gives_a_finite_model_or_a_sentence(rows):
    touches, loads = ([row[k] for row in rows] for k in (0, 1))
    touches = [replace(t, rest_mm=GRID) if t.dots is not None else t for t in touches]
    try:
        model, said = calibrate_force(touches, loads), ""
    except DataError as problem:
        model, said = None, str(problem)
    assert (model is None) == said.startswith(("Expected", "The loads look like"))
    for touch in touches:
        force = force_from_result(touch, model)
        for value, sigma, reason in (
            (force.normal_n, force.normal_sigma_n, force.normal_reason),
            (force.shear_n, force.shear_sigma_n, force.shear_reason),
        ):
            assert (value is None) == (sigma is None) == (reason != "")
            assert value is None or np.isfinite([*np.ravel(value), sigma]).all()


@pytest.mark.slow
def test_shear_of_a_real_recording_that_was_left_out(data):
    parts = []
    for k in range(3):
        with np.load(data / "force-dots" / f"recording-{k}.npz") as file:
            names = "rest_mm", "displacement_mm", "force_n", "torque"
            rest, moved, force, torque = (file[name] for name in names)
        touches = [touch_from_dots(rest, one) for one in moved[::5]]
        loads = [
            Load(f"recording {k}", shear_n=(float(f[0]), float(f[1])), torsion_n_mm=1e3 * float(t[2]))
            for f, t in zip(force[::5], torque[::5])
        ]
        parts.append((touches, loads))
    found = []
    for k in range(3):
        others = joined(part for j, part in enumerate(parts) if j != k)
        evaluation = evaluate_force(gelform.calibrate_force(*others), *parts[k])
        found.append((evaluation["shear"][-1], evaluation["torsion"][-1]))
    shear, torsion = (np.mean([row[k]["mae"] for row in found]) for k in (0, 1))
    assert shear < 0.15
    assert torsion < 3.1
    assert all(row[0]["mae"] < 0.4 * row[0]["constant"]["mae"] for row in found)
    assert 0.6 < np.mean([row[0]["within_1"] for row in found]) < 0.85
