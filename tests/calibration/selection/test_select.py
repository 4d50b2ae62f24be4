"""Choosing: no press is scored by a model that has seen it, and the choice does what it says."""

import numpy as np
import pytest

from gelform.calibration.circles.find import find_contact
from gelform.calibration.fit import prepare
from gelform.calibration.selection.candidates import Candidate, candidates_for
from gelform.calibration.selection.folds import make_folds, size_folds
from gelform.calibration.selection.select import (
    SELECTION_SAMPLES,
    PressScore,
    Trial,
    not_out_of_reach,
    press_score,
    select,
    simplest_within_one_error,
    try_candidate,
    with_pairs,
    zone_within_one_error,
)
from gelform.color_models import COLOR_MODELS


@pytest.fixture(scope="module")
def prepared(presses):
    return prepare(presses, 10.0)


@pytest.fixture(scope="module")
def found(prepared):
    return [find_contact(press.color_change) for press in prepared]


@pytest.fixture(scope="module")
def folds(prepared, found):
    return make_folds(prepared, found, range(len(prepared)))


@pytest.fixture(scope="module")
def sizes(prepared, found):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("gelform.calibration.selection.folds.MIN_OF_OTHER_SIZES", 7)
        return size_folds(prepared, found, range(len(prepared)))


def test_held_out_presses_train_nothing(folds, prepared):
    held_out = [i for fold in folds for i in fold.held_out]
    assert sorted(held_out) == list(range(len(prepared)))
    for fold in folds:
        assert not set(fold.held_out) & set(fold.training)
        assert len(fold.contacts) == len(fold.training)


def test_every_fold_has_both_balls(folds, prepared):
    for fold in folds:
        assert len({prepared[i].ball_radius_px for i in fold.training}) == 2


def test_a_size_that_is_left_out_is_not_in_the_training(sizes, prepared):
    assert len(sizes) == 2
    for fold in sizes:
        trained = {prepared[i].ball_radius_px for i in fold.training}
        assert not trained & {prepared[i].ball_radius_px for i in fold.held_out}


def test_no_size_is_left_out_where_the_others_are_few(prepared, found):
    assert size_folds(prepared, found, range(len(prepared))) == []


def test_two_folds_left_out(folds):
    pair = folds[0].without(folds[1].held_out)
    assert not set(pair.training) & (set(folds[0].held_out) | set(folds[1].held_out))
    assert pair.held_out == folds[1].held_out
    assert len(pair.contacts) == len(pair.training)


def test_scores_are_those_of_models_that_have_not_seen_the_press(folds, sizes, prepared, found):
    candidate = Candidate("polynomial", 0.8, (("position_degrees", (2, 1)),))
    trial = try_candidate(candidate, {10.0: prepared}, found, folds, sizes)
    trial = with_pairs(trial, {10.0: prepared}, found, folds)
    model = candidate.fit(
        [prepared[i] for i in folds[0].training], folds[0].contacts, total=SELECTION_SAMPLES
    )
    for i in folds[0].held_out:
        assert trial.by_fold[i] == press_score(prepared[i], found[i], model)
    assert set(trial.by_fold) == set(trial.by_size) == set(range(len(prepared)))
    for f, fold in enumerate(folds):
        assert set(trial.by_pair[f]) == set(range(len(prepared))) - set(fold.held_out)
    pair = folds[2].without(folds[0].held_out)
    model = candidate.fit([prepared[i] for i in pair.training], pair.contacts, total=SELECTION_SAMPLES)
    for i in folds[0].held_out:
        assert trial.by_pair[2][i] == press_score(prepared[i], found[i], model)


def test_a_model_that_saw_the_press_flatters_itself(folds, prepared, found):
    """Why all this: the same candidate scores better on the presses that it was fitted on."""
    candidate = Candidate("polynomial", 0.8, (("position_degrees", (3, 2, 0)),))
    fold = folds[0]
    model = candidate.fit([prepared[i] for i in fold.training], fold.contacts)
    seen = np.median([press_score(prepared[i], found[i], model).normal_deg for i in fold.training])
    trial = try_candidate(candidate, {10.0: prepared}, found, folds, [])
    assert seen < np.median([score.normal_deg for score in trial.by_fold.values()])


def test_cap_error_is_that_of_the_depth(calibration, prepared, found):
    """A model whose slopes are 10 % too steep makes the cap too high by 10 %: its error is known."""

    class Steeper:
        def gradients_at(self, change, x, y):
            return 1.1 * np.asarray(truth(x, y))

    press, contact = prepared[0], found[0]

    def truth(x, y):
        return press.ball_gradients(contact, np.asarray(y), np.asarray(x))

    score = press_score(press, contact, Steeper())
    radius, a = press.ball_radius_px, contact.radius_px - 3 * min(press.size.shape) / 240
    depth = np.sqrt(radius**2 - np.linspace(0, a**2, 2000)) - np.sqrt(radius**2 - a**2)  # uniform in area
    assert score.cap_px == pytest.approx(0.1 * depth.std(), rel=0.25)


