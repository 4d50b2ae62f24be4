"""Choosing: the choice does what it says, and no fold's own presses decide what scores them."""

import numpy as np

from gelform.calibration.selection.candidates import candidates_for
from gelform.calibration.selection.select import (
    not_out_of_reach,
    select,
    simplest_within_one_error,
    zone_within_one_error,
)
from gelform.calibration.selection.trials import HeldOutPresses


def chosen(*trials):
    return simplest_within_one_error(trials, [t.fold_losses() for t in trials]).model


def test_simplest_within_one_standard_error(made_up):
    noise = np.random.default_rng(0).normal(0, 0.5, 20)
    simple = made_up("simple", lambda i: 1 + noise[i])
    hardly = made_up("hardly better", lambda i: 0.95 + noise[-1 - i])
    better = made_up("better", lambda i: 0.5 + noise[i])
    assert chosen(simple, hardly) == "simple"
    assert chosen(simple, hardly, better) == "better"
    assert chosen(simple) == "simple"


def test_what_learnt_the_ball_is_out(made_up):
    honest = made_up("honest", lambda i: 1.0, by_size=lambda i: 1.1)
    parrot = made_up("parrot", lambda i: 0.6, by_size=lambda i: 2.0)
    assert chosen(honest, parrot) == "honest"


def test_zone_leaves_the_usual_one_only_for_a_reason(made_up):
    noise = np.tile([-0.3, 0.3], 10)
    usual = made_up("m", lambda i: 1.0, zone=0.8)
    lucky = made_up("m", lambda i: 0.97 + noise[i], zone=0.7)
    better = made_up("m", lambda i: 0.6 + noise[i], zone=0.9)
    assert zone_within_one_error([lucky, usual]) == 0.8
    assert zone_within_one_error([lucky, usual, better]) == 0.9


def test_what_is_far_behind_is_not_tried_further(made_up):
    noise = np.tile([-0.3, 0.3], 10)
    best, near = made_up("best", lambda i: 1.0 + noise[i]), made_up("near", lambda i: 1.05)
    far = made_up("far", lambda i: 2.0 + noise[i])
    assert [t.candidate.model for t in not_out_of_reach([far, near, best])] == ["near", "best"]
    lucky = made_up("lucky", lambda i: 0.1 if i % 5 == 0 else 3.0)
    assert lucky not in not_out_of_reach([lucky, best], without=[0, 5, 10, 15])


def test_folds_choose_without_their_own_presses(held_out):
    """Spoil the errors that one fold's presses give: the others' choice for it must not notice."""
    candidates = candidates_for("polynomial", 12)
    said = []
    selection = select(candidates, held_out, progress=lambda done, total, what: said.append((done, total)))
    assert len(selection.by_fold) == len(held_out.folds)
    assert len(said) == len(selection.trials)
    assert all(done <= total for done, total in said)
    wrong = list(held_out.found)
    for i in held_out.folds[0].held_out:
        wrong[i] = type(wrong[i])(20.0, 20.0, 25.0, 1.0, 9.0)
    spoilt = select(candidates, HeldOutPresses(held_out.presses, wrong, held_out.folds, held_out.sizes))
    assert spoilt.by_fold[0] == selection.by_fold[0]
    assert selection.chosen in [trial.candidate for trial in selection.trials]


def test_a_single_zone_is_taken_as_it_is(held_out):
    selection = select(candidates_for("polynomial", 6), held_out, zones=[0.9])
    assert {trial.candidate.zone for trial in selection.trials} == {0.9}
