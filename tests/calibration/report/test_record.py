"""The learning curve: its law is found again, its sentence follows the figures, the same presses give the same curve."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration import selection as module
from gelform.calibration.circles.locate import refine
from gelform.calibration.report.record import (
    _with_expectation,
    candidates_of,
    floor_and_slope,
    held_out_count,
    learning_curve,
    sizes_for,
)
from gelform.calibration.start import Start
from gelform.slopes.color_models import PolynomialModel


@pytest.mark.parametrize(("floor", "slope"), [(4.0, 100.0), (0.0, 50.0), (6.25, 0.0)])
def test_the_law_is_found_again(floor, slope):
    n = np.array([10, 15, 20, 30, 50, 10, 30])
    found = floor_and_slope(n, np.sqrt(floor + slope / n))
    assert found == pytest.approx((floor, slope), abs=1e-6)


@pytest.mark.parametrize("accepted", [8, 10, 25, 67, 300])
def test_sizes_leave_the_held_out_alone(accepted):
    sizes = sizes_for(accepted)
    assert sizes == sorted(set(sizes))
    assert sizes[-1] + held_out_count(accepted) == accepted


def test_more_presses_are_better_and_said_so(learning, calibration):
    points, accepted = learning["points"], sum(row.accepted for row in calibration.report.presses)
    assert [p["presses"] for p in points] == sizes_for(accepted)
    assert points[-1]["mean_deg"] < points[0]["mean_deg"]
    assert all(min(p["draws_deg"]) <= p["mean_deg"] <= max(p["draws_deg"]) for p in points)
    expected = learning["expected"]
    assert expected["presses_now"] == accepted
    assert expected["floor_deg"] <= expected["more_deg"] <= expected["now_deg"]
    assert f"{expected['more_deg']:.2f}° instead of {expected['now_deg']:.2f}°" in learning["sentence"]
    assert learning["sentence"].startswith(f"More presses {expected['help']}. ")
    assert expected["more_deg_range"] == sorted(expected["more_deg_range"])
    json.dumps(learning)
    # It ends near what the candidates reached, by the same slopes inside the same edge.
    reached = next(one for one in calibration.report.candidates if one["chosen"])["normal_free_deg"]
    assert 0.6 * reached < points[-1]["mean_deg"] < 1.6 * reached


def points(*rows):
    return [
        {"presses": n, "draws_deg": draws, "mean_deg": float(np.mean(draws)), "model": "m"}
        for n, draws in rows
    ]


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        (((5, [8.0, 9.0, 8.5]), (10, [6.0, 6.5, 6.2]), (15, [4.5, 5.0, 5.0])), "would help"),
        (((5, [3.0, 3.1, 3.0]), (10, [3.0, 3.0, 3.1]), (15, [3.0, 3.1, 3.0])), "would not help much"),
        (((5, [5.7, 13.0, 6.8]), (10, [3.6, 11.6, 3.3]), (15, [3.8, 6.0, 3.2])), "would help"),
        (((5, [3.0, 6.0, 3.0]), (10, [3.0, 3.0, 3.0]), (15, [3.0, 3.0, 3.0])), "may help"),
    ],
)
def test_one_draw_alone_convinces_nobody(rows, said):
    """A hard draw moves the whole curve: a falling mean is not taken for a flat one, nor one draw for all."""
    assert _with_expectation(points(*rows), 20)["expected"]["help"] == said


def test_the_range_is_what_two_draws_of_three_say():
    expected = _with_expectation(points(*((n, [3.0, 2.0, 3.0]) for n in (10, 15, 20))), 25)["expected"]
    assert expected["more_deg_range"] == pytest.approx([2.5, 3.0])
    assert expected["more_deg"] == pytest.approx(8 / 3)
    assert _with_expectation(points((5, [3.0, 3.0, 3.0])), 8) is None, "one point tells nothing"


@pytest.mark.slow
def test_the_same_presses_give_the_same_curve(presses, calibration, learning):
    again = learning_curve(presses, calibration, rng=np.random.default_rng(0))
    assert again == learning


def of_first(calibration, count, **settings):
    """A calibration by its first presses alone."""
    report = replace(calibration.report, presses=calibration.report.presses[:count])
    return replace(calibration, report=report, settings={**calibration.settings, **settings})


def test_progress_is_told_and_too_few_presses_have_no_curve(presses, calibration):
    calls, rng = [], np.random.default_rng(0)
    learning_curve(presses, of_first(calibration, 8), rng=rng, progress=lambda *call: calls.append(call))
    assert {what for _, _, what in calls} == {"measuring the learning curve"}
    assert calls[-1][0] == calls[-1][1]
    assert learning_curve(presses, of_first(calibration, 7), rng=rng) is None


def another(calibration, **how):
    """The start of another unit that is this one."""
    return Start(calibration.color_model, calibration.forward, "digest", 0.1, "the starter of a test", **how)


@pytest.mark.slow
def test_a_start_is_part_of_the_curve(presses, calibration, monkeypatch):
    """A curve of models that began with another unit's says nothing if its own begin with nothing."""
    start, few = another(calibration), of_first(calibration, 8, own_ridge=1e-3, own_share=0.3)
    started = replace(few, report=replace(few.report, start=start))
    assert [c.start for c in candidates_of(started, 5, start)] == [start]
    assert [c.start for c in candidates_of(started, 12, start)] == [start] * 3
    assert {tuple(share for share, _ in c.parts) for c in candidates_of(started, 12, start)} == {(0.7, 0.3)}
    began = []

    def refined(*args, start=None):
        began.append(start)
        return refine(*args, start=start)

    monkeypatch.setattr(module, "refine", refined)
    learning_curve(presses, started, rng=np.random.default_rng(0))
    assert began
    assert all(one is start.model for one in began)


