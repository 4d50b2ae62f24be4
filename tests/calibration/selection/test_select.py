"""Choosing: the choice does what it says, and no fold's own presses decide what scores them."""

from dataclasses import replace

import numpy as np

from gelform.calibration.selection.candidates import candidates_for
from gelform.calibration.selection.folds import Fold
from gelform.calibration.selection.select import (
    not_out_of_reach,
    select,
    simplest_within_one_error,
    standard_error,
    zone_within_one_error,
)


def test_a_single_press_has_no_standard_error():
    assert standard_error([3.0]) == 0
    assert standard_error([1.0, 3.0]) == 1


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


def test_of_few_presses_the_best_is_chosen(made_up):
    """Their standard error covers much: it would keep what is simple and worse."""
    noise = np.random.default_rng(0).normal(0, 0.5, 20)
    trials = made_up("simple", lambda i: 1 + noise[i]), made_up("better", lambda i: 0.95 + noise[-1 - i])
    losses = [trial.fold_losses() for trial in trials]
    assert simplest_within_one_error(trials, losses, few=True).model == "better"


def test_what_learnt_the_ball_is_out(made_up):
    """On a size that was left out the honest one is 1.1 times worse; half as much again is forgiven."""
    honest = made_up("honest", lambda i: 1.0, by_size=lambda i: 1.1)
    for ratio, right in ((3.3, "honest"), (1.7, "honest"), (1.6, "parrot")):
        parrot = made_up("parrot", lambda i: 0.6, by_size=lambda i: 0.6 * ratio)  # noqa: B023  read at once
        assert chosen(honest, parrot) == right


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


class MadeUpPresses:
    """20 presses in 5 folds, whose errors are given by zone and model: what `select` asks of held-out presses."""

    def __init__(self, made_up, loss):
        self.folds = [Fold(tuple(range(f, 20, 5)), tuple(range(16)), ()) for f in range(5)]
        self.made_up, self.loss = made_up, loss

    def try_candidates(self, candidates):
        assert len({(one.model, one.zone) for one in candidates}) == 1
        return [replace(self._made(candidate), by_pair={}) for candidate in candidates]

    def with_pairs(self, trials):
        return [self._made(trial.candidate) for trial in trials]

    def _made(self, candidate):
        return replace(self.made_up("pairs", lambda i: self.loss(candidate, i)), candidate=candidate)


def first_fold(i):
    return i % 5 == 0


def test_folds_choose_without_their_own_presses(made_up):
    """The first fold's presses alone speak for a smaller zone, and for the second model: it is scored without both."""

    def loss(candidate, i):
        odd = [candidate.zone == 0.7, candidate.model == "near_light"]
        return 2.0 + sum(odd) * (-0.9 if first_fold(i) else 0.05)

    candidates, said = [*candidates_for("lambertian", 12), *candidates_for("near_light", 12)], []
    found = select(
        candidates,
        MadeUpPresses(made_up, loss),
        zones=[0.7, 0.8],
        progress=lambda done, total, what: said.append((done, total)),
    )
    assert (found.chosen.zone, found.chosen.model) == (0.7, "near_light")
    assert [(one.zone, one.model) for one in found.by_fold] == [
        (0.8, "lambertian"),
        *[(0.7, "near_light")] * 4,
    ]
    assert said[0] == (1, 4)
    assert [done for done, _ in said] == list(range(1, len(found.trials) + 1))
    assert all(done <= total for done, total in said)
    assert found.chosen in [trial.candidate for trial in found.trials]


def test_a_single_zone_is_taken_as_it_is(made_up):
    selection = select(candidates_for("polynomial", 6), MadeUpPresses(made_up, lambda c, i: 1.0), zones=[0.9])
    assert {trial.candidate.zone for trial in selection.trials} == {0.9}