def made_up(name, by_fold, by_pair=None, by_size=None, zone=0.8):
    """A trial of 20 presses in 5 folds with given cap errors; press i is in fold i % 5."""
    seen = {i: PressScore(0.0, by_fold(i)) for i in range(20)}
    pairs = {
        f: {i: PressScore(0.0, (by_pair or by_fold)(i)) for i in range(20) if i % 5 != f} for f in range(5)
    }
    sizes = {} if by_size is None else {i: PressScore(0.0, by_size(i)) for i in range(20)}
    return Trial(Candidate(name, zone), seen, sizes, pairs)


def chosen(*ladder):
    return simplest_within_one_error(ladder, [t.expected_losses() for t in ladder]).model


def test_simplest_within_one_standard_error():
    noise = np.random.default_rng(0).normal(0, 0.5, 20)
    simple = made_up("simple", lambda i: 1 + noise[i])
    hardly = made_up("hardly better", lambda i: 0.95 + noise[-1 - i])
    better = made_up("better", lambda i: 0.5 + noise[i])
    assert chosen(simple, hardly) == "simple"
    assert chosen(simple, hardly, better) == "better"
    assert chosen(simple) == "simple"


def test_what_learns_faster_is_expected_to_win():
    """As good as another with 4/5 of the presses, worse with 3/5: with all of them it is the better one."""
    quick = made_up("quick", lambda i: 1.0, by_pair=lambda i: 1.1)
    slow = made_up("slow", lambda i: 1.01, by_pair=lambda i: 1.5)
    assert chosen(quick, slow) == "slow"


def test_expected_errors_are_exact_where_errors_fall_as_a_power():
    trial = made_up("law", lambda i: 2 * 0.8**-0.7, by_pair=lambda i: 2 * 0.6**-0.7)
    np.testing.assert_allclose(trial.expected_losses(), 2.0)
    worse = made_up("noise", lambda i: 1.0, by_pair=lambda i: 0.9)
    np.testing.assert_allclose(worse.expected_losses(), 1.0)


def test_what_learnt_the_ball_is_out():
    honest = made_up("honest", lambda i: 1.0, by_size=lambda i: 1.1)
    parrot = made_up("parrot", lambda i: 0.6, by_size=lambda i: 2.0)
    assert chosen(honest, parrot) == "honest"


def test_zone_leaves_the_usual_one_only_for_a_reason():
    noise = np.tile([-0.3, 0.3], 10)
    usual = made_up("m", lambda i: 1.0, zone=0.8)
    lucky = made_up("m", lambda i: 0.97 + noise[i], zone=0.7)
    better = made_up("m", lambda i: 0.6 + noise[i], zone=0.9)
    assert zone_within_one_error([lucky, usual]) == 0.8
    assert zone_within_one_error([lucky, usual, better]) == 0.9


def test_folds_choose_without_their_own_presses(prepared, found, folds, sizes):
    """Spoil the errors that one fold's presses give: the others' choice for it must not notice."""
    candidates = candidates_for("polynomial", 12)
    selection = select(candidates, {10.0: prepared}, found, folds, sizes)
    assert len(selection.by_fold) == len(folds)
    wrong = list(found)
    for i in folds[0].held_out:
        wrong[i] = type(found[i])(20.0, 20.0, 25.0, 1.0, 9.0)
    spoilt = select(candidates, {10.0: prepared}, wrong, folds, sizes)
    assert spoilt.by_fold[0] == selection.by_fold[0]
    assert selection.chosen in [trial.candidate for trial in selection.trials]


def test_what_is_far_behind_is_not_tried_further():
    noise = np.tile([-0.3, 0.3], 10)
    best, near = made_up("best", lambda i: 1.0 + noise[i]), made_up("near", lambda i: 1.05)
    far = made_up("far", lambda i: 2.0 + noise[i])
    assert [t.candidate.model for t in not_out_of_reach([far, near, best])] == ["near", "best"]
    lucky = made_up("lucky", lambda i: 0.1 if i % 5 == 0 else 3.0)
    assert lucky not in not_out_of_reach([lucky, best], without=[0, 5, 10, 15])


def test_models_too_slow_for_frames_are_listed_but_not_chosen():
    quick, slow = made_up("polynomial", lambda i: 1.0), made_up("interpolation", lambda i: 0.2)
    assert not_out_of_reach([quick, slow]) == [quick]
    assert not_out_of_reach([slow]) == [slow]


def test_few_presses_try_few_terms():
    few = [c.describe() for c in candidates_for("auto", 6)]
    assert few == [
        "lambertian, zone 0.8",
        "polynomial 1, zone 0.8",
        "hierarchical ridge 0.001, zone 0.8",
        "hierarchical ridge 0.0003, zone 0.8",
    ]
    assert candidates_for("polynomial", 40)[-1].describe() == "polynomial 5-4-3, zone 0.8"
    assert {c.model for c in candidates_for("auto", 60)} == set(COLOR_MODELS) - {"mlp"}
    for name in COLOR_MODELS:
        assert candidates_for(name, 12)
