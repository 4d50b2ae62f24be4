"""Models fitted to touches whose forces are written out, what is refused, and the real recordings of dots."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import gelform
from depth.force.test_touch import GRID
from gelform.depth.force.fit import Load, calibrate_force, evaluate_force
from gelform.depth.force.model import force_from_result
from gelform.depth.force.touch import DotMotion, Touch, touch_from_dots
from gelform.errors import DataError

pytestmark = pytest.mark.linear_algebra

K = {"ball": 0.04, "cube": 0.05, "pen": 0.045}
VOLUMES = np.array([20.0, 60, 120, 250])


def pressed(volume, **known):
    return Touch(
        float(volume), **{"confidence": 0.9, "outside_change": 0.1, "calibration_digest": "a"} | known
    )


def weighed(k=K, volumes=VOLUMES):
    """Touches and loads of objects with their own stiffness."""
    touches = [pressed(volume) for _ in k for volume in volumes]
    return touches, [
        Load(name, float(stiffness * volume)) for name, stiffness in k.items() for volume in volumes
    ]


def dragged(count, rng, weights, object="recording"):
    """Touches of dots that move at random, and loads that are linear in it."""
    motions = rng.normal(size=(count, 5)) * (0.5, 0.5, 0.02, 0.03, 0.03)
    loads = np.column_stack([motions, np.ones(count)]) @ weights
    touches = [Touch(dots=DotMotion(*m), rest_mm=GRID, calibration_digest="a") for m in motions]
    return touches, [Load(object, shear_n=(x, y), torsion_n_mm=t) for x, y, t in loads.tolist()]


WEIGHTS = np.array([[-1.5, 0.1, 3], [0.1, -1.4, 0], [1, 2, 150], [3, 0, 0], [0, 3, 0], [0.05, -0.1, 1]])


def test_the_stiffness_is_the_median_and_sigma_that_of_left_out_objects():
    model = calibrate_force(*weighed())
    assert model.normal.weights[0][0] == pytest.approx(0.045)
    assert model.normal.range == pytest.approx((0.8, 12.5))
    assert model.objects == ("ball", "cube", "pen")
    # Left out, the ball is predicted by 0.0475 and the cube by 0.0425 N/mm^3.
    assert 0.14 < model.normal.relative < 0.16
    force = force_from_result(pressed(100), model)
    assert force.normal_n == pytest.approx(4.5)
    assert force.normal_sigma_n >= 4.5 * model.normal.relative
    assert force.shear_n is None


def test_one_object_states_thirty_percent():
    assert calibrate_force(*weighed({"ball": 0.04})).normal.relative == 0.3


def test_sigma_is_that_of_left_out_grasps():
    """Two objects of the same stiffness on average, each with a stiff and a soft grasp."""
    touches, loads = weighed({"ball": 0.04, "cube": 0.04})
    grasps = [replace(load, grasp=str(k % 2)) for k, load in enumerate(loads)]
    unlike = [replace(load, normal_n=load.normal_n * (0.8, 1.25)[k % 2]) for k, load in enumerate(grasps)]
    model = calibrate_force([touches[k // 2 * 2] for k in range(8)], unlike)
    assert model.normal.relative > 0.3
    assert calibrate_force(touches, loads).normal.relative < 0.01


def test_falling_forces_do_not_count():
    touches, loads = weighed()
    touches += [pressed(100, falling=True)] * 9
    loads += [Load("ball", 12.0)] * 9
    assert calibrate_force(touches, loads).normal == calibrate_force(*weighed()).normal


def test_refused_touches_and_the_gauge_s_zero_do_not_count():
    touches, loads = weighed()
    touches += [
        pressed(100, outside_change=0.7),
        pressed(100, confidence=0.2),
        pressed(100, border_share=0.5),
        pressed(3),
    ]
    loads += [Load("foam", 20.0), Load("foam", 20.0), Load("foam", 20.0), Load("foam", -0.1)]
    assert calibrate_force(touches, loads).normal == calibrate_force(*weighed()).normal


BAD = {
    "two loads": (weighed({"ball": 0.04}, VOLUMES[:2]), "at least 3 loads"),
    "a narrow range": (weighed(volumes=[100, 120, 200]), "range of 1 to 3"),
    "negative loads": (weighed({"ball": -0.04}), "0 N or more"),
    "one negative load": (([*map(pressed, VOLUMES)], [Load("a", f) for f in (1.0, -2, 5, 9)]), "0 N or more"),
    "grams": (weighed({n: k / 9.80665e-3 for n, k in K.items()}), "grams.*0.009807"),
    "kilograms": (weighed({n: k / 9.80665 for n, k in K.items()}), "kilograms.*9.807"),
    "NaN": (([pressed(1)], [Load("a", float("nan"))]), "finite"),
    "no contact": (
        ([Touch(0.0, calibration_digest="a")] * 4, [Load("a", f) for f in (1.0, 2, 4, 9)]),
        "no contact",
    ),
    "no loads at all": (([pressed(1)], [Load("a")]), "column force_n"),
    "two calibrations": (
        ([pressed(1), pressed(2, calibration_digest="b")], [Load("a", 1.0)] * 2),
        "several calibrations",
    ),
    "no dots": (([pressed(9)] * 4, [Load("a", shear_n=(f, 0.0)) for f in (1.0, 2, 4, 9)]), "dots"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_gets_a_sentence(name):
    given, said = BAD[name]
    with pytest.raises(DataError, match=said):
        calibrate_force(*given)


def test_who_is_sure_of_newtons_may_have_a_hard_gel():
    stiff = weighed({name: 100 * k for name, k in K.items()})
    assert calibrate_force(*stiff, sure_of_unit=True).normal.weights[0][0] == pytest.approx(4.5)


def test_other_counts_and_kinds():
    touches, loads = weighed()
    with pytest.raises(ValueError, match="one load for each press"):
        calibrate_force(touches, loads[1:])
    with pytest.raises(TypeError, match="Load"):
        calibrate_force(touches, [1.0] * len(touches))


def test_shear_and_torsion_come_back():
    rng = np.random.default_rng(3)
    parts = [dragged(30, rng, WEIGHTS, f"recording {k}") for k in range(3)]
    model = calibrate_force([t for part in parts for t in part[0]], [x for part in parts for x in part[1]])
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
    assert model.shear.relative >= 0.3


def test_dots_of_two_gels_are_refused():
    touches, loads = dragged(20, np.random.default_rng(5), WEIGHTS)
    touches[7] = replace(touches[7], rest_mm=GRID + 0.6)
    with pytest.raises(DataError, match="another gel"):
        calibrate_force(touches, loads)


def test_errors_stand_beside_those_of_the_best_constant():
    model = calibrate_force(*weighed())
    touches = [pressed(v) for v in (100, 150, 250, 100, 20, 20)]
    touches[3] = replace(touches[3], outside_change=0.8)
    found = evaluate_force(model, touches, [Load("box", f) for f in (5.0, 7.5, 12.5, 5.0, 1.8, 1.8)])
    (box, whole) = found["normal"]
    assert (box["object"], whole["object"], box["presses"], box["refused"]) == (
        "box",
        "all",
        6,
        pytest.approx(1 / 6),
    )
    assert box["median"] == pytest.approx(0.1), "of loads above 2 N"
    assert box["mae"] == pytest.approx(np.mean([0.5, 0.75, 1.25, 0.9, 0.9]))
    assert box["constant"]["mae"] == pytest.approx(np.mean([0, 2.5, 7.5, 3.2, 3.2]))
    assert box["within_2"] == pytest.approx(0.6)
    assert list(found["reasons"].values()) == [1]
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
            rest, moved, force, torque = (
                file[n][...] for n in ("rest_mm", "displacement_mm", "force_n", "torque")
            )
        touches = [touch_from_dots(rest, one) for one in moved[::5]]
        loads = [
            Load(f"recording {k}", shear_n=(float(f[0]), float(f[1])), torsion_n_mm=1e3 * float(t[2]))
            for f, t in zip(force[::5], torque[::5])
        ]
        parts.append((touches, loads))
    found = []
    for k in range(3):
        others = [part for j, part in enumerate(parts) if j != k]
        model = gelform.calibrate_force(
            [t for part in others for t in part[0]], [x for part in others for x in part[1]]
        )
        evaluation = evaluate_force(model, *parts[k])
        found.append((evaluation["shear"][-1], evaluation["torsion"][-1]))
    shear, torsion = (np.mean([row[k]["mae"] for row in found]) for k in (0, 1))
    assert shear < 0.15
    assert torsion < 3.1
    assert all(row[0]["mae"] < 0.4 * row[0]["constant"]["mae"] for row in found)
    assert 0.6 < np.mean([row[0]["within_1"] for row in found]) < 0.85