@pytest.mark.slow
def test_a_curve_beside_an_offered_starter_shows_both(presses, calibration):
    few, start = of_first(calibration, 12, own_ridge=1e-3, own_share=0.3), another(calibration, offered=True)
    beside = replace(few, report=replace(few.report, start=start, offered=start))
    curve = learning_curve(presses, beside, rng=np.random.default_rng(0))
    assert curve["other"] == "without the starter"
    assert [p["presses"] for p in curve["other_points"]] == [p["presses"] for p in curve["points"]]
    assert all("the starter of a test" in p["model"] for p in curve["points"])
    assert not any("the starter of a test" in p["model"] for p in curve["other_points"])
    first, other = (curve[name][0]["mean_deg"] for name in ("points", "other_points"))
    assert first < other, "it has seen these presses"


def test_candidates_grow_no_larger_than_the_chosen_one(calibration):
    (chosen,) = candidates_of(calibration, 10_000, None)
    assert chosen.settings
    assert dict(chosen.settings).items() <= calibration.settings.items()
    model = PolynomialModel(np.zeros((9, 2)), (2, 1), (8, 8))
    settings = {"contact_radius_ratio": 0.8, "position_degrees": (2, 1)}
    polynomial = replace(calibration, color_model=model, settings=settings)
    for size, degrees in ((20, [(1,), (2, 1)]), (40, [(2, 1)])):
        tried = candidates_of(polynomial, size, None)
        assert [dict(one.settings)["position_degrees"] for one in tried] == degrees
    assert {c.step_ridge for c in candidates_of(polynomial, 20, None)} == {None}, "as it was chosen"
    step = calibration.settings["step_ridge"]
    assert step > 0
    assert {c.step_ridge for size in (6, 40) for c in candidates_of(calibration, size, None)} == {step}


def test_presses_train_and_are_scored_inside_the_edge_of_the_calibration(presses, calibration, monkeypatch):
    """Few presses would not measure it themselves."""
    edges = []

    def noted(name, presses_of):
        plain = getattr(module, name)

        def call(first, *others, **more):
            edges.extend(press.contact_radius_ratio for press in presses_of(first))
            return plain(first, *others, **more)

        monkeypatch.setattr(module, name, call)

    noted("training_samples", lambda used: used)
    noted("score_of", lambda press: [press])
    few = of_first(calibration, 8, contact_radius_ratio=0.6)
    learning_curve(presses, few, rng=np.random.default_rng(0))
    assert len(edges) > 10
    assert set(edges) == {0.6}
