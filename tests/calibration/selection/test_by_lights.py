"""When colours are carried to depth 0: where near lights explain them and balls are not read worse."""

from dataclasses import replace

import numpy as np
import pytest

from gelform.calibration.circles.refine import refine
from gelform.calibration.selection.by_lights import judged_by_lights
from gelform.calibration.selection.candidates import Candidate, Start
from gelform.calibration.selection.select import Selection
from gelform.calibration.selection.trials import HeldOutPresses
from gelform.color_models import HierarchicalModel

PLAIN = Candidate("hierarchical", 0.8, (("ridge", 3e-4),))


@pytest.fixture(scope="module")
def made(prepared, found, folds):
    """What a selection is made from, and the selection of a `hierarchical`, but for one fold's."""
    held_out = HeldOutPresses({10.0: prepared}, found, folds, [])
    by_fold = (Candidate("polynomial", 0.8), *(PLAIN,) * (len(folds) - 1))
    selection = Selection(PLAIN, by_fold, tuple(held_out.try_candidates([PLAIN])))
    return {10.0: prepared}, refine(prepared, found), selection, held_out


@pytest.fixture(autouse=True)
def few_are_enough(monkeypatch):
    monkeypatch.setattr("gelform.calibration.selection.by_lights.LEAST_PRESSES", 10)


@pytest.fixture
def taken(made):
    return judged(made)


def judged(made, **instead):
    by_offset, refined, selection, held_out = made
    return judged_by_lights(by_offset, refined, replace(selection, **instead), held_out)


def test_near_lights_take_the_place_of_a_hierarchical(taken):
    taken, (note,) = taken
    assert taken.chosen == replace(PLAIN, model="depth_by_lights")
    assert [one.model for one in taken.by_fold] == [
        "polynomial",
        *["depth_by_lights"] * (len(taken.by_fold) - 1),
    ]
    assert taken.trials[-1].candidate == taken.chosen
    assert "Near lights explain all but" in note


def test_balls_that_are_read_worse_keep_the_plain_model(made, taken, monkeypatch):
    last = taken[0].trials[-1]
    worse = {i: replace(score, cap_px=2 * score.cap_px) for i, score in last.by_fold.items()}
    trial = replace(last, by_fold=worse)
    monkeypatch.setattr(HeldOutPresses, "try_candidates", lambda *_: [trial])
    kept, (note,) = judged(made)
    assert kept.chosen == PLAIN
    assert "reads balls worse" in note


def test_where_they_do_not_explain_the_colours_nothing_is_said(made):
    by_offset, refined, selection, held_out = made
    rng = np.random.default_rng(0)
    other = []
    for press in by_offset[10.0]:
        noise = rng.normal(0, 0.3, press.color_change.shape)
        other.append(replace(press, color_change=press.color_change + noise.astype(np.float32)))
    assert judged_by_lights({10.0: other}, refined, selection, held_out) == (selection, ())


def test_of_few_presses_nothing_is_asked(made, monkeypatch):
    monkeypatch.setattr("gelform.calibration.selection.by_lights.LEAST_PRESSES", 25)
    assert judged(made) == (made[2], ())


def test_another_model_and_a_second_unit_stay(made):
    nodes = np.zeros((2, 2, 19, 2))
    second = replace(PLAIN, start=Start(HierarchicalModel(nodes, 3, (16, 16)), "digest", 0.8))
    for chosen in (Candidate("polynomial", 0.8), Candidate("depth_aware", 0.8), second):
        kept, notes = judged(made, chosen=chosen)
        assert (kept.chosen, notes) == (chosen, ())
